"""What is to be done with one bag, and what came of it: plain values that may go to another process or machine."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from posor_estimator.core.calibration.load import load_calibration

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from posor_estimator.core.arm import ParameterValue
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.ros.messages import CovarianceKind

Format = Literal["bag", "parquet", "csv"]
FORMATS: tuple[Format, ...] = ("bag", "parquet", "csv")


@dataclass(frozen=True)
class JointSettings:
    """Which calibration a joint's POSOR has.

    Attributes:
        calibration: Path of the file.
        session: Of it; empty: none.
        topic: Of the raw scans; empty: the only one of the bag that ends in ``/<joint>/raw``.

    """

    calibration: Path
    session: str = ""
    topic: str = ""

    def load(self) -> Calibration:
        """Return the calibration with its session applied.

        Raises:
            CalibrationError: It cannot be used.

        """
        return load_calibration(self.calibration).for_session(self.session)


@dataclass(frozen=True)
class Settings:
    """What holds for all bags: what the nodes' parameters are in a live graph.

    Attributes:
        joints: The POSORs, by joint.
        chain: Parameters of chain_node; None: transforms only.
        covariance: Which part of the uncertainty the transforms tell.
        false_alarm: See ``Posor``.

    """

    joints: Mapping[str, JointSettings]
    chain: Mapping[str, ParameterValue] | None = None
    covariance: CovarianceKind = "total"
    false_alarm: float = 1e-3


@dataclass(frozen=True)
class Task:
    """One bag to reprocess.

    Attributes:
        bag: Folder or file.
        settings: How.
        output: Folder for the results; None: only the summary is wanted.
        format: Of the results.
        force: Whether results that are there may be replaced.
        run: What tells this call of the program from others that write into the same folder.

    """

    bag: Path
    settings: Settings
    output: Path | None = None
    format: Format = "bag"
    force: bool = False
    run: str = ""


@dataclass(frozen=True)
class JointSummary:
    """What came of a joint's scans.

    Attributes:
        scans: How many there were.
        lost: How many gave no pose.
        faults: Why: how many of the lost ones have each fault.
        missing: How often the joint was missing from a stamp that other joints have.
        refused: How often its transform kept a complete stamp from giving a pose.

    """

    scans: int
    lost: int
    faults: Mapping[str, int]
    missing: int = 0
    refused: int = 0


@dataclass(frozen=True)
class EndpointSummary:
    """What came of the stamps.

    Attributes:
        poses: How many gave a pose.
        degraded: How many of these rest on a joint whose state is DEGRADED.
        refused: How many were complete but gave none.
        incomplete: How many were given up because a joint was missing.

    """

    poses: int
    degraded: int
    refused: int
    incomplete: int


@dataclass(frozen=True)
class Summary:
    """What came of one bag.

    Attributes:
        bag: Folder or file.
        output: Folder with the results; None: none.
        joints: By joint.
        endpoint: None where there is no chain.
        left_out: Topics of raw scans that belong to none of the joints.
        wall_s: How long it took.
        cpu_s: Processor time that it took.

    """

    bag: Path
    output: Path | None
    joints: Mapping[str, JointSummary]
    endpoint: EndpointSummary | None
    left_out: tuple[str, ...] = field(default=())
    wall_s: float = 0.0
    cpu_s: float = 0.0

    @property
    def scans(self) -> int:
        """All raw scans."""
        return sum(joint.scans for joint in self.joints.values())
