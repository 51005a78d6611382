# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""ROS parameter files: which node a section is for. rclpy ignores a section whose name fits no node without a word."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.calibration.yaml_document import FileLocations, parse_yaml, read_text
from posor.errors import ParameterError, similar_name

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from rclpy.impl.rcutils_logger import RcutilsLogger

OPTION = "--params-file"
PARAMETERS = "ros__parameters"
ALL_NODES = "/**"
_LEADING_ZEROS = re.compile(r"[-+]?0[0-9]+")
SIMILAR = 0.8
"""Similarity of names, 0 to 1, above which one is taken for a misspelling of the other: that of other nodes is 0.6."""


@dataclass(frozen=True)
class ParameterSection:
    """A section of a parameter file."""

    name: str  # full name of a node, such as /arm/joint1/posor_node; * stands for one name, ** for any number of them
    parameters: Mapping[str, Any]  # by full name
    places: Mapping[str, str]  # file, line and key by full name of the parameter
    place: str  # of the section

    def is_for(self, node: str) -> bool:
        """Return whether rclpy gives the parameters to a node, by its full name."""
        pattern = "".join(
            {"**": "(/[^/]+)*", "*": "/[^/]+"}.get(part, re.escape(f"/{part}")) for part in self.name.split("/")[1:]
        )
        return re.fullmatch(pattern, node) is not None


def load_parameter_file(path: Path) -> list[ParameterSection]:
    """Read a parameter file.

    Raises CalibrationError: the file cannot be read or is not YAML; ParameterError: it has no section, or a section has
    no parameters.
    """
    root, content = parse_yaml(read_text(path, "parameter file"), str(path))
    sections = list(_sections(content, (), FileLocations(str(path), root)))
    if not sections:
        raise ParameterError("has no section", where=f"parameter file {path}", expected=_SECTION)
    return sections


_SECTION = f"a node's full name or {ALL_NODES}, below it {PARAMETERS}"


def _sections(content: Any, path: tuple[str, ...], locations: FileLocations) -> Iterator[ParameterSection]:
    if path and not isinstance(content, dict):
        raise ParameterError(f"is not below {PARAMETERS}", where=locations.describe(*path), expected=_SECTION)
    for key, part in content.items() if isinstance(content, dict) else ():
        if key == PARAMETERS:
            name = "/" + "/".join(path).lstrip("/")
            paths = dict(_flat(part, ()))
            parameters = {".".join(parts): value for parts, value in paths.items()}
            places = dict[str, str]()
            for parts in paths:
                place = locations.describe(*path, key, *parts)
                if other := places.get(".".join(parts)):  # as one word and as a group
                    raise ParameterError("is stated twice", where=place, expected=f"once; the other is {other}")
                places[".".join(parts)] = place
            for parts, value in paths.items():
                _refuse_leading_zeros(value, (*path, key, *parts), locations)
            yield ParameterSection(name, parameters, places, locations.describe(*path))
        else:
            yield from _sections(part, (*path, str(key)), locations)


def _refuse_leading_zeros(value: object, path: tuple[str | int, ...], locations: FileLocations) -> None:
    """Refuse a number such as 0100, which is 64 to ROS and text elsewhere."""
    for n, each in enumerate(value) if isinstance(value, list) else ():
        _refuse_leading_zeros(each, (*path, n), locations)
    scalar = locations.scalar(*path)
    if scalar is not None and not scalar.style and _LEADING_ZEROS.fullmatch(scalar.value):
        raise _octal_number(scalar.value, locations.describe(*path))


def _octal_number(text: str, where: str) -> ParameterError:
    expected = "a number without leading zeros, or text in quotes"
    return ParameterError(f"{text} is an octal number to ROS", where=where, expected=expected)


def refuse_octal_arguments(arguments: Sequence[str]) -> None:
    """Raise ParameterError: a parameter on a command line is a number such as 0100, which is 64 to ROS."""
    for option, rule in pairwise(arguments):
        for value in rule.rpartition(":=")[2].strip("[]").split(",") if option in ("-p", "--param") else ():
            if _LEADING_ZEROS.fullmatch(value.strip()):
                raise _octal_number(value.strip(), f"ROS argument {option} {rule}")


def _flat(values: Any, group: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], object]]:
    for name, value in values.items() if isinstance(values, dict) else ():
        if isinstance(value, dict):
            yield from _flat(value, (*group, str(name)))
        else:
            yield (*group, str(name)), value


def parameter_files_of(arguments: Sequence[str]) -> list[Path]:
    """Return the parameter files of the ROS arguments of a command line."""
    return [Path(path) for option, path in pairwise(arguments) if option == OPTION]


def check_sections(files: Sequence[Path], nodes: Sequence[str], logger: RcutilsLogger) -> None:
    """Check that each parameter file has a section for at least one of a program's nodes, by their full names.

    A file may serve several programs, so that sections for other nodes are logged; as a warning if the name of the node
    resembles a name of these. Raises ParameterError: a file has no section for the nodes, or a section has no
    parameters; CalibrationError: a file cannot be read.
    """
    own = {node.rpartition("/")[2]: node for node in nodes}
    for path in files:
        sections = load_parameter_file(path)
        others = [section for section in sections if not any(map(section.is_for, nodes))]
        names = ", ".join(f"'{section.name}'" for section in others)
        where = f"parameter file {path}"
        if len(others) == len(sections):
            what = f"has no section for {' or '.join(nodes)}, only for {names}"
            raise ParameterError(what, where=where, expected=f"'{nodes[0]}' or '{ALL_NODES}'")
        for section in others:
            name = section.name.rpartition("/")[2]
            meant = "" if name in own else similar_name(name, own, "", least=SIMILAR)
            text = f"{section.place}: no node of this program is called '{section.name}', {meant}"
            if meant:
                logger.warning(text)
        text = f"{where}: sections that no node of this program reads: {names}"
        if others:
            logger.info(text)
