"""Faults that the simulator injects into readings, scans and stamps of an arm, as its scenario file states.

The nodes are the real ones; scans and transforms go over DDS. ``inject`` of a row is the entry of the scenario file.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from posor.model.fault import USABLE_STATES
from posor.numerics.stamps import NS
from posor.ros_names import TRANSFORM_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_ros.message_conversion import stamp_ns

from posor_lab.faults.fault_arm import IMPERFECTION_PARAMETERS, fault_entry, write_fault_arm
from posor_lab.faults.injection_run import InjectionRun

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.arm_file import Arm as ArmFile
    from posor_bringup.supervisor import Program

    from posor_lab.faults.fault_table import FaultRow
    from posor_lab.faults.injection_run import Span

SLOT_S = 2
"""Time from one fault of the scenario to the next."""
NEEDS_FIRST_SCAN = ("frozen", "frozen_diodes", "stuck")
"""Kinds that repeat the reading at the beginning of the fault, which must have been published."""


class ReadingRun(InjectionRun):
    """A run of one arm whose scenario has a fault in each slot, of the joints in turn."""

    SOUND_S, FAULT_S, ACKNOWLEDGE_S, REST_S = 0.2, 0.5, 0.2, 1.1
    SETTLES, ATTEMPTS = False, 3

    @staticmethod
    def group(row: FaultRow) -> str:
        """Return the title of the run of an arm."""
        return f"readings of {row.arm}"

    def write_arm(self, seed: int) -> ArmFile:
        """Write the arm with the faults in its scenario."""
        name, self._cycle_s = self.rows[0].arm, SLOT_S * max(2, len(self.rows))
        joints = list(write_fault_arm(name, self.folder / "sound", self._cycle_s, seed).calibrations)
        self._places = {row.title: (joints[n % len(joints)], SLOT_S * n) for n, row in enumerate(self.rows)}
        entries = []
        for row in self.rows:
            joint, slot_s = self._places[row.title]
            begin_s = slot_s + self.SOUND_S
            entries.append(fault_entry(joint, row.inject, begin_s, begin_s + self.FAULT_S))
        return write_fault_arm(name, self.folder / name, self._cycle_s, seed, entries)

    def programs(self) -> list[Program]:
        """Return one process for all drivers, and one for all other nodes."""
        programs = arm_programs(self.arm, driver_parameters=IMPERFECTION_PARAMETERS)
        return group_programs(programs, "drivers_apart", self.folder)

    def joint_of(self, row: FaultRow) -> str:
        """Return the joint with the fault."""
        return self._places[row.title][0]

    def in_order(self, rows: Sequence[FaultRow]) -> Sequence[FaultRow]:
        """Return rows in the order in which the scenario comes to them, beginning in a second."""
        now_ns, cycle_ns = time.time_ns(), self._cycle_s * NS
        self._begins_ns = {}
        for row in rows:
            offset_ns = round((self._places[row.title][1] + self.SOUND_S) * NS)
            self._begins_ns[row.title] = offset_ns - (offset_ns - now_ns - NS) // cycle_ns * cycle_ns
        return sorted(rows, key=lambda row: self._begins_ns[row.title])

    def wait_for_begin(self, row: FaultRow) -> int:
        """Return the begin of the fault, once it has come."""
        begin_ns = self._begins_ns[row.title]
        self.watch.wait(lambda: time.time_ns() >= begin_ns, lambda: "scans")
        return begin_ns

    def begin(self, row: FaultRow) -> None:
        """Leave the fault to the simulator."""

    def end(self, row: FaultRow) -> None:
        """Leave the end to the simulator."""

    def problem(self, row: FaultRow, span: Span) -> str:
        """Return why the host concealed the fault; empty: it did not."""
        topic, begin_ns = f"{self.joint_of(row)}/{TRANSFORM_TOPIC}", span.begin_ns
        before = self.receiver.between(topic, begin_ns - round(self.SOUND_S * NS), begin_ns)
        if not any(each.message.state in USABLE_STATES for each in before):
            return "its joint had no pose before the fault"
        if row.inject["kind"] in NEEDS_FIRST_SCAN and begin_ns not in self._stamps(row, span):
            return "the driver missed the scan at which the fault began: the host is overloaded"
        return ""

    def first_faulted_ns(self, row: FaultRow, span: Span) -> int:
        """Return the stamp of the first scan during the fault: a late driver leaves out scans."""
        during = range(span.begin_ns, span.begin_ns + round(self.FAULT_S * NS))
        return min((stamp for stamp in self._stamps(row, span) if stamp in during), default=span.begin_ns)

    def _stamps(self, row: FaultRow, span: Span) -> set[int]:
        arrivals = self.receiver.between(f"{self.joint_of(row)}/{TRANSFORM_TOPIC}", span.begin_ns, span.until_ns)
        return {stamp_ns(each.message) for each in arrivals}
