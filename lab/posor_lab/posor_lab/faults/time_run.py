# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults of time: clocks that contradict each other, scans in another order, channels read one after another.

A pose is compared with the truth at its stamp, also where the clock was set, and its error with the protection level.
What a fault costs is counted in the transforms of its joint.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from posor.model.fault import USABLE_STATES
from posor.numerics.stamps import NS
from posor.ros_names import TRANSFORM_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs

from posor_lab.faults.fault_table import IMPERFECTION_PARAMETERS, RATES
from posor_lab.faults.injection_run import ReadingRun

if TYPE_CHECKING:
    from posor_bringup.supervisor import ProgramCommand

    from posor_lab.faults.fault_table import FaultRow, RowResult
    from posor_lab.faults.injection_run import Span


class TimeRun(ReadingRun):
    """Faults of time that the simulator injects, one in each slot of the scenario."""

    TITLE, BY_LEVEL = "time of {0.arm}", True

    def _result(self, row: FaultRow, span: Span) -> RowResult:
        """Return the result with the scans that have no pose while the fault lasts."""
        topic, found = f"{self._joint_of(row)}/{TRANSFORM_TOPIC}", super()._result(row, span)
        transforms = [each.message for each in self.receiver.between(topic, span.begin_ns, span.end_ns)]
        lost, scans = sum(each.state not in USABLE_STATES for each in transforms), len(transforms)
        problem = found.problem
        if row.inject["kind"] == "late_scan":
            first = round(span.begin_ns * RATES[row.arm] / NS)
            if not {first, first + 1} <= {each.scan for each in transforms}:
                problem = problem or "the driver missed one of the exchanged scans: the host is overloaded"
        seen = f"{found.seen}; {lost} of {scans} scans lost"
        return replace(found, lost=lost, scans=scans, seen=seen, problem=problem)


class AgedRun(TimeRun):
    """Content that is older than its stamp by what the drivers state: within the protection level."""

    TITLE, STAMP_LIMIT_S = "age of {0.arm}", 0.04

    def _programs(self) -> list[ProgramCommand]:
        parameters = {**IMPERFECTION_PARAMETERS, "time.stamp_limit": self.STAMP_LIMIT_S}
        return group_programs(arm_programs(self.arm, driver_parameters=parameters), self.LAYOUT, self.folder)


class ScatterRun(TimeRun):
    """Stamps that scatter, judged when the estimator knows by how much: it measures that over 256 scans."""

    TITLE, SLOT_S, LEAD_S = "stamps of {0.arm}", 8, 6.0
