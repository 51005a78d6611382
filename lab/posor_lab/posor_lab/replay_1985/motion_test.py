# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A motion test of 1985: outputs of POSOR, chain and machining centre at each step, of a replay or without nodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
import pinocchio as pin
from posor.bags.calibration_recording import Reference, load_recording
from posor.bags.recording import POINT
from posor.calibration.calibration_file import load_calibration
from posor.chain.joint_measurements import MeasuredJoint
from posor.chain.kinematic_chain import load_chain
from posor.errors import PosorError
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES, Fault, State
from posor.model.scan import DIODES_ESTIMATED, PROBES_ESTIMATED
from posor.ros_names import TRUTH_TOPIC
from posor_calibration.attitude_fit import angles_from_displacements
from scipy.constants import inch

from posor_lab.harness.rig_files import JOINT, bag_path, calibration_path, urdf_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import BoolArray, FloatArray

    from posor_lab.harness.rig_files import Bag, CalibrationName

Angle = Literal["alpha", "beta", "theta"]
ANGLES: tuple[Angle, ...] = get_args(Angle)

TRUTH_LEVER = 31.43 * inch
"""From the pivot to the scribed line at which the machining centre reads [m]; listings of appendix 8A."""

_ESTIMATED_FLAGS = {"alpha": PROBES_ESTIMATED, "beta": PROBES_ESTIMATED, "theta": DIODES_ESTIMATED}
_MINIMUM_STEPS = 3


@dataclass(frozen=True)
class MotionStep:
    """One step of a motion test; NaN where a value is missing."""

    number: int  # row of the recorded test, from 1 (``RawScan.scan``)
    state: State  # state of the POSOR's transform
    faults: Fault  # faults of the transform
    scan_status: int  # ``RawScan.status`` as the transform carries it
    angles: FloatArray  # alpha, beta, theta of the transform [rad], shape (3,); NaN if the state is LOST
    truth: FloatArray  # reading of the machining centre [m], shape (3,): x along the beam, y to its side, z up
    endpoint: FloatArray  # position of the endpoint in the axes of the machining centre [m], shape (3,)

    @property
    def has_pose(self) -> bool:
        """Whether the step gave a pose."""
        return self.state in USABLE_STATES

    @property
    def status(self) -> str:
        """One word such as ``ok``, ``ok:probes_estimated`` or ``lost:OUT_OF_RANGE``."""
        remarks = [str(self.faults.name)] if self.faults else []
        if self.has_pose:
            remarks += ["probes_estimated"] if self.scan_status & PROBES_ESTIMATED else []
            remarks += ["diodes_estimated"] if self.scan_status & DIODES_ESTIMATED else []
        return ":".join([self.state.name.lower(), *(["+".join(remarks)] if remarks else [])])


@dataclass(frozen=True)
class MotionTest:
    """All steps of a motion test; every array is relative to step 1, as in the thesis.

    Raises:
        PosorError: There are fewer than three steps, or the first gave no pose.

    """

    steps: tuple[MotionStep, ...]

    def __post_init__(self) -> None:
        """Refuse steps without a reference."""
        if len(self.steps) < _MINIMUM_STEPS:
            expected = f"at least {_MINIMUM_STEPS}"
            raise PosorError(f"{len(self.steps)} steps were received", where="demo", expected=expected)
        first = self.steps[0]
        if not first.has_pose:
            expected = "a pose at the first step, the reference of all others"
            raise PosorError(f"step {first.number} gave no pose ({first.status})", where="demo", expected=expected)

    @cached_property
    def numbers(self) -> list[int]:
        """Step numbers."""
        return [step.number for step in self.steps]

    @cached_property
    def has_pose(self) -> BoolArray:
        """Which steps gave a pose, (n,)."""
        return np.array([step.has_pose for step in self.steps])

    @cached_property
    def posor_angles(self) -> FloatArray:
        """Alpha, beta, theta of the POSOR [rad], shape (n, 3); NaN where a step gave no pose."""
        return _relative_to_first([step.angles for step in self.steps])

    @cached_property
    def truth_displacement(self) -> FloatArray:
        """Displacement read by the machining centre [m], shape (n, 3)."""
        return _relative_to_first([step.truth for step in self.steps])

    @cached_property
    def truth_angles(self) -> FloatArray:
        """Alpha, beta, theta by the machining centre [rad], shape (n, 3)."""
        return angles_from_displacements(self.truth_displacement, TRUTH_LEVER)

    @cached_property
    def angle_errors(self) -> FloatArray:
        """POSOR less machining centre [rad], shape (n, 3)."""
        return self.posor_angles - self.truth_angles

    @cached_property
    def endpoint_displacement(self) -> FloatArray:
        """Displacement of the endpoint [m], shape (n, 3)."""
        return _relative_to_first([step.endpoint for step in self.steps])

    def fully_measured(self, angle: Angle) -> BoolArray:
        """Return which steps gave a pose without an estimated reading that affects ``angle``, at the step or step 1."""
        flags = np.array([step.scan_status for step in self.steps])
        measured: BoolArray = self.has_pose & (((flags | flags[0]) & _ESTIMATED_FLAGS[angle]) == 0)
        return measured


def _relative_to_first(rows: Sequence[FloatArray]) -> FloatArray:
    table = np.array(rows)
    return np.asarray(table - table[0])


@cache
def offline_motion_test(bag: Bag, calibration: CalibrationName) -> MotionTest:
    """Return a motion test as a replay of its bag gives it, without nodes.

    Raises PosorError: a file of the rig is missing or invalid.
    """
    recording = load_recording(bag_path(bag), references=[Reference(TRUTH_TOPIC)])
    estimates = Posor(load_calibration(calibration_path(calibration)).for_session(bag)).estimate_all(recording.scans)
    chain = load_chain(urdf_path(), "endpoint")
    truths = recording.find_track(TRUTH_TOPIC, POINT).interpolate(recording.scans.stamps_ns, 0)
    steps = []
    for n, number in enumerate(recording.scans.numbers):
        state, endpoint = State(int(estimates.states[n])), np.full(3, np.nan)
        if state in USABLE_STATES:
            pose = pin.SE3(estimates.rotations[n], estimates.translations[n])
            endpoint = chain.estimate({JOINT: MeasuredJoint(pose)}).T_base_endpoint.translation
        status = 0 if recording.statuses is None else int(recording.statuses[n])
        faults = Fault(int(estimates.faults[n]))
        steps.append(MotionStep(int(number), state, faults, status, estimates.natives[n, 3:], truths[n], endpoint))
    return MotionTest(tuple(steps))
