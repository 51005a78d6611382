# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Runs the nodes of an arm and injects faults one after the other: base of all live runs, and faulty readings."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from posor.model.fault import USABLE_STATES
from posor.numerics.stamps import NS
from posor.ros_names import TRANSFORM_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_drivers.simulator.arm_simulation import ArmSimulation

from posor_lab.faults.fault_table import (
    CYCLE_S,
    IMPERFECTION_PARAMETERS,
    IMPERFECTIONS,
    RowResult,
    fault_entry,
    write_fault_arm,
)
from posor_lab.faults.pose_judge import PoseJudge
from posor_lab.harness.message_conversion import stamp_ns
from posor_lab.reports.arrival_receiver import ArrivalReceiver
from posor_lab.reports.graph_receiver import running_graph

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor.chain.arm_file import ArmFile
    from posor_bringup.arm_programs import Layout
    from posor_bringup.supervisor import ProgramCommand

    from posor_lab.faults.fault_table import FaultRow
    from posor_lab.reports.graph_receiver import GraphWatch

NEEDS_FIRST_SCAN = ("frozen", "frozen_diodes", "stuck")
"""Kinds that repeat the reading at the beginning of the fault, which must have been published."""


SETTLED_POSES = 20  # endpoint poses without interruption before a fault
SETTLING_TIMEOUT_S = 90.0  # longest time until the arm has poses
LATCHED_S = 0.7  # time between two acknowledgements of latched faults while the arm has no poses


class Span(NamedTuple):
    """Times of one fault [ns]."""

    begin_ns: int
    end_ns: int
    until_ns: int  # end of the arrivals that are judged


class InjectionRun:
    """A live run of one arm; a subclass says which nodes run, and how a fault begins and ends."""

    TITLE: str  # title of the run of a row; rows of the same title share a run
    LAYOUT: Layout = "drivers_apart"
    ATTEMPTS = 1  # injections after which a fault is judged even if a problem of the host concealed it
    SOUND_S = 0.5  # time with poses before each fault
    FAULT_S = 1.0  # duration of a fault
    ACKNOWLEDGE_S = 0.5  # time from its end to the acknowledgement
    REST_S = 0.0  # time after the acknowledgement
    BY_LEVEL = False  # whether a pose is wrong only beyond the protection level, see ``PoseJudge``
    watch: GraphWatch
    receiver: ArrivalReceiver

    def __init__(
        self, rows: Sequence[FaultRow], folder: Path, seed: int, interrupted: Callable[[], bool] = lambda: False
    ) -> None:
        """Write the arm into an existing folder; nothing is started yet. Rows of one title share a run."""
        self.rows, self.folder, self.interrupted = rows, folder, interrupted
        self.arm = self._write_arm(seed)
        self.simulation = ArmSimulation(self.arm, IMPERFECTIONS)
        self.joints: Sequence[str] = self.simulation.joints
        self._judge = PoseJudge(self.simulation, by_level=self.BY_LEVEL)

    def run(self) -> list[RowResult]:
        """Run the nodes, inject all faults; return the results.

        Raises ProcessError: a node failed, or the arm has no poses. Raises InterruptedRunError: the user interrupted
        the run.
        """
        self.receiver = ArrivalReceiver(self.arm.name, self.joints)
        with running_graph(self._programs(), self.receiver, self.folder, "faults", self.interrupted) as self.watch:
            self._prepare()
            results: dict[str, RowResult] = {}
            for _ in range(self.ATTEMPTS):
                # Judged after the last fault: meanwhile messages would wait, and seem to arrive late.
                for row, span in self._inject_all():
                    if row.title not in results or results[row.title].problem:
                        results[row.title] = self._result(row, span)
                if not any(result.problem for result in results.values()):
                    break
            return [results[row.title] for row in self.rows]

    def _write_arm(self, seed: int) -> ArmFile:
        return write_fault_arm(self.rows[0].arm, self.folder / "arm", CYCLE_S, seed)

    def _programs(self) -> list[ProgramCommand]:
        """Return the programs of the nodes."""
        programs = arm_programs(self.arm, driver_parameters=IMPERFECTION_PARAMETERS)
        return group_programs(programs, self.LAYOUT, self.folder)

    def _prepare(self) -> None:
        """Wait for poses once the programs have been started."""
        self._wait_for_poses()

    def _joint_of(self, _row: FaultRow) -> str:
        """Return the joint whose transforms are judged beside the endpoint; empty: no joint."""
        return self.joints[0] if self.joints else ""

    def _begin(self, row: FaultRow) -> None:
        """Begin a fault."""

    def _end(self, row: FaultRow) -> None:
        """End a fault."""

    def _wait_for_poses(self) -> None:
        """Wait until the arm has poses; acknowledge latched faults, as an operator does."""
        next_s = time.monotonic() + LATCHED_S

        def has_poses() -> bool:
            nonlocal next_s
            if time.monotonic() > next_s:
                next_s = time.monotonic() + LATCHED_S
                self.receiver.acknowledge_latched()
            return self.receiver.usable_endpoints(SETTLED_POSES)

        self.watch.wait(has_poses, lambda: "endpoint poses", SETTLING_TIMEOUT_S)

    def _inject_all(self) -> list[tuple[FaultRow, Span]]:
        return [(row, self._inject(row)) for row in self.rows]

    def _inject(self, row: FaultRow) -> Span:
        self._wait_for_poses()
        self.receiver.receive_for(self.SOUND_S)
        begin_ns = time.time_ns()
        self._begin(row)
        self.receiver.receive_for(self.FAULT_S)
        end_ns = time.time_ns()
        self._end(row)
        self.receiver.receive_for(self.ACKNOWLEDGE_S)
        if joint := self._joint_of(row):
            self.receiver.acknowledge(joint)
        self.receiver.receive_for(self.REST_S)
        self._wait_for_poses()
        return Span(begin_ns, end_ns, time.time_ns())

    def _first_naming_ns(self, row: FaultRow, span: Span) -> int | None:
        """Return when the first message came that names the fault [ns]; None: no message does."""
        return self.receiver.first_naming_ns(row.named_by, span.begin_ns, span.until_ns, self._joint_of(row))

    def _count_wrong(self, row: FaultRow, span: Span) -> int:
        """Return how many poses published as valid are wrong."""
        return self._judge.count_wrong(self.receiver, span.begin_ns, span.until_ns, self._joint_of(row))

    def _result(self, row: FaultRow, span: Span) -> RowResult:
        """Return the result of a fault from the published messages."""
        named_ns, (begin_ns, end_ns, until_ns) = self._first_naming_ns(row, span), span
        return RowResult(
            row,
            self.receiver.describe(begin_ns, end_ns, self._joint_of(row)),
            None if named_ns is None else (named_ns - begin_ns) / NS,
            self._count_wrong(row, span),
            covered=math.nan if row.is_observable else self._judge.covered_share(self.receiver, begin_ns, until_ns),
        )


class ReadingRun(InjectionRun):
    """Faults that the simulator injects into readings, scans and stamps, one in each slot of the scenario.

    ``inject`` of a row is the entry of the scenario file; ``also``: further ones at the same time.
    """

    TITLE, ATTEMPTS = "readings of {0.arm}", 3
    SLOT_S, LEAD_S = 2, 0.0  # from one fault of the scenario to the next; from its begin to that of its judgement
    SOUND_S, FAULT_S, ACKNOWLEDGE_S, REST_S = 0.2, 0.5, 0.2, 1.1

    def _write_arm(self, seed: int) -> ArmFile:
        """Write the arm with the faults in its scenario."""
        name, self._cycle_s = self.rows[0].arm, self.SLOT_S * max(2, len(self.rows))
        joints = list(write_fault_arm(name, self.folder / "sound", self._cycle_s, seed).calibrations)
        self._places = {
            row.title: (joints[n % len(joints)], self.SLOT_S * n + self.LEAD_S + self.SOUND_S)
            for n, row in enumerate(self.rows)
        }
        entries = []
        for row in self.rows:
            joint, begin_s = self._places[row.title]
            first = {key: value for key, value in row.inject.items() if key != "also"}
            span_s = begin_s - self.LEAD_S, begin_s + self.FAULT_S
            entries += [fault_entry(joint, each, *span_s) for each in (first, *row.inject.get("also", ()))]
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
        """Return the result from the first scan during the fault on; a problem if the host concealed the fault."""
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
