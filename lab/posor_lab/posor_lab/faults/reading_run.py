"""Faults that the simulator injects into readings, scans and stamps of an arm, as its scenario file states.

The nodes are the real ones; scans and transforms go over DDS. ``inject`` of a row is the entry of the scenario file.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from posor.model.fault import USABLE_STATES
from posor.numerics.stamps import NS
from posor.ros_names import TRANSFORM_TOPIC
from posor_ros.message_conversion import stamp_ns

from posor_lab.faults.fault_table import fault_entry, write_fault_arm
from posor_lab.faults.injection_run import InjectionRun, Span

if TYPE_CHECKING:
    from posor.chain.arm_file import ArmFile

    from posor_lab.faults.fault_table import FaultRow, RowResult

SLOT_S = 2
"""Time from one fault of the scenario to the next."""
NEEDS_FIRST_SCAN = ("frozen", "frozen_diodes", "stuck")
"""Kinds that repeat the reading at the beginning of the fault, which must have been published."""


class ReadingRun(InjectionRun):
    """A run of one arm whose scenario has a fault in each slot, of the joints in turn."""

    TITLE, ATTEMPTS = "readings of {0.arm}", 3
    SOUND_S, FAULT_S, ACKNOWLEDGE_S, REST_S = 0.2, 0.5, 0.2, 1.1

    def _write_arm(self, seed: int) -> ArmFile:
        """Write the arm with the faults in its scenario."""
        name, self._cycle_s = self.rows[0].arm, SLOT_S * max(2, len(self.rows))
        joints = list(write_fault_arm(name, self.folder / "sound", self._cycle_s, seed).calibrations)
        self._places = {
            row.title: (joints[n % len(joints)], SLOT_S * n + self.SOUND_S) for n, row in enumerate(self.rows)
        }
        entries = []
        for row in self.rows:
            joint, begin_s = self._places[row.title]
            entries.append(fault_entry(joint, row.inject, begin_s, begin_s + self.FAULT_S))
        return write_fault_arm(name, self.folder / name, self._cycle_s, seed, entries)

    def _joint_of(self, row: FaultRow) -> str:
        return self._places[row.title][0]

    def _inject_all(self) -> list[tuple[FaultRow, Span]]:
        """Receive in the order in which the scenario comes to the faults, beginning in a second."""
        now_ns, cycle_ns, spans = time.time_ns(), self._cycle_s * NS, []
        offsets_ns = [round(self._places[row.title][1] * NS) for row in self.rows]
        begins_ns = [offset_ns - (offset_ns - now_ns - NS) // cycle_ns * cycle_ns for offset_ns in offsets_ns]
        for begin_ns, n in sorted(zip(begins_ns, range(len(self.rows)), strict=True)):
            self.watch.wait(lambda begin_ns=begin_ns: time.time_ns() >= begin_ns, lambda: "scans")  # type: ignore[misc]
            self.receiver.receive_for(self.FAULT_S + self.ACKNOWLEDGE_S)
            self.receiver.acknowledge(self._joint_of(self.rows[n]))
            self.receiver.receive_for(self.REST_S)
            spans.append((self.rows[n], Span(begin_ns, begin_ns + round(self.FAULT_S * NS), time.time_ns())))
        return spans

    def _result(self, row: FaultRow, span: Span) -> RowResult:
        """Return what was published, from the first scan during the fault on; a problem if the host concealed it."""
        found, topic, begin_ns = super()._result(row, span), f"{self._joint_of(row)}/{TRANSFORM_TOPIC}", span.begin_ns
        before = self.receiver.between(topic, begin_ns - round(self.SOUND_S * NS), begin_ns)
        stamps = {stamp_ns(each.message) for each in self.receiver.between(topic, begin_ns, span.until_ns)}
        late_s = (min((stamp for stamp in stamps if begin_ns <= stamp < span.end_ns), default=begin_ns) - begin_ns) / NS
        problem = ""
        if not any(each.message.state in USABLE_STATES for each in before):
            problem = "its joint had no pose before the fault"
        elif row.inject["kind"] in NEEDS_FIRST_SCAN and begin_ns not in stamps:
            problem = "the driver missed the scan at which the fault began: the host is overloaded"
        naming_s = None if found.naming_s is None else max(0.0, found.naming_s - late_s)
        return replace(found, naming_s=naming_s, problem=problem)
