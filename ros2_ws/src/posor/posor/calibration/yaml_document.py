# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Read YAML files strictly, and name file, line and key of every problem.

Duplicate keys, several documents, recursive aliases, aliases that expand to too much, deep nesting, and lists and
mappings with what may be a decimal comma (``[0,5, 1,2]``, ``{a: 0,5}``) are refused.

Scalars without quotes: ``1_000``, ``0x1F``, ``0o17``, ``0b101``, ``.5``, ``+1.5`` and ``2e-5`` are numbers. What YAML
1.1 and 1.2 read differently (``010`` is 8 or 10, ``1:30`` is 90 or text) is text, which is refused, with a hint,
where a number is expected. ``yes``, ``no``, ``on``, ``off``, ``true`` and ``false`` are truth values, as in ROS.
Dates and keys are text.

Positions come from PyYAML's nodes: ``ruamel.yaml``, which keeps positions itself, takes nine times as long to load a
calibration file, and needs the same code for strictness and dotted keys.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeVar

import yaml
from pydantic import ValidationError

from posor.calibration.file_model import TEXT, all_problems, format_value
from posor.errors import CalibrationError, sum_up
from posor.input_text import read_input_text

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor.calibration.file_model import Problem

Document = TypeVar("Document")

WIDTH = 120  # letters in a line of a file that is written
_MAX_DEPTH = 50
_MAX_NODES = 200_000
"""Largest number of nodes with all aliases expanded; the largest calibration files have some 10,000."""
_LARGEST_INTEGER = 2**64
_FEW = 2  # numbers in a list whose comma may be a decimal one in silence: their count is checked
_HALF_CHARACTER = re.compile("[\ud800-\udfff]")  # of UTF-16, which no file can hold
_TEXT, _MERGE = "tag:yaml.org,2002:str", "tag:yaml.org,2002:merge"
_INTEGER = "tag:yaml.org,2002:int"
_FLOAT = "tag:yaml.org,2002:float"
_DECIMAL_POINT = "with a decimal point"
_DECIMAL_COMMA = re.compile(r"[0-9],[0-9]")
_WHOLE, _DIGITS = re.compile(r"[-+]?[0-9]+"), re.compile(r"[0-9]+")
_HINTS = (
    (r"[-+]?0[0-9_]+", "without leading zeros, octal as 0o17"),
    (r"[-+]?[0-9_]+(:[0-9_]+)+(\.[0-9_]*)?", "without colons, which YAML 1.1 reads as base 60"),
    (r"[-+]?[0-9_. ]*,[0-9_. ]*", _DECIMAL_POINT),
    (r"[-+]?[0-9]+([ _.][0-9]+)+", "with underscores, or nothing, between groups of digits"),
    (r"0X[0-9A-Fa-f]+|[0-9A-F]+[hH]|[$][0-9A-Fa-f]+", "hexadecimal as 0x1F"),
    (r"[\u2010-\u2015\u2212][0-9.].*", "with the minus sign '-'"),
)
"""Text that its author takes for a number, and how to write the number."""


def _are_adjacent(first: yaml.Node, second: yaml.Node) -> bool:
    """Return whether only a comma is between two nodes."""
    return bool(second.start_mark.index - first.end_mark.index == 1)


def _refuse_decimal_comma(first: yaml.Node, second: yaml.Node) -> None:
    """Refuse two scalars that may be one number with a decimal comma."""
    scalars = isinstance(first, yaml.ScalarNode) and isinstance(second, yaml.ScalarNode)
    if scalars and _are_adjacent(first, second) and _WHOLE.fullmatch(first.value) and _DIGITS.fullmatch(second.value):
        problem = f"{first.value},{second.value} is one number, to be written {first.value}.{second.value}, or two"
        raise yaml.MarkedYAMLError(problem=f"{problem}, with a space after the comma", problem_mark=first.start_mark)


class StrictLoader(yaml.SafeLoader):
    """PyYAML's safe loader, stricter."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._open: list[str | None] = []
        self._nodes = 0  # so far, aliases expanded
        self._nodes_of: dict[str | None, int] = {}  # of each anchor

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose a node; refuse recursive aliases and deep nesting."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        mark = event.start_mark
        if isinstance(event, yaml.AliasEvent):
            if event.anchor in self._open:
                problem = f"alias '{event.anchor}' is inside its own anchor"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
            self._count(self._nodes_of.get(event.anchor, 0), mark)
            return super().compose_node(parent, index)
        if len(self._open) == _MAX_DEPTH:
            raise yaml.MarkedYAMLError(problem="it is nested too deeply", problem_mark=mark)
        before = self._nodes
        self._count(1, mark)
        self._open.append(event.anchor)
        node = super().compose_node(parent, index)
        self._open.pop()
        if event.anchor is not None:
            self._nodes_of[event.anchor] = self._nodes - before
        return node

    def _count(self, nodes: int, mark: yaml.Mark) -> None:
        self._nodes += nodes
        if self._nodes > _MAX_NODES:
            problem = f"with its aliases expanded it has more than {_MAX_NODES} entries"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:  # PyYAML's stubs call it a dict
        """Compose a mapping, whose keys are text as written; refuse duplicate keys."""
        node = super().compose_mapping_node(anchor)
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != _MERGE:
                key.tag = _TEXT
                if key.value in lines:
                    problem = f"duplicate key '{key.value}', also in line {lines[key.value]}"
                    raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
                lines[key.value] = key.start_mark.line + 1
        if node.flow_style:
            for (_, former), (key, value) in pairwise(node.value):
                if isinstance(value, yaml.ScalarNode) and not (value.value or value.style):
                    _refuse_decimal_comma(former, key)
        return node

    def compose_sequence_node(self, anchor: Any) -> yaml.SequenceNode:
        """Compose a list; refuse numbers with decimal commas where spaces show them, as in ``[0,5, 1,2]``."""
        node: yaml.SequenceNode = super().compose_sequence_node(anchor)
        if node.flow_style and len(node.value) > _FEW:
            adjacent = [_are_adjacent(*pair) for pair in pairwise(node.value)]
            if not all(adjacent) and not any(a and b for a, b in pairwise(adjacent)):
                for pair, is_adjacent in zip(pairwise(node.value), adjacent, strict=True):
                    if is_adjacent:
                        _refuse_decimal_comma(*pair)
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> object:  # noqa: FBT001, FBT002  PyYAML's
        """Construct an object; report text that Python cannot convert as an error of the file."""
        try:
            content = super().construct_object(node, deep)
        except (ValueError, ArithmeticError, LookupError, AttributeError, TypeError) as error:
            problem = str(error) if isinstance(error, ValueError) else f"'{node.value}' does not fit the tag {node.tag}"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark) from error
        if isinstance(content, int) and abs(content) > _LARGEST_INTEGER:
            problem = "it contains a whole number of more than 64 bits"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)
        if isinstance(content, str) and _HALF_CHARACTER.search(content):
            problem = "it contains half of a character, \\ud800 to \\udfff"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)
        return content


class FastLoader(StrictLoader):
    """The same on the parser of libyaml, many times as fast."""

    def __init__(self, text: str) -> None:
        super().__init__("")
        self._parser: Any = yaml.CSafeLoader(text)

    def check_event(self, *choices: Any) -> bool:
        """Return whether the next event is of one of these types."""
        return bool(self._parser.check_event(*choices))

    def peek_event(self) -> Any:
        """Return the next event without consuming it."""
        return self._parser.peek_event()

    def get_event(self) -> Any:
        """Consume the next event."""
        return self._parser.get_event()


_NUMBERS = (
    (
        _INTEGER,
        re.compile(
            r"[-+]?(?:0|[1-9](?:_?[0-9])*|0x[0-9a-fA-F](?:_?[0-9a-fA-F])*|0o[0-7](?:_?[0-7])*|0b[01](?:_?[01])*)$"
        ),
        list("-+0123456789"),
    ),
    (
        _FLOAT,
        re.compile(
            r"""[-+]?(?:(?:0|[1-9](?:_?[0-9])*)\.(?:[0-9](?:_?[0-9])*)?(?:[eE][-+]?[0-9]+)?
            |\.[0-9](?:_?[0-9])*(?:[eE][-+]?[0-9]+)?
            |(?:0|[1-9](?:_?[0-9])*)[eE][-+]?[0-9]+
            |\.(?:inf|Inf|INF))$
            |\.(?:nan|NaN|NAN)$""",
            re.VERBOSE,
        ),
        list("-+.0123456789"),
    ),
)
_REPLACED = (_INTEGER, _FLOAT, "tag:yaml.org,2002:timestamp", "tag:yaml.org,2002:value")
"""Types of YAML 1.1 that scalars without quotes do not have here, or by other patterns."""
StrictLoader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in _REPLACED]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _tag, _pattern, _first in _NUMBERS:
    StrictLoader.add_implicit_resolver(_tag, _pattern, _first)


class StrictDumper(yaml.SafeDumper):
    """PyYAML's safe dumper; quotes text that any YAML version reads as a number, such as ``3e-06``."""


for _tag, _pattern, _first in _NUMBERS:
    StrictDumper.add_implicit_resolver(_tag, _pattern, _first)


def parse_yaml(text: str, source: str) -> tuple[yaml.Node | None, object]:
    """Return the root node of a YAML document, which knows line numbers, and its content.

    ``source``: name of the document in errors, such as the path of the file. Raises CalibrationError: the text is not
    YAML, or is ambiguous YAML.
    """
    try:
        return _compose(FastLoader(text) if yaml.__with_libyaml__ else StrictLoader(text))
    except yaml.YAMLError:
        pass  # repeated below for the error messages of PyYAML's own parser
    try:
        return _compose(StrictLoader(text))
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        problem = f"it contains the control character 0x{ord(text[error.position]):02X}"
        raise CalibrationError(f"is not YAML: {problem}", where=f"{source}, line {line}") from error
    except yaml.MarkedYAMLError as error:
        where = f"{source}, line {error.problem_mark.line + 1}" if error.problem_mark else source
        problem = ", ".join(part for part in (error.context, error.problem) if part)
        raise CalibrationError(f"is not YAML: {problem}", where=where) from error


def _compose(loader: StrictLoader) -> tuple[yaml.Node | None, object]:
    root = loader.get_single_node()
    return root, None if root is None else loader.construct_document(root)


@dataclass(frozen=True)
class FileLocations:
    """Finds file, line and key of the entries of a YAML file."""

    source: str  # name of the file
    root: yaml.Node | None  # its root node, from ``parse_yaml``

    def describe(self, *location: str | int) -> str:
        """Return ``file, line n, key a.b[0].c``; ``location`` as for ``find``."""
        line, key = self.find(*location)
        return f"{self.source}, line {line}" + (f", key {key}" if key else "")

    def find(self, *location: str | int) -> tuple[int, str]:
        """Return line and key ``a.b[0].c`` of an entry.

        ``location``: keys and indices of the entry. Parts that are not in the file (a missing key, the tag of a union)
        are left out. A part with dots may be nested mappings in the file.
        """
        line, key, _ = self._find(location)
        return line, key

    def scalar(self, *location: str | int) -> yaml.ScalarNode | None:
        """Return the scalar at a location, whose ``style`` is empty without quotes; None for anything else."""
        node = self._find(location)[2]
        return node if isinstance(node, yaml.ScalarNode) else None

    def _find(self, location: Sequence[str | int]) -> tuple[int, str, yaml.Node | None]:
        """Return line, key and node of an entry."""
        node, line, key = self.root, 1, ""
        parts = [*reversed(location)]
        while parts:
            part = parts.pop()
            if isinstance(node, yaml.MappingNode):
                entry = _find_entry(node, str(part))
                if entry is not None:
                    name, node = entry
                    line = name.start_mark.line + 1
                    key += f".{name.value}"
                    if name.value != str(part):
                        parts.append(str(part).removeprefix(f"{name.value}."))
            elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
                node = node.value[part]
                line = node.start_mark.line + 1
                key += f"[{part}]"
        return line, key.lstrip("."), node


def _find_entry(node: yaml.MappingNode, key: str) -> tuple[yaml.Node, yaml.Node] | None:
    """Return key and value nodes of a key, or else of a mapping whose name is the first part of a dotted key."""
    exact = [entry for entry in node.value if entry[0].value == key]
    groups = [entry for entry in node.value if key.startswith(f"{entry[0].value}.")]
    # Keys from a merge come before the keys that replace them.
    return next(iter([*reversed(exact), *reversed(groups)]), None)


def read_text(path: Path, kind: str) -> str:
    """Return the text of a file; ``kind`` names the kind of file in errors.

    Raises CalibrationError: the file cannot be read.
    """
    try:
        return read_input_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        what = f"cannot be read: {reason}"
        raise CalibrationError(what, where=f"{kind} {path}", expected=f"a YAML {kind}") from error


def load_document(
    path: Path, kind: str, keys: str, version: int, validate: Callable[[dict[str, Any]], Document]
) -> tuple[Document, FileLocations]:
    """Read and validate a YAML file that states the version of its format.

    ``kind``: kind of file in errors, such as ``calibration file``. ``keys``: required keys, for the error of a file
    that is not a mapping. ``version``: version of the format. ``validate``: converts the content to the document;
    raises pydantic's ValidationError. Raises CalibrationError: the file cannot be read, is not YAML, or has invalid
    content.
    """
    return parse_document(read_text(path, kind), str(path), keys, (version,), validate)


def parse_document(
    text: str, source: str, keys: str, versions: tuple[int, ...], validate: Callable[[dict[str, Any]], Document]
) -> tuple[Document, FileLocations]:
    """Validate a YAML document as ``load_document`` does; ``source`` is its name in errors.

    Raises CalibrationError: the text is not YAML, or has invalid content.
    """
    root, content = parse_yaml(text, source)
    locations = FileLocations(source, root)
    if not isinstance(content, dict):
        raise CalibrationError("is not a mapping", where=f"{source}, line 1", expected=keys)
    version = content.get("version")
    if type(version) is not int or version not in versions:  # True and 1.0 are equal to 1
        _refuse_other_format({**content, "version": versions[-1]}, locations, validate)
        what = f"version {format_value(version)}" if "version" in content else "key 'version' is missing"
        known = " or ".join(", ".join(str(number) for number in versions).rsplit(", ", 1))
        if type(version) is int and version > max(versions):
            known += f", or a later release of this software, which reads version {version}"
        raise CalibrationError(what, where=locations.describe("version"), expected=known)
    try:
        return validate(content), locations
    except ValidationError as error:
        problems = all_problems(error, content, validate)
        raise sum_up([_error_of(problem, locations) for problem in problems]) from error


def _refuse_other_format(
    content: dict[str, Any], locations: FileLocations, validate: Callable[[dict[str, Any]], object]
) -> None:
    """Raise CalibrationError: the document has another format, so its version says nothing."""
    try:
        validate(content)
    except ValidationError as error:
        for problem in all_problems(error, content, validate):
            if problem.location == ("format",):
                raise _error_of(problem, locations) from error


def _error_of(problem: Problem, locations: FileLocations) -> CalibrationError:
    """Return the error of one problem, with the notation of the value as it stands in the file."""
    what, expected, scalar = problem.what, problem.expected, locations.scalar(*problem.location)
    written = scalar.value if scalar is not None and not scalar.style else ""
    if written and expected == TEXT:
        what = f"{written} without quotes"
    elif written and what == format_value(written) and "number" in expected:
        hint = next((hint for text, hint in _HINTS if re.fullmatch(text, written)), "")
        expected += f", {hint}" if hint and (hint != _DECIMAL_POINT or "whole" not in expected) else ""
    elif scalar is not None and expected.startswith("a number") and _DECIMAL_COMMA.search(scalar.value):
        expected += f", {_DECIMAL_POINT}"
    return CalibrationError(what, where=locations.describe(*problem.location), expected=expected)
