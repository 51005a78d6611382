# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""How many sound scans of a drawn arm are OK: the rate of false alarms of each single arm, not of the mean of all arms.

The errors of one calibration are the same in all scans of an arm and shift its rate of false alarms. The raw scans obey
the independent truth and follow one another as in the nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from posor.chain.arm_file import load_arm_file
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.model.scan import NO_SOURCE
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.electronics import JointElectronics

from posor_lab.faults.fault_table import IMPERFECTIONS
from posor_lab.independent.true_arm import TrueArm

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_drivers.simulator.pose_array import PoseArray

    from posor_lab.faults.fault_table import ArmName

OK_SHARE = 0.998  # least share of sound scans of one arm that are OK
TICKS, START = 2520, 20  # ticks of each drawn arm, and those at the beginning, in which rings are counted


@dataclass(frozen=True)
class Availability:
    """Figures of drawn arms without faults."""

    arm: str
    scans: int  # ticks of all drawn arms after the start at which no joint takes a dark scan
    shares: tuple[float, ...]  # of these, those at which all joints are OK, by drawn arm

    @property
    def holds(self) -> bool:
        """Whether each single arm is OK often enough."""
        return min(self.shares) >= OK_SHARE

    def describe(self) -> str:
        """Return the figures as a phrase."""
        below = sum(share < OK_SHARE for share in self.shares)
        mean = f"mean {100.0 * float(np.mean(self.shares)):.4f} %"
        return f"{len(self.shares)} arms, {self.scans} scans; {mean}; {below} arms below {100.0 * OK_SHARE:g} %"


def _select(poses: PoseArray, _after_s: float) -> PoseArray:
    """Return the poses at any time; without a multiplexer all readings are at their tick."""
    return poses


def arm_availability(
    name: ArmName, arms: int, seed: int, on_drawn: Callable[[int], None], ticks: int = TICKS
) -> Availability:
    """Return the figures of ``arms`` drawn arms, whose seeds follow ``seed``; ``on_drawn`` is called after each."""
    arm = load_arm_file(name)
    simulation, model = ArmSimulation(arm, IMPERFECTIONS, truth="independent"), TrueArm(arm.path)
    numbers = np.arange(ticks)
    poses = simulation.truth(numbers).T_parent_child
    posors = {joint: Posor(calibration) for joint, calibration in simulation.calibrations.items()}
    shares, count = [], 0
    for drawn in range(seed, seed + arms):
        scenario = simulation.scenario.model_copy(update={"seed": drawn})
        are_lit, are_ok = np.tile(numbers >= START, (2, 1))
        for joint, posor in posors.items():
            electronics = JointElectronics(scenario, joint, posor.calibration, IMPERFECTIONS, name, model)
            scans = electronics.scans(numbers, partial(_select, poses[joint])).scans
            posor.reset()
            are_ok &= posor.estimate_all(scans).states == State.OK
            are_lit &= ~np.any(scans.lit_sources == NO_SOURCE, axis=1)
        shares.append(float(np.mean(are_ok[are_lit])))
        count += int(np.count_nonzero(are_lit))
        on_drawn(1)
    return Availability(name, count, tuple(shares))
