# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Change entries of a YAML text; comments and layout of all other entries are preserved."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import yaml

from posor.calibration.yaml_document import WIDTH, FileLocations, StrictDumper, parse_yaml
from posor.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Mapping

_STEP = re.compile(r"(?:^|(?<=.)\.)([^.\[\]]+)|\[(\d+)\]")


def parse_key_path(key: str) -> tuple[str | int, ...]:
    """Return the steps of a key path such as ``sensors[0].probes[1].tip``.

    Raises CalibrationError: the key path is malformed.
    """
    steps: list[str | int] = []
    end = 0
    for match in _STEP.finditer(key):
        if match.start() != end:
            break
        steps.append(match[1] if match[1] is not None else int(match[2]))
        end = match.end()
    if end != len(key) or not steps:
        raise CalibrationError(f"malformed key path '{key}'", expected="such as sensors[0].probes[1].tip")
    return tuple(steps)


@dataclass(frozen=True)
class _Replacement:
    """New text for a range of characters."""

    begin: int
    end: int
    text: str


def edit_document(text: str, source: str, changes: Mapping[str, Any]) -> str:
    """Return a YAML document with some entries replaced or added.

    ``source``: name of the document in errors. ``changes``: new content by key path; the mapping of the entry must
    exist. A quantity (a mapping with ``value`` and ``unit``) is written on one line. Raises CalibrationError: the
    document is not YAML, a key path leads nowhere, or an entry shares its content with another one by an alias or a
    merge.
    """
    root, content = parse_yaml(text, source)
    plain: Any = _without_aliases(content)
    replacements: list[tuple[int, int, int, _Replacement]] = []
    for key, new in changes.items():
        steps = parse_key_path(key)
        replacement = _replacement(text, source, root, steps, new)
        # Applied from the end of the text; of several additions at one position the inner ones come first.
        replacements.append((replacement.begin, -len(steps), len(replacements), replacement))
        _set_entry(plain, steps, new)
    for *_, replacement in sorted(replacements, reverse=True):
        text = text[: replacement.begin] + replacement.text + text[replacement.end :]
    try:
        changed = parse_yaml(text, source)[1]
    except CalibrationError:
        changed = None
    if changed != plain:
        what = f"{', '.join(changes)} cannot be changed alone"
        raise CalibrationError(what, where=source, expected="entries without aliases, anchors or merges")
    return text


def _without_aliases(content: Any) -> Any:
    """Return a deep copy in which aliases are separate objects."""
    if isinstance(content, dict):
        return {key: _without_aliases(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_without_aliases(value) for value in content]
    return content


def _set_entry(content: Any, steps: tuple[str | int, ...], new: Any) -> None:
    for step in steps[:-1]:
        content = content[step]
    content[steps[-1]] = new


def _replacement(
    text: str, source: str, root: yaml.Node | None, steps: tuple[str | int, ...], new: Any
) -> _Replacement:
    """Return the change of text that sets the entry of a key path."""
    parent, flow = root, False
    for step in steps[:-1]:
        flow = flow or _in_flow(parent)
        found = _find_entry(parent, step)
        if found is None:
            raise CalibrationError(f"key '{step}' is missing", where=FileLocations(source, root).describe(*steps))
        parent = found[1]
    flow = flow or _in_flow(parent)
    found = _find_entry(parent, steps[-1])
    if found is not None:
        name, node = found
        end = _end(text, node)
        if name is None:
            indent = node.start_mark.column
            return _Replacement(node.start_mark.index, end, _format_yaml(new, indent, flow=True))
        indent = name.start_mark.column + 2
        return _Replacement(name.end_mark.index, end, _format_value_of_key(new, indent, flow=flow))
    if not isinstance(parent, yaml.MappingNode) or not isinstance(steps[-1], str):
        raise CalibrationError(f"entry {steps[-1]} is missing", where=FileLocations(source, root).describe(*steps))
    key = _format_yaml(steps[-1], 0, flow=True)
    end = _end(text, parent)
    if _in_flow(parent):
        value = _format_value_of_key(new, parent.start_mark.column + 2, flow=True)
        return _Replacement(end - 1, end - 1, (", " if parent.value else "") + key + value)
    column = parent.value[0][0].start_mark.column
    return _Replacement(end, end, "\n" + " " * column + key + _format_value_of_key(new, column + 2, flow=flow))


def _in_flow(node: yaml.Node | None) -> bool:
    return isinstance(node, yaml.CollectionNode) and bool(node.flow_style)


def _find_entry(node: yaml.Node | None, step: str | int) -> tuple[yaml.Node | None, yaml.Node] | None:
    """Return the key node (None in a list) and the value node of an entry; None if the entry is missing."""
    if isinstance(node, yaml.MappingNode):
        found = [entry for entry in node.value if entry[0].value == str(step)]
        return found[-1] if found else None
    if isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
        return None, node.value[step]
    return None


def _end(text: str, node: yaml.Node) -> int:
    """Return where the text of a node ends, without trailing comments and line ends of a block."""
    while isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        node = last[1] if isinstance(node, yaml.MappingNode) else last
    return len(text[: node.end_mark.index].rstrip())


def _format_value_of_key(content: Any, indent: int, *, flow: bool) -> str:
    nested = isinstance(content, dict | list) and bool(content)
    quantity = isinstance(content, dict) and {"value", "unit"} <= content.keys()
    if flow or quantity or not nested:
        return ": " + _format_yaml(content, indent, flow=True)
    return ":\n" + " " * indent + _format_yaml(content, indent, flow=False)


def _format_yaml(content: Any, indent: int, *, flow: bool) -> str:
    """Return content as YAML with all lines after the first indented."""
    style = True if flow else None
    width = max(WIDTH - indent, WIDTH // 2)
    text = yaml.dump(
        content, Dumper=StrictDumper, default_flow_style=style, sort_keys=False, allow_unicode=True, width=width
    )
    lines = text.removesuffix("...\n").rstrip("\n").split("\n")
    return ("\n" + " " * indent).join(lines)
