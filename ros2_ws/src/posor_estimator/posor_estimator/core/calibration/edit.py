"""Change entries of a calibration file's text and leave everything else, comments and layout too, as it stands."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import yaml

from posor_estimator.core.calibration.places import Places
from posor_estimator.core.calibration.strict_yaml import StrictDumper, read_yaml
from posor_estimator.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Mapping

_STEP = re.compile(r"(?:^|(?<=.)\.)([^.\[\]]+)|\[(\d+)\]")
_WIDTH = 120


def parsed(key: str) -> tuple[str | int, ...]:
    """Return the steps of a key path such as ``sensors[0].probes[1].tip``.

    Raises:
        CalibrationError: It is none.

    """
    steps: list[str | int] = []
    end = 0
    for match in _STEP.finditer(key):
        if match.start() != end:
            break
        steps.append(match[1] if match[1] is not None else int(match[2]))
        end = match.end()
    if end != len(key) or not steps:
        raise CalibrationError(f"'{key}' is no key path", expected="such as sensors[0].probes[1].tip")
    return tuple(steps)


@dataclass(frozen=True)
class _Splice:
    begin: int
    end: int
    text: str


def edited(text: str, source: str, changes: Mapping[str, Any]) -> str:
    """Return a YAML document with some entries replaced or added.

    Args:
        text: The document.
        source: What to call it in complaints.
        changes: New content by key path; the mapping that holds the entry must be there already. A quantity (a mapping
            with ``value`` and ``unit``) is written on one line.

    Raises:
        CalibrationError: The document is not YAML, a key leads nowhere, or an entry cannot be changed without another,
            since both are one by an alias or a merge.

    """
    root, content = read_yaml(text, source)
    plain: Any = _unshared(content)
    splices: list[tuple[int, int, int, _Splice]] = []
    for key, new in changes.items():
        steps = parsed(key)
        splice = _splice(text, source, root, steps, new)
        # From the end on; where several are added at one place, the inner ones come before the outer ones.
        splices.append((splice.begin, -len(steps), len(splices), splice))
        _put(plain, steps, new)
    for *_, splice in sorted(splices, reverse=True):
        text = text[: splice.begin] + splice.text + text[splice.end :]
    try:
        changed = read_yaml(text, source)[1]
    except CalibrationError:
        changed = None
    if changed != plain:
        raise CalibrationError(
            f"{', '.join(changes)} cannot be changed alone",
            where=source,
            expected="entries that stand by themselves, without aliases, anchors or merges",
        )
    return text


def _unshared(content: Any) -> Any:
    """Return a copy of plain content in which nothing stands twice."""
    if isinstance(content, dict):
        return {key: _unshared(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_unshared(value) for value in content]
    return content


def _put(content: Any, steps: tuple[str | int, ...], new: Any) -> None:
    for step in steps[:-1]:
        content = content[step]
    content[steps[-1]] = new


def _splice(text: str, source: str, root: yaml.Node | None, steps: tuple[str | int, ...], new: Any) -> _Splice:
    """Return the change of text that puts new content at the end of a path."""
    parent, flow = root, False
    for step in steps[:-1]:
        flow = flow or _in_flow(parent)
        found = _entry(parent, step)
        if found is None:
            raise CalibrationError(f"key '{step}' is missing", where=Places(source, root).of(*steps))
        parent = found[1]
    flow = flow or _in_flow(parent)
    found = _entry(parent, steps[-1])
    if found is not None:
        name, node = found
        end = _end(text, node)
        if name is None:
            indent = node.start_mark.column
            return _Splice(node.start_mark.index, end, _written(new, indent, flow=True))
        indent = name.start_mark.column + 2
        return _Splice(name.end_mark.index, end, _after_key(new, indent, flow=flow))
    if not isinstance(parent, yaml.MappingNode) or not isinstance(steps[-1], str):
        raise CalibrationError(f"entry {steps[-1]} is missing", where=Places(source, root).of(*steps))
    key = _written(steps[-1], 0, flow=True)
    end = _end(text, parent)
    if _in_flow(parent):
        comma = ", " if parent.value else ""
        return _Splice(end - 1, end - 1, comma + key + _after_key(new, parent.start_mark.column + 2, flow=True))
    column = parent.value[0][0].start_mark.column
    return _Splice(end, end, "\n" + " " * column + key + _after_key(new, column + 2, flow=flow))


def _in_flow(node: yaml.Node | None) -> bool:
    return isinstance(node, yaml.CollectionNode) and bool(node.flow_style)


def _entry(node: yaml.Node | None, step: str | int) -> tuple[yaml.Node | None, yaml.Node] | None:
    """Return the key's node (None in a list) and the node of an entry; None if there is no such entry."""
    if isinstance(node, yaml.MappingNode):
        found = [entry for entry in node.value if entry[0].value == str(step)]
        return found[-1] if found else None
    if isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
        return None, node.value[step]
    return None


def _end(text: str, node: yaml.Node) -> int:
    """Return where a node's text ends, without the comments and line ends that YAML counts to a block."""
    while isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        node = last[1] if isinstance(node, yaml.MappingNode) else last
    return len(text[: node.end_mark.index].rstrip())


def _after_key(content: Any, indent: int, *, flow: bool) -> str:
    nested = isinstance(content, dict | list) and bool(content)
    quantity = isinstance(content, dict) and {"value", "unit"} <= content.keys()
    if flow or quantity or not nested:
        return ": " + _written(content, indent, flow=True)
    return ":\n" + " " * indent + _written(content, indent, flow=False)


def _written(content: Any, indent: int, *, flow: bool) -> str:
    """Return content as YAML, its lines after the first indented."""
    style = True if flow else None
    width = max(_WIDTH - indent, _WIDTH // 2)
    text = yaml.dump(
        content, Dumper=StrictDumper, default_flow_style=style, sort_keys=False, allow_unicode=True, width=width
    )
    lines = text.removesuffix("...\n").rstrip("\n").split("\n")
    return ("\n" + " " * indent).join(lines)
