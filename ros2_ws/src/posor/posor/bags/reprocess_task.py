# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The work of ``reprocess`` for one bag and its result: plain values that can be sent to another process or machine."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from posor.calibration.calibration_file import load_calibration
from posor.calibration.causes import FALSE_ALARM
from posor.chain.arm_file import CHAIN_NODE, POSOR_NODE, chain_parameters, posor_parameters
from posor.chain.kinematic_chain import load_chain
from posor.errors import check_probability
from posor.node_parameters import ChainParameters, PosorParameters
from posor.parameter_model import validate_parameters
from posor.ros_names import RAW_TOPIC, TRANSFORM_TOPIC

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rosbags.interfaces import Qos

    from posor.calibration.calibration_file import Calibration
    from posor.chain.arm_file import ArmFile, ParameterValue
    from posor.chain.kinematic_chain import Chain
    from posor.messages.cdr_schema import Schema

Format = Literal["bag", "parquet", "csv"]
FORMATS: tuple[Format, ...] = ("bag", "parquet", "csv")


@dataclass(frozen=True)
class JointSettings:
    """A joint's POSOR, as the parameters of its posor_node, and the topic of its scans."""

    calibration: Path  # path of the file
    session: str = ""  # of the calibration; empty: none
    topic: str = ""  # of the raw scans; empty: the only one of the bag that ends in ``/<joint>/raw``, or own_topic
    own_topic: str = ""  # on which the arm publishes the raw scans; empty: there is no arm
    false_alarm: float = FALSE_ALARM  # see ``Posor``

    def load(self) -> Calibration:
        """Return the calibration with its session applied.

        Raises CalibrationError: the file or the session is invalid.
        """
        return load_calibration(self.calibration).for_session(self.session)


@dataclass(frozen=True)
class Settings:
    """Settings for all bags, as the parameters of the nodes in a live graph."""

    joints: Mapping[str, JointSettings]  # the POSORs, by joint
    chain: Mapping[str, ParameterValue] | None = None  # parameters of chain_node; None: transforms only

    @staticmethod
    def of_arm(arm: ArmFile) -> Settings:
        """Return the settings of an arm file. Raises NodeError: the arm file gives a node an invalid parameter."""
        joints = {}
        for name, calibration in arm.calibrations.items():
            node = validate_parameters(PosorParameters, posor_parameters(arm, name), node=f"{name}/{POSOR_NODE}")
            joints[name] = JointSettings(
                calibration,
                arm.sessions[name],
                own_topic=f"{arm.namespace}/{name}/{RAW_TOPIC}",
                false_alarm=node.false_alarm,
            )
        return Settings(joints, chain_parameters(arm))

    def with_false_alarm(self, false_alarm: float | None) -> Settings:
        """Return the settings with this probability for all joints; None: as they are; 0: no scan is rejected.

        Raises ParameterError: ``false_alarm`` is not a probability.
        """
        if false_alarm is None:
            return self
        if false_alarm != 0.0:
            check_probability(false_alarm, "false_alarm")
        return replace(
            self, joints={name: replace(joint, false_alarm=false_alarm) for name, joint in self.joints.items()}
        )

    def load_chain(self) -> tuple[Chain, ChainParameters] | None:
        """Return the kinematic chain and the parameters of chain_node; None without a chain.

        Raises ChainError: the URDF is invalid; CalibrationError: the beams file is invalid; ParameterError: a parameter
        is invalid.
        """
        if self.chain is None:
            return None
        parameters = validate_parameters(ChainParameters, dict(self.chain), node=CHAIN_NODE)
        beams = Path(parameters.beams) if parameters.beams else None
        return load_chain(Path(parameters.urdf), parameters.endpoint_frame, beams), parameters


@dataclass(frozen=True)
class BagTopics:
    """The topics of a bag with raw scans, and how they were recorded."""

    raw: Mapping[str, str]  # topic of each joint's raw scans
    schemas: Mapping[str, Schema]  # of the raw scans, by joint, as the bag defines them
    left_out: tuple[str, ...]  # topics of raw scans of other joints
    offered: Sequence[Qos]  # quality of service with which the raw scans were recorded
    messages: int  # number of raw scans of the joints
    notes: tuple[str, ...] = ()  # what is left out of the bag, and what it lacks, one sentence each
    temperatures: Mapping[str, str] = field(default_factory=dict)  # topic of each thermometer that has one

    @property
    def transforms(self) -> dict[str, str]:
        """Topic of each joint's transforms, beside its raw scans."""
        return {joint: f"{topic.rpartition('/')[0]}/{TRANSFORM_TOPIC}" for joint, topic in self.raw.items()}

    @property
    def namespace(self) -> str:
        """The common prefix of ``/<joint>/raw`` in all joints' topics; empty if the prefixes differ."""
        return common_namespace(self.raw)


def common_namespace(raw: Mapping[str, str]) -> str:
    """Return the common prefix of ``/<joint>/raw`` in the topics of all joints; empty if the prefixes differ."""
    found = {topic.removesuffix(f"/{joint}/{RAW_TOPIC}") for joint, topic in raw.items()}
    same = len(found) == 1 and not found & set(raw.values())
    return found.pop() if same else ""


@dataclass(frozen=True)
class Task:
    """One bag to reprocess."""

    bag: Path  # folder or file
    settings: Settings  # of the estimation
    output: Path | None = None  # folder for the results; None: only the summary is wanted
    format: Format = "bag"  # of the results
    force: bool = False  # whether existing results may be replaced
    run: str = ""  # identifies this call of the program among others that write into the same folder


@dataclass(frozen=True)
class JointSummary:
    """Counts of a joint's scans."""

    scans: int  # all scans
    lost: int  # scans without a pose
    faults: Mapping[str, int]  # lost scans by fault
    missing: int = 0  # stamps of other joints for which this joint had no transform
    refused: int = 0  # complete stamps without an endpoint because of this joint's transform


@dataclass(frozen=True)
class EndpointSummary:
    """Counts of stamps."""

    poses: int  # stamps with an endpoint
    degraded: int  # endpoints that depend on a DEGRADED joint
    refused: int  # complete stamps without an endpoint
    incomplete: int  # stamps that were given up because a joint was missing


@dataclass(frozen=True)
class Summary:
    """Result of one bag."""

    bag: Path  # folder or file
    output: Path | None  # folder with the results; None: no output
    joints: Mapping[str, JointSummary]  # by joint
    endpoint: EndpointSummary | None  # None without a chain
    left_out: tuple[str, ...] = ()  # topics of raw scans of other joints
    differences: tuple[str, ...] = ()  # files that differ from those named by the bag, one sentence each
    notes: tuple[str, ...] = ()  # what is left out of the bag, and what it lacks, one sentence each
    wall_s: float = 0.0  # elapsed time
    cpu_s: float = 0.0  # processor time

    @property
    def scans(self) -> int:
        """All raw scans."""
        return sum(joint.scans for joint in self.joints.values())
