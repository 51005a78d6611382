# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The arm file: URDF, beams, calibrations, driver and scenario of an arm; the parameters of its nodes.

Versions of the format:

1. First version: ``urdf``, ``endpoint_frame``, ``beams``, ``joints``, ``chain``, ``driver``, ``scenario``; later
   ``serial`` and ``commissioning``, which may be left out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from posor.arm_names import find_arm
from posor.calibration.calibration_file import Calibration, Provenance, load_calibration
from posor.calibration.file_model import EntryError, FrozenModel, Name, format_value
from posor.calibration.yaml_document import load_document
from posor.chain.kinematic_chain import Chain, load_chain
from posor.errors import ChainError, ErrorCollector, NodeError, ParameterError, PosorError, similar_name, sum_up
from posor.node_parameters import ChainParameters, PosorParameters
from posor.parameter_model import check_boolean_parameters, validate_parameters
from posor.ros_names import OUTER_NAMESPACE_RULE, ROS_OWN_PARAMETERS, is_outer_namespace

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.parameter_model import ParameterGroup

VERSION = 1
CHAIN_NODE, POSOR_NODE = "chain_node", "posor_node"
_PLACEHOLDER = re.compile(r"\{(\w+)\}")


def _check_parameter_value(value: object) -> object:
    if isinstance(value, bool | int | float | str) or (
        isinstance(value, list)
        and (
            all(isinstance(entry, str) for entry in value)
            or all(isinstance(entry, int | float) and not isinstance(entry, bool) for entry in value)
        )
    ):
        return value
    expected = "true, false, a number, a text, a list of texts or one of numbers"
    raise EntryError(format_value(value), expected=expected)


ParameterValue = bool | int | float | str | list[str] | list[float]
Filled = dict[str, ParameterValue]

ParameterValues = dict[str, Annotated[ParameterValue, BeforeValidator(_check_parameter_value)]]


class JointFile(FrozenModel):
    """Calibration file and session of the POSOR of a joint, and further ROS parameters of its posor_node."""

    calibration: str
    session: str = ""
    parameters: ParameterValues = Field(default_factory=dict)


class DriverFile(FrozenModel):
    """Source of the scans, and ROS parameters of all driver_nodes of the arm."""

    source: str
    parameters: ParameterValues = Field(default_factory=dict)


class ChainFile(FrozenModel):
    """ROS parameters of the arm's chain_node, besides the files named by the arm file."""

    parameters: ParameterValues = Field(default_factory=dict)


class ArmFileContent(FrozenModel):
    """Content of an arm file; paths are relative to the file."""

    format: Literal["posor_arm"]
    version: Literal[1]
    name: Name
    provenance: Provenance
    serial: str = ""
    urdf: str
    endpoint_frame: str = "endpoint"
    beams: str = ""
    commissioning: str = ""
    joints: dict[Name, JointFile]
    chain: ChainFile = ChainFile()
    driver: DriverFile
    scenario: str = ""

    @model_validator(mode="after")
    def _require_scenario(self) -> Self:
        if self.driver.source == "simulated" and not self.scenario:
            raise EntryError("key 'scenario' is missing", expected="the simulator's scenario file")
        return self


@dataclass(frozen=True)
class ArmFile:
    """An arm file with its paths resolved."""

    path: Path  # the arm file
    name: str  # the arm's name, also the last part of its ROS namespace
    serial: str  # serial number of the arm; empty: not stated
    urdf: Path  # path of the URDF
    endpoint_frame: str  # link of the endpoint
    beams: Path | None  # path of the beams file; None: straight and exact beams
    commissioning: Path | None  # path of the commissioning record, which may not exist yet; None: not named
    calibrations: Mapping[str, Path]  # path of each joint's calibration file, in the order of the chain
    sessions: Mapping[str, str]  # session of each joint's calibration
    # ROS parameters of each joint's posor_node, besides calibration and session
    posor_parameters: Mapping[str, Mapping[str, ParameterValue]]
    # ROS parameters of chain_node, besides the files named by the arm file
    chain_parameters: Mapping[str, ParameterValue]
    # File, line and key of these parameters, by joint ('' for chain_node) and name
    parameter_locations: Mapping[tuple[str, str], str]
    driver_locations: Mapping[str, str]  # file, line and key of each parameter of the drivers, and of ``source``
    joints_location: str  # file, line and key of the joints
    driver: DriverFile  # source and parameters of the drivers
    scenario: Path | None  # path of the simulator's scenario; None: no scenario
    outer_namespace: str = ""  # namespace around that of the arm, such as "/cell1"; empty: the root

    @property
    def namespace(self) -> str:
        """The ROS namespace of chain_node, such as "/cell1/five_axis"; a joint's nodes are in one of its name below."""
        return f"{self.outer_namespace}/{self.name}"

    def in_namespace(self, outer: str) -> Self:
        """Return the same arm in a namespace, such as ``cell1`` or ``/hall/cell1``; empty or ``/``: in the root.

        Raises ParameterError: the namespace is invalid.
        """
        if not is_outer_namespace(outer):
            raise ParameterError(
                f"namespace {format_value(outer)}", where=f"arm {self.name}", expected=OUTER_NAMESPACE_RULE
            )
        parts = outer.strip("/")
        return replace(self, outer_namespace=f"/{parts}" if parts else "")

    def fill_placeholders(self, values: Mapping[str, ParameterValue], joint: str, places: Mapping[str, str]) -> Filled:
        """Return parameters of the arm file for a joint, with {namespace}, {arm}, {joint} and {folder} filled in.

        Raises ParameterError: a placeholder is unknown; ``places`` names the line of each parameter.
        """
        known = {
            "namespace": self.namespace,
            "arm": self.name,
            "joint": joint,
            "folder": str(self.path.resolve().parent),
        }

        def fill(text: str, where: str) -> str:
            for name in _PLACEHOLDER.findall(text):
                if name not in known:
                    expected = "{arm}, {joint}, {namespace} or {folder}"
                    raise ParameterError(f"'{{{name}}}' is an unknown placeholder", where=where, expected=expected)
            return _PLACEHOLDER.sub(lambda match: known[match[1]], text)

        filled: Filled = {}
        for name, value in values.items():
            place = places.get(name, f"{self.path}, parameter {name}")
            if isinstance(value, list):
                filled[name] = [fill(entry, place) if isinstance(entry, str) else entry for entry in value]  # type: ignore[assignment]
            else:
                filled[name] = fill(value, place) if isinstance(value, str) else value
        return filled

    def chain(self) -> Chain:
        """Return the arm's kinematic chain.

        Raises ChainError: the URDF is invalid, or its POSOR joints differ from those of the arm file; CalibrationError:
        the beams file is invalid.
        """
        chain = load_chain(self.urdf, self.endpoint_frame, self.beams)
        joints = tuple(joint.name for joint in chain.joints)
        if set(joints) != set(self.calibrations):
            named = ", ".join(self.calibrations) or "none"
            expected = f"{', '.join(joints)}, the floating joints of {self.urdf}"
            raise ChainError(f"joints {named}", where=self.joints_location, expected=expected)
        return chain

    def calibration(self, joint: str) -> Calibration:
        """Return the calibration of a joint with its session applied.

        Raises ParameterError: the arm has no such joint; CalibrationError: the file is invalid.
        """
        if joint not in tuple(self.calibrations):
            expected = similar_name(str(joint), self.calibrations, f"one of {', '.join(self.calibrations)}")
            raise ParameterError(f"joint {joint!r} is unknown", where="Arm.calibration", expected=expected)
        return load_calibration(self.calibrations[joint]).for_session(self.sessions[joint])

    def node_locations(self, joint: str) -> dict[str, str]:
        """Return file, line and key of each parameter of the posor_node of a joint; '': of chain_node."""
        return {name: place for (owner, name), place in self.parameter_locations.items() if owner == joint}


def load_arm_file(arm: str | Path) -> ArmFile:
    """Read an arm file, given as for ``find_arm``, without opening the files that it names.

    Raises ParameterError: there is no such arm; CalibrationError: the file cannot be read, is not YAML, or has invalid
    content.
    """
    path = find_arm(arm)
    keys = "format, version, name, provenance, urdf, joints, driver"
    content, locations = load_document(path, "arm file", keys, VERSION, ArmFileContent.model_validate)
    folder = path.resolve().parent
    return ArmFile(
        path=path,
        name=content.name,
        serial=content.serial,
        urdf=folder / content.urdf,
        endpoint_frame=content.endpoint_frame,
        beams=folder / content.beams if content.beams else None,
        commissioning=folder / content.commissioning if content.commissioning else None,
        calibrations={name: folder / joint.calibration for name, joint in content.joints.items()},
        sessions={name: joint.session for name, joint in content.joints.items()},
        posor_parameters={name: joint.parameters for name, joint in content.joints.items()},
        chain_parameters=content.chain.parameters,
        parameter_locations={
            **{("", name): locations.describe("chain", "parameters", name) for name in content.chain.parameters},
            **{
                (joint, name): locations.describe("joints", joint, "parameters", name)
                for joint, entry in content.joints.items()
                for name in entry.parameters
            },
        },
        driver_locations={
            "source": locations.describe("driver", "source"),
            **{name: locations.describe("driver", "parameters", name) for name in content.driver.parameters},
        },
        joints_location=locations.describe("joints"),
        driver=content.driver,
        scenario=folder / content.scenario if content.scenario else None,
    )


def chain_parameters(arm: ArmFile, *, checked: bool = True) -> dict[str, ParameterValue]:
    """Return the ROS parameters of an arm's chain_node.

    ``checked``: whether chain_node must accept them. Raises NodeError: the arm file gives chain_node an unknown
    parameter or an invalid value; names the line.
    """
    stated = {name: value for name, value in _file_parameters(arm, "").items() if value}
    parameters = {**stated, **arm.chain_parameters}
    return _checked(arm, "", ChainParameters, parameters) if checked else parameters


def posor_parameters(arm: ArmFile, joint: str, *, checked: bool = True) -> dict[str, ParameterValue]:
    """Return the ROS parameters of a joint's posor_node.

    ``checked``: whether posor_node must accept them. Raises NodeError: the arm file gives posor_node an unknown
    parameter or an invalid value; ParameterError: a placeholder in it is unknown; both name the line.
    """
    filled = arm.fill_placeholders(arm.posor_parameters[joint], joint, arm.node_locations(joint))
    parameters = {**_file_parameters(arm, joint), **filled}
    return _checked(arm, joint, PosorParameters, parameters) if checked else parameters


def _checked(
    arm: ArmFile, joint: str, model: type[ParameterGroup], parameters: dict[str, ParameterValue]
) -> dict[str, ParameterValue]:
    """Return the parameters that are not ROS's own if the node (of a joint; '': chain_node) accepts them.

    Raises NodeError: an error for each that it refuses.
    """
    own = {name: value for name, value in parameters.items() if not name.startswith(ROS_OWN_PARAMETERS)}
    node = f"{joint}/{POSOR_NODE}" if joint else CHAIN_NODE
    errors = ErrorCollector()
    errors.errors.extend(conflicting_parameters(arm, joint, own))
    with errors.collecting():
        check_boolean_parameters(parameters, node=node)
    with errors.collecting():
        validate_parameters(model, own, node=node)
    if errors.errors:
        raise node_errors(errors.errors, node, arm.node_locations(joint), str(arm.path))
    return own


def _file_parameters(arm: ArmFile, joint: str) -> dict[str, str]:
    """Return the parameters of a joint's posor_node ('': of chain_node) that keys of the arm file state; '': none."""
    if joint:
        return {"calibration": str(arm.calibrations[joint]), "session": arm.sessions[joint]}
    return {
        "urdf": str(arm.urdf),
        "endpoint_frame": arm.endpoint_frame,
        "beams": str(arm.beams or ""),
        "commissioning": str(arm.commissioning or ""),
    }


def conflicting_parameters(arm: ArmFile, joint: str, parameters: Mapping[str, ParameterValue]) -> list[ParameterError]:
    """Return an error for each parameter of a node that contradicts the key of the arm file for it.

    ``joint``: of its posor_node; '': chain_node. The arm file alone states the files of the arm: checks and programs
    without nodes read those.
    """
    return [
        ParameterError(
            f"{name}: {format_value(given)}",
            expected=f"{format_value(stated)}, as in the arm file {arm.path}",
            parameter=name,
        )
        for name, stated in _file_parameters(arm, joint).items()
        if isinstance(given := parameters.get(name, stated), str) and not _is_same(name, given, stated)
    ]


def _is_same(name: str, given: str, stated: str) -> bool:
    """Return whether two values of a parameter are equal, or paths of one file."""
    if name in ("session", "endpoint_frame") or not (given and stated) or "\0" in given:
        return given == stated
    return Path(given).resolve() == Path(stated).resolve()


def node_errors(errors: Sequence[PosorError], node: str, places: Mapping[str, str], otherwise: str) -> NodeError:
    """Return the errors of a node's parameters with their places in files, summed up.

    ``places``: file, line and key by the name of the parameter; ``otherwise``: the place of all others.
    """
    names = [error.parameter if isinstance(error, ParameterError) else "" for error in errors]
    return sum_up(
        [NodeError(error, node, places.get(name, otherwise)) for error, name in zip(errors, names, strict=True)]
    )
