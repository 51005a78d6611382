"""An arm live without any fault: no error in the diagnostics, and false alarms at their expected rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.estimation.posor import Posor
from posor.model.fault import Fault
from posor.ros_names import TRANSFORM_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_drivers.simulator.arm_simulation import ArmSimulation
from scipy.stats import betabinom

from posor_lab.faults.fault_arm import CYCLE_S, IMPERFECTION_PARAMETERS, IMPERFECTIONS, RATES, write_fault_arm
from posor_lab.reports.arrival_receiver import ArrivalReceiver
from posor_lab.reports.graph_receiver import running_graph

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor_lab.faults.fault_table import Arm

EXPECTED_SCANS = 100_000
"""Simulated scans of each joint from which the rate of false alarms is expected."""
BAND = 0.95


@dataclass(frozen=True)
class AlarmFigures:
    """Figures of a run without faults."""

    arm: str
    errors: tuple[str, ...]  # messages of the diagnostics at the level ERROR, without repetition
    scans: int  # transforms that came
    alarms: int  # of these, rejected by the test of the redundant readings
    band: tuple[int, int]  # least and most alarms in the 95 % band of the expected rate, which is itself an estimate

    @property
    def holds(self) -> bool:
        """Whether there was no error, and the number of alarms is as expected."""
        return not self.errors and self.is_in_band

    @property
    def is_in_band(self) -> bool:
        """Whether the number of alarms is as expected."""
        return self.band[0] <= self.alarms <= self.band[1]


def run_without_faults(
    arm: Arm, seconds: float, folder: Path, seed: int, interrupted: Callable[[], bool]
) -> AlarmFigures:
    """Run an arm without faults and return its figures.

    The same sensors in other simulated scans give the expected rate: the errors of one calibration shift it from
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
    simulation = ArmSimulation(write_fault_arm(arm, folder / "arm", CYCLE_S, seed), IMPERFECTIONS)
    topics = [f"{joint}/{TRANSFORM_TOPIC}" for joint in simulation.joints]
    others, expected_alarms = EXPECTED_SCANS // (CYCLE_S * RATES[arm]) * CYCLE_S * RATES[arm], 0
    for joint in simulation.joints:
        scans = simulation.scans(joint, np.arange(others)).scans
        estimates = Posor(simulation.calibrations[joint]).estimate_all(scans)
        expected_alarms += int(np.count_nonzero(estimates.faults & int(Fault.RESIDUAL)))
    receiver = ArrivalReceiver(simulation.arm.name, simulation.joints)
    programs = arm_programs(simulation.arm, driver_parameters=IMPERFECTION_PARAMETERS)
    programs = group_programs(programs, "drivers_apart", folder)
    with running_graph(programs, receiver, folder, "faults", interrupted) as watch:
        watch.wait(lambda: receiver.usable_endpoints(RATES[arm]), lambda: "endpoint poses")
        receiver.diagnostics.clear()
        begin = {topic: receiver.count(topic) for topic in topics}
        receiver.receive_for(seconds)
        errors = {status.message for _, status in receiver.diagnostics if status.level == status.ERROR}
        flags = [each.message.faults for topic in topics for each in receiver.since(topic, begin[topic])]
    without_alarm = others * len(topics) - expected_alarms
    low, high = betabinom.interval(BAND, len(flags), expected_alarms + 1, without_alarm + 1)
    alarms = sum(bool(each & Fault.RESIDUAL) for each in flags)
    return AlarmFigures(arm, tuple(sorted(errors)), len(flags), alarms, (int(low), int(high)))
