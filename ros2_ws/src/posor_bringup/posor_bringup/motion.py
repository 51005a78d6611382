"""A replayed motion test: what POSOR, chain and machining centre said at each step, as it was received over ROS."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from posor_estimator.core.calibrate.attitude_fit import deviation
from posor_estimator.core.calibrate.orientation import angles_of_displacements
from posor_estimator.core.fault import Fault, State
from posor_estimator.errors import PosorError

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from posor_estimator.core.types import FloatArray

    BoolArray = NDArray[np.bool_]

Angle = Literal["alpha", "beta", "theta"]
ANGLES: tuple[Angle, ...] = get_args(Angle)

INCH = 0.0254
TRUTH_LEVER = 31.43 * INCH
"""From the pivot to the scribed line where the machining centre reads [m]; listings of appendix 8A."""

PROBES_ESTIMATED = 1
DIODES_ESTIMATED = 2
"""Flags of ``posor_msgs/RawScan.status``; a test holds them to the message's constants."""

_ESTIMATED = {"alpha": PROBES_ESTIMATED, "beta": PROBES_ESTIMATED, "theta": DIODES_ESTIMATED}


@dataclass(frozen=True)
class Step:
    """One step of a motion test.

    Attributes:
        number: Row of the recorded test, from 1 (``RawScan.scan``).
        state: Whether the POSOR's transform may be used.
        faults: Why not.
        scan_status: ``RawScan.status`` as the transform carries it.
        angles: Alpha, beta, theta of the transform [rad], shape (3,); NaN when the state is LOST.
        truth: Reading of the machining centre [m], shape (3,): x along the beam, y to its side, z upwards; NaN where
            the source has none.
        endpoint: Position of the endpoint in the machining centre's axes [m], shape (3,); NaN when there is no pose.

    """

    number: int
    state: State
    faults: Fault
    scan_status: int
    angles: FloatArray
    truth: FloatArray
    endpoint: FloatArray

    @property
    def has_pose(self) -> bool:
        """Whether the step gave a pose."""
        return self.state in (State.OK, State.DEGRADED)

    @property
    def status(self) -> str:
        """One word on the step, such as ``ok``, ``ok:probes_estimated`` or ``lost:OUT_OF_RANGE``."""
        remarks = [str(self.faults.name)] if self.faults else []
        if self.has_pose:
            remarks += ["probes_estimated"] if self.scan_status & PROBES_ESTIMATED else []
            remarks += ["diodes_estimated"] if self.scan_status & DIODES_ESTIMATED else []
        return ":".join([self.state.name.lower(), *(["+".join(remarks)] if remarks else [])])


def measured_angles(truth: FloatArray) -> FloatArray:
    """Return alpha, beta, theta [rad] that displacements (n, 3) [m] at the scribed line amount to, shape (n, 3).

    Source: listings of appendix 8A; alpha, the twist, is zero in all three tests.
    """
    return angles_of_displacements(truth, TRUTH_LEVER)


@dataclass(frozen=True)
class MotionTest:
    """All steps of a motion test; every array is incremental, the value at step 1 taken off, as the thesis has it.

    Raises:
        PosorError: There are fewer than three steps, or the first gave no pose.

    """

    steps: tuple[Step, ...]

    def __post_init__(self) -> None:
        """Refuse what cannot be told incrementally."""
        least = 3
        if len(self.steps) < least:
            raise PosorError(f"{len(self.steps)} steps were received", where="replay", expected=f"at least {least}")
        if not self.steps[0].has_pose:
            raise PosorError(
                f"step {self.steps[0].number} gave no pose ({self.steps[0].status})",
                where="replay",
                expected="a pose at the first step, to which all others are referred",
            )

    @cached_property
    def numbers(self) -> list[int]:
        """Step numbers."""
        return [step.number for step in self.steps]

    @cached_property
    def has_pose(self) -> BoolArray:
        """Which steps gave a pose."""
        return np.array([step.has_pose for step in self.steps])

    @cached_property
    def posor(self) -> FloatArray:
        """Alpha, beta, theta of the POSOR [rad], shape (n, 3); NaN where a step gave no pose."""
        return _incremental([step.angles for step in self.steps])

    @cached_property
    def truth(self) -> FloatArray:
        """Displacement that the machining centre read [m], shape (n, 3)."""
        return _incremental([step.truth for step in self.steps])

    @cached_property
    def measured(self) -> FloatArray:
        """Alpha, beta, theta by the machining centre [rad], shape (n, 3)."""
        return measured_angles(self.truth)

    @cached_property
    def error(self) -> FloatArray:
        """POSOR less machining centre [rad], shape (n, 3)."""
        return self.posor - self.measured

    @cached_property
    def displacement(self) -> FloatArray:
        """Displacement of the endpoint [m], shape (n, 3)."""
        return _incremental([step.endpoint for step in self.steps])

    def measured_throughout(self, angle: Angle) -> BoolArray:
        """Return which steps gave a pose without an estimated reading that bears on ``angle``, here or at step 1."""
        flags = np.array([step.scan_status for step in self.steps])
        measured: BoolArray = self.has_pose & (((flags | flags[0]) & _ESTIMATED[angle]) == 0)
        return measured


def _incremental(rows: list[FloatArray]) -> FloatArray:
    table: FloatArray = np.array(rows)
    increments: FloatArray = table - table[0]
    return increments


def standard_deviation(errors: FloatArray) -> float:
    """Return the thesis' standard deviation of incremental errors, shape (n,), the first being that of step 1.

    The root of the sum of squares of steps 2 to n, over n - 2 (listings of appendix 8A). NaN for fewer than three.
    """
    return float(deviation(errors))
