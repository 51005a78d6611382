# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The composition file: the nodes of one process, with their names and parameters; and the registry of node classes.

Packages register node classes as entry points of the group ``posor_estimator.nodes``.

Versions of the format:

1. First version: ``realtime``; ``nodes``, each with ``node``, ``name``, ``namespace``, ``parameters``, ``remappings``.
"""

from __future__ import annotations

import re
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from posor.calibration.file_model import EntryError, FrozenModel, format_value
from posor.calibration.yaml_document import load_document
from posor.errors import ParameterError
from posor.node_parameters import RealtimeParameters
from posor.plugins import load_class, registered
from posor_ros.lifecycle_node import PosorNode
from posor_ros.ros_arguments import ros_arguments
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from posor.calibration.yaml_document import FileLocations
    from posor.errors import PosorError

VERSION = 1
NODE_ENTRY_POINTS = "posor_estimator.nodes"
_SCALAR = bool | int | float | str


def load_node_class(name: str) -> type[PosorNode[Any]]:
    """Return the registered node class ``name``.

    Raises ParameterError: the name is unknown, or the class cannot be loaded.
    """
    entries, where = registered(NODE_ENTRY_POINTS), f"node '{name}'"
    if name not in entries:
        raise ParameterError("is unknown", where=where, expected=f"one of {', '.join(map(repr, entries))}")
    found: type[PosorNode[Any]] = load_class(entries[name], PosorNode, partial(ParameterError, where=where))
    return found


def _check_node(name: str) -> str:
    if name not in (known := registered(NODE_ENTRY_POINTS)):
        raise EntryError(f"node {format_value(name)} is unknown", expected=f"one of {', '.join(map(repr, known))}")
    return name


def _check_name(name: str) -> str:
    if name and not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
        raise EntryError(f"name {format_value(name)}", expected="letters, digits and underscores, no digit first")
    return name


def _check_namespace(name: str) -> str:
    if not re.fullmatch(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+", name):
        raise EntryError(
            f"namespace {format_value(name)}", expected="names with a slash before each, such as '/arm/joint1'"
        )
    return name


def _flatten_parameters(value: object) -> object:
    """Return parameters by their full names: groups may be written as mappings, as in ROS parameter files."""
    if not isinstance(value, dict):
        raise EntryError(format_value(value), expected="a mapping")
    return dict(_flat_items(value, ()))


def _flat_items(values: dict[str, Any], group: tuple[str, ...]) -> Iterator[tuple[str, object]]:
    for name, value in values.items():
        path = (*group, name)
        if isinstance(value, dict):
            yield from _flat_items(value, path)
        elif all(isinstance(item, _SCALAR) for item in (value if isinstance(value, list) else [value])):
            yield ".".join(path), value
        else:
            raise EntryError(
                format_value(value), key=path, expected="a truth value, a number, a text or a list of these"
            )


class NodeEntry(FrozenModel):
    """One node of the process."""

    node: Annotated[str, AfterValidator(_check_node)]
    name: Annotated[str, AfterValidator(_check_name)] = ""
    namespace: Annotated[str, AfterValidator(_check_namespace)] = "/"
    parameters: Annotated[dict[str, Any], BeforeValidator(_flatten_parameters)] = Field(default_factory=dict)
    remappings: dict[str, str] = Field(default_factory=dict)

    @property
    def full_name(self) -> str:
        """The node's name in the graph."""
        return f"{self.namespace.rstrip('/')}/{self.name or self.node}"

    def arguments(self) -> list[str]:
        """Return the command line of a process of this node alone, so that rclpy parses both in the same way."""
        return ros_arguments(self.parameters, self.namespace, name=self.name, remappings=self.remappings)

    def create_node(self) -> PosorNode[Any]:
        """Create the node.

        Raises ParameterError: the class cannot be loaded, or a parameter is wrong, missing or unknown.
        """
        return load_node_class(self.node)(cli_args=self.arguments())


class Composition(FrozenModel):
    """A composition file. Nodes start in its order and stop in the reverse order."""

    format: Literal["posor_composition"]
    version: Literal[1]
    realtime: RealtimeParameters = RealtimeParameters()
    nodes: Annotated[list[NodeEntry], Field(min_length=1)]

    @model_validator(mode="after")
    def _check_names_differ(self) -> Self:
        names = [entry.full_name for entry in self.nodes]
        for number, name in enumerate(names):
            if name in names[:number]:
                raise EntryError(
                    f"a second node {name}", key=("nodes", number), expected="another name or another namespace"
                )
        return self


def error_location(places: FileLocations, number: int, entry: NodeEntry, error: PosorError) -> str:
    """Return the line of the parameter that causes an error of a node, or else the line of the node.

    ``places``: positions in the file; ``number``: index of the node's entry.
    """
    parameter = error.parameter if isinstance(error, ParameterError) else ""
    return places.describe("nodes", number, *(("parameters", parameter) if parameter in entry.parameters else ()))


def load_composition(path: Path) -> tuple[Composition, FileLocations]:
    """Read a composition file; return also the positions of its entries.

    Raises CalibrationError: the file cannot be read, is not YAML, or has an invalid entry.
    """
    return load_document(path, "composition file", "format, version, nodes", VERSION, Composition.model_validate)
