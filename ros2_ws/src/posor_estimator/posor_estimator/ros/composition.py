"""The composition file: which nodes run in one process, with which names and parameters.

Versions of the format:

1. First version: ``realtime``; ``nodes``, each with ``node``, ``name``, ``namespace``, ``parameters``, ``remappings``.
"""

from __future__ import annotations

import json
import math
import re
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from posor_estimator.core.calibration.entry import EntryError, shown
from posor_estimator.core.calibration.load import load_document
from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.errors import ParameterError
from posor_estimator.ros.parameters import RealtimeParameters
from posor_estimator.ros.registry import node_class, node_entries

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from posor_estimator.core.calibration.places import Places
    from posor_estimator.errors import PosorError
    from posor_estimator.ros.node import PosorNode

VERSION = 1


def _known_node(name: str) -> str:
    if name not in node_entries():
        raise EntryError(f"node {shown(name)} is unknown", expected=f"one of {', '.join(map(repr, node_entries()))}")
    return name


def _node_name(name: str) -> str:
    if name and not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
        raise EntryError(f"name {shown(name)}", expected="letters, digits and underscores, no digit first")
    return name


def _namespace(name: str) -> str:
    if not re.fullmatch(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+", name):
        raise EntryError(f"namespace {shown(name)}", expected="names with a slash before each, such as '/arm/joint1'")
    return name


def _parameters(value: object) -> object:
    """Return parameters by their whole names: groups may be written as mappings, as in ROS' own parameter files."""
    if not isinstance(value, dict):
        raise EntryError(shown(value), expected="a mapping")
    return dict(_flat(value, ()))


def _flat(values: dict[Any, Any], group: tuple[str, ...]) -> Iterator[tuple[str, object]]:
    for name, value in values.items():
        path = (*group, name)
        if not isinstance(name, str):
            raise EntryError(f"name {shown(name)}", key=path, expected="text")
        if isinstance(value, dict):
            yield from _flat(value, path)
        elif _is_value(value) or (isinstance(value, list) and all(map(_is_value, value))):
            yield ".".join(path), value
        else:
            raise EntryError(shown(value), key=path, expected="a truth value, a number, a text or a list of these")


def _is_value(value: object) -> bool:
    return isinstance(value, bool | int | float | str)


class NodeEntry(FrozenModel):
    """One node of the process."""

    node: Annotated[str, AfterValidator(_known_node)]
    name: Annotated[str, AfterValidator(_node_name)] = ""
    namespace: Annotated[str, AfterValidator(_namespace)] = "/"
    parameters: Annotated[dict[str, Any], BeforeValidator(_parameters)] = Field(default_factory=dict)
    remappings: dict[str, str] = Field(default_factory=dict)

    @property
    def full_name(self) -> str:
        """The node's name in the graph."""
        return f"{self.namespace.rstrip('/')}/{self.name or self.node}"

    def arguments(self) -> list[str]:
        """Return the command line that a process of this node alone would have: the two are read alike."""
        arguments = ["--ros-args", "-r", f"__ns:={self.namespace}"]
        if self.name:
            arguments += ["-r", f"__node:={self.name}"]
        for old, new in self.remappings.items():
            arguments += ["-r", f"{old}:={new}"]
        for name, value in self.parameters.items():
            arguments += ["-p", f"{name}:={_yaml(value)}"]
        return arguments

    def create(self) -> PosorNode[Any]:
        """Create the node.

        Raises:
            ParameterError: Its class cannot be loaded, or a parameter is wrong, missing or unknown.

        """
        return node_class(self.node)(cli_args=self.arguments())


def _yaml(value: object) -> str:
    """Return a value as YAML, which JSON is but for what is not finite."""
    if isinstance(value, list):
        return f"[{', '.join(map(_yaml, value))}]"
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else f"{'-' if value < 0.0 else ''}.inf"
    return json.dumps(value)


class Composition(FrozenModel):
    """A composition file; nodes start in its order and end in the reverse one."""

    format: Literal["posor_composition"]
    version: Literal[1]
    realtime: RealtimeParameters = RealtimeParameters()
    nodes: Annotated[list[NodeEntry], Field(min_length=1)]

    @model_validator(mode="after")
    def _names_are_different(self) -> Self:
        names = [entry.full_name for entry in self.nodes]
        for place, name in enumerate(names):
            if name in names[:place]:
                raise EntryError(
                    f"a second node {name}", key=("nodes", place), expected="another name or another namespace"
                )
        return self


def place_of(places: Places, number: int, entry: NodeEntry, error: PosorError) -> str:
    """Return where the file asks for what cannot be: the line of the parameter at fault, or else of the node.

    Args:
        places: Of the file.
        number: Of the node's entry.
        entry: What it says.
        error: Of the node.

    """
    parameter = error.parameter if isinstance(error, ParameterError) else ""
    return places.of("nodes", number, *(("parameters", parameter) if parameter in entry.parameters else ()))


def load_composition(path: Path) -> tuple[Composition, Places]:
    """Read a composition file; return also where what it says stands.

    Raises:
        CalibrationError: It cannot be read, is not YAML, or says something that cannot be.

    """
    return load_document(path, "composition file", "format, version, nodes", VERSION, Composition.model_validate)
