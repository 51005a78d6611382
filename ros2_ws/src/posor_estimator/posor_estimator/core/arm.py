"""The arm file: one file that says what an arm consists of, for every program that has to do with it.

Versions of the format:

1. First version: ``urdf``, ``endpoint_frame``, ``beams``, ``joints``, ``chain``, ``driver``, ``scenario``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from posor_estimator.core.calibration.entry import EntryError, shown
from posor_estimator.core.calibration.load import load_calibration, load_document
from posor_estimator.core.calibration.model import Calibration, Provenance
from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.core.chain import Chain, load_chain
from posor_estimator.errors import CalibrationError, ChainError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

VERSION = 1


def _ros_name(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise EntryError(f"name {shown(name)}", expected="letters, digits and underscores, a letter first")
    return name


def _parameter_value(value: object) -> object:
    if isinstance(value, bool | int | float | str) or (
        isinstance(value, list) and all(isinstance(entry, str) for entry in value)
    ):
        return value
    raise EntryError(shown(value), expected="a truth value, a number, a text or a list of texts")


Name = Annotated[str, AfterValidator(_ros_name)]
ParameterValue = bool | int | float | str | list[str]


class JointFile(FrozenModel):
    """Which calibration file, and which session of it, a joint's POSOR has."""

    calibration: str
    session: str = ""


class DriverFile(FrozenModel):
    """Where the scans come from: a source of driver_node, and ROS parameters that all drivers of the arm share."""

    source: str
    parameters: dict[str, Annotated[ParameterValue, BeforeValidator(_parameter_value)]] = Field(default_factory=dict)


class ChainFile(FrozenModel):
    """ROS parameters of the arm's chain_node, beside the files that the arm file names."""

    parameters: dict[str, Annotated[ParameterValue, BeforeValidator(_parameter_value)]] = Field(default_factory=dict)


class ArmFile(FrozenModel):
    """An arm file as written; paths are relative to it."""

    format: Literal["posor_arm"]
    version: Literal[1]
    name: Name
    provenance: Provenance
    urdf: str
    endpoint_frame: str = "endpoint"
    beams: str = ""
    joints: dict[str, JointFile]
    chain: ChainFile = ChainFile()
    driver: DriverFile
    scenario: str = ""

    @model_validator(mode="after")
    def _simulated_has_scenario(self) -> Self:
        if self.driver.source == "simulated" and not self.scenario:
            raise EntryError("key 'scenario' is missing", expected="the simulator's scenario file")
        return self


@dataclass(frozen=True)
class Arm:
    """An arm file with its paths resolved.

    Attributes:
        path: The arm file.
        name: The arm's name, also its ROS namespace.
        urdf: Path of the URDF.
        endpoint_frame: Link whose pose is wanted.
        beams: Path of the beams file; None: straight and exact beams.
        calibrations: Path of each joint's calibration file, in the order of the chain.
        sessions: Session of each joint's calibration.
        chain_parameters: ROS parameters of chain_node, beside the files that the arm file names.
        chain_places: Where in the arm file each of them stands.
        driver: Source and parameters of the drivers.
        scenario: Path of the simulator's scenario; None where there is none.

    """

    path: Path
    name: str
    urdf: Path
    endpoint_frame: str
    beams: Path | None
    calibrations: Mapping[str, Path]
    sessions: Mapping[str, str]
    chain_parameters: Mapping[str, ParameterValue]
    chain_places: Mapping[str, str]
    driver: DriverFile
    scenario: Path | None

    def chain(self) -> Chain:
        """Return the arm's kinematic chain.

        Raises:
            ChainError: The URDF cannot be used, or its POSOR joints are not those of the arm file.
            CalibrationError: The beams file cannot be used.

        """
        chain = load_chain(self.urdf, self.endpoint_frame, self.beams)
        known = tuple(joint.name for joint in chain.joints)
        if set(known) != set(self.calibrations):
            named = ", ".join(self.calibrations) or "none"
            expected = f"{', '.join(known)}, the floating joints of {self.urdf}"
            raise ChainError(f"joints {named}", where=str(self.path), expected=expected)
        return chain

    def calibration(self, joint: str) -> Calibration:
        """Return a joint's calibration with its session applied.

        Raises:
            CalibrationError: The file cannot be used.

        """
        return load_calibration(self.calibrations[joint]).for_session(self.sessions[joint])


def load_arm(path: Path) -> Arm:
    """Read an arm file; the files that it names are not opened yet.

    Raises:
        CalibrationError: The file cannot be read, is not YAML, or says something that cannot be.

    """
    if path.is_dir() or not path.exists():
        raise CalibrationError(
            "there is no such file",
            where=f"arm file {path}",
            expected="the path of an arm file, such as share/posor_bringup/arms/five_axis/arm.yaml",
        )
    keys = "format, version, name, provenance, urdf, joints, driver"
    said, places = load_document(path, "arm file", keys, VERSION, ArmFile.model_validate)
    folder = path.resolve().parent
    return Arm(
        path=path,
        name=said.name,
        urdf=folder / said.urdf,
        endpoint_frame=said.endpoint_frame,
        beams=folder / said.beams if said.beams else None,
        calibrations={name: folder / joint.calibration for name, joint in said.joints.items()},
        sessions={name: joint.session for name, joint in said.joints.items()},
        chain_parameters=said.chain.parameters,
        chain_places={name: places.of("chain", "parameters", name) for name in said.chain.parameters},
        driver=said.driver,
        scenario=folder / said.scenario if said.scenario else None,
    )
