"""YAML without its traps: every key once, one document, no endless aliases, and only plain decimals are numbers.

YAML 1.1 reads ``010`` as 8 and ``1:30`` as 90, and takes ``2e-5`` for text. Here the first two are text, which is then
refused where a number is expected, and the last is a number.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

from posor_estimator.errors import CalibrationError

_DEEPEST = 50
_INTEGER = "tag:yaml.org,2002:int"
_FLOAT = "tag:yaml.org,2002:float"


class StrictLoader(yaml.SafeLoader):
    """The safe loader, stricter."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._open: list[str | None] = []

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose a node; refuse an alias of a node that is not yet complete, and nodes without end."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        mark = event.start_mark
        if isinstance(event, yaml.AliasEvent):
            if event.anchor in self._open:
                problem = f"alias '{event.anchor}' stands inside what it names"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
            return super().compose_node(parent, index)
        if len(self._open) == _DEEPEST:
            raise yaml.MarkedYAMLError(problem="it is nested too deeply", problem_mark=mark)
        self._open.append(event.anchor)
        node = super().compose_node(parent, index)
        self._open.pop()
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:  # PyYAML's stubs call it a dict
        """Compose a mapping; refuse a key that stands twice."""
        node = super().compose_mapping_node(anchor)
        lines: dict[tuple[str, str], int] = {}
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                name = (key.tag, key.value)
                if name in lines:
                    problem = f"key '{key.value}' stands here and in line {lines[name]}"
                    raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
                lines[name] = key.start_mark.line + 1
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> object:  # noqa: FBT001, FBT002  PyYAML's
        """Construct an object; what Python cannot make of the text is a mistake in the file."""
        try:
            return super().construct_object(node, deep)
        except (ValueError, ArithmeticError, LookupError, AttributeError, TypeError) as error:
            problem = str(error) if isinstance(error, ValueError) else f"'{node.value}' does not fit the tag {node.tag}"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark) from error


class FastLoader(StrictLoader):
    """The same of what libyaml parses, where it is there: many times as fast."""

    def __init__(self, text: str) -> None:
        super().__init__("")
        self._parser: Any = yaml.CSafeLoader(text)

    def check_event(self, *choices: Any) -> bool:
        """Return whether the next event is one of some kinds."""
        return bool(self._parser.check_event(*choices))

    def peek_event(self) -> Any:
        """Return the next event, and leave it there."""
        return self._parser.peek_event()

    def get_event(self) -> Any:
        """Take the next event."""
        return self._parser.get_event()


StrictLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in (_INTEGER, _FLOAT)]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_NUMBERS = (
    (_INTEGER, re.compile(r"[-+]?(?:0|[1-9][0-9]*)$"), list("-+0123456789")),
    (
        _FLOAT,
        re.compile(
            r"""[-+]?(?:(?:0|[1-9][0-9]*)\.[0-9]*(?:[eE][-+]?[0-9]+)?
            |\.[0-9]+(?:[eE][-+]?[0-9]+)?
            |(?:0|[1-9][0-9]*)[eE][-+]?[0-9]+
            |\.(?:inf|Inf|INF))$
            |\.(?:nan|NaN|NAN)$""",
            re.VERBOSE,
        ),
        list("-+.0123456789"),
    ),
)
for _tag, _pattern, _first in _NUMBERS:
    StrictLoader.add_implicit_resolver(_tag, _pattern, _first)


class StrictDumper(yaml.SafeDumper):
    """The safe dumper, which quotes a text that either kind of YAML would take for a number, such as ``3e-06``."""


for _tag, _pattern, _first in _NUMBERS:
    StrictDumper.add_implicit_resolver(_tag, _pattern, _first)


def read_yaml(text: str, source: str) -> tuple[yaml.Node | None, object]:
    """Return the node at the root of a YAML document, which knows lines, and the content.

    Args:
        text: The document.
        source: What to call it in an error, such as the file's path.

    Raises:
        CalibrationError: It is not YAML, or YAML that can be misread.

    """
    try:
        return _read(FastLoader(text) if yaml.__with_libyaml__ else StrictLoader(text))
    except yaml.YAMLError:
        pass  # what is wrong is said as PyYAML's own reader says it
    try:
        return _read(StrictLoader(text))
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        problem = f"it holds the control character 0x{ord(text[error.position]):02X}"
        raise CalibrationError(f"is not YAML: {problem}", where=f"{source}, line {line}") from error
    except yaml.MarkedYAMLError as error:
        place = f"{source}, line {error.problem_mark.line + 1}" if error.problem_mark else source
        problem = ", ".join(part for part in (error.context, error.problem) if part)
        raise CalibrationError(f"is not YAML: {problem}", where=place) from error


def _read(loader: StrictLoader) -> tuple[yaml.Node | None, object]:
    root = loader.get_single_node()
    return root, None if root is None else loader.construct_document(root)
