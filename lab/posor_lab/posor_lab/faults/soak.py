"""An arm live without any fault: no error in the diagnostics, and false alarms at their expected rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.estimation.posor import Posor
from posor.model.fault import Fault
from posor.ros_names import TRANSFORM_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_bringup.supervisor import Supervisor
from posor_drivers.simulator.arm_simulation import ArmSimulation
from scipy.stats import betabinom

from posor_lab.faults.fault_arm import IMPERFECTION_PARAMETERS, IMPERFECTIONS, RATES, write_fault_arm
from posor_lab.faults.fault_receiver import FaultReceiver
from posor_lab.reports.graph_receiver import GraphWatch

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor_lab.faults.fault_table import Arm

CYCLE_S = 20
EXPECTED_SCANS = 100_000
"""Simulated scans of each joint from which the rate of false alarms is expected."""
BAND = 0.95


@dataclass(frozen=True)
class Soak:
    """Figures of a run without faults.

    Attributes:
        arm: Name of the arm.
        errors: Messages of the diagnostics at the level ERROR, without repetition.
        scans: Transforms that came.
        alarms: Of these, rejected by the test of the redundant readings.
        band: Least and largest number of alarms within the 95 % band of the expected rate, which is itself an estimate.

    """

    arm: str
    errors: tuple[str, ...]
    scans: int
    alarms: int
    band: tuple[int, int]

    @property
    def holds(self) -> bool:
        """Whether there was no error, and the number of alarms is as expected."""
        return not self.errors and self.is_in_band

    @property
    def is_in_band(self) -> bool:
        """Whether the number of alarms is as expected."""
        return self.band[0] <= self.alarms <= self.band[1]


def run_soak(arm: Arm, seconds: float, folder: Path, seed: int, interrupted: Callable[[], bool]) -> Soak:
    """Run an arm without faults and return its figures.

    The expected rate is that of the same sensors in other simulated scans: the errors of one calibration shift it from
    the probability that the test states over all calibrations.

    Args:
        arm: Installed arm.
        seconds: Duration.
        folder: Existing folder for the copy of the arm and the logs.
        seed: Of motion and noise.
        interrupted: Whether the user has interrupted the run.

    Raises:
        ProcessError: A node failed, or the arm has no poses.

    """
    copy = write_fault_arm(arm, folder / "arm", CYCLE_S, seed)
    simulation = ArmSimulation(copy, IMPERFECTIONS)
    rate, others = RATES[arm], (EXPECTED_SCANS // (CYCLE_S * RATES[arm])) * CYCLE_S * RATES[arm]
    expected_alarms = 0
    for joint in simulation.joints:
        scans = simulation.scans(joint, np.arange(others)).scans
        estimates = Posor(simulation.calibrations[joint]).estimate_all(scans)
        expected_alarms += int(np.count_nonzero(estimates.faults & int(Fault.RESIDUAL)))
    with Supervisor(folder) as supervisor, FaultReceiver(copy.name, simulation.joints) as receiver:
        programs = arm_programs(copy, driver_parameters=IMPERFECTION_PARAMETERS)
        for program in group_programs(programs, "drivers_apart", folder):
            supervisor.start(program)
        watch = GraphWatch(supervisor, receiver, "faults", interrupted=interrupted)
        watch.wait(lambda: receiver.usable_endpoints(round(rate)), lambda: "endpoint poses")
        receiver.diagnostics.clear()
        begin = {joint: receiver.count(f"{joint}/{TRANSFORM_TOPIC}") for joint in simulation.joints}
        receiver.receive_for(seconds)
        errors = {status.message for _, status in receiver.diagnostics if status.level == status.ERROR}
        flags = [
            each.message.faults
            for joint in simulation.joints
            for each in receiver.since(f"{joint}/{TRANSFORM_TOPIC}", begin[joint])
        ]
    without_alarm = others * len(simulation.joints) - expected_alarms
    low, high = betabinom.interval(BAND, len(flags), expected_alarms + 1, without_alarm + 1)
    alarms = sum(bool(each & Fault.RESIDUAL) for each in flags)
    return Soak(arm, tuple(sorted(errors)), len(flags), alarms, (int(low), int(high)))
