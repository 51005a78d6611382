"""Runs the nodes of an arm and injects faults one after the other: what all live runs of the fault table share."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, NamedTuple

from posor.numerics.stamps import NS
from posor_drivers.simulator.arm_simulation import ArmSimulation

from posor_lab.faults.fault_arm import CYCLE_S, IMPERFECTIONS, write_fault_arm
from posor_lab.faults.fault_table import RowResult
from posor_lab.faults.pose_judge import PoseJudge
from posor_lab.reports.arrival_receiver import ArrivalReceiver
from posor_lab.reports.graph_receiver import running_graph

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor.chain.arm_file import Arm as ArmFile
    from posor_bringup.supervisor import Program

    from posor_lab.faults.fault_table import FaultRow
    from posor_lab.reports.graph_receiver import GraphWatch

SETTLED_POSES = 20
"""Endpoint poses without interruption before a fault."""
SETTLING_TIMEOUT_S = 90.0
"""Longest time until the arm has poses."""
LATCHED_S = 0.7
"""Time between two acknowledgements of latched faults while the arm has no poses."""


class Span(NamedTuple):
    """Times of one fault [ns]."""

    begin_ns: int
    end_ns: int
    until_ns: int  # of the last message that is judged


class InjectionRun(ABC):
    """A live run of one arm; a subclass says which nodes run, and how a fault begins and ends.

    Attributes:
        SOUND_S: Time with poses before each fault.
        FAULT_S: Duration of a fault.
        ACKNOWLEDGE_S: Time from its end to the acknowledgement.
        REST_S: Time after the acknowledgement.
        SETTLES: Whether the run waits for poses between two faults.
        ATTEMPTS: Injections after which a fault is judged even if a problem of the host concealed it.

    """

    SOUND_S, FAULT_S, ACKNOWLEDGE_S, REST_S = 0.5, 1.0, 0.5, 0.0
    SETTLES, ATTEMPTS = True, 1

    def __init__(
        self, rows: Sequence[FaultRow], folder: Path, seed: int, interrupted: Callable[[], bool] = lambda: False
    ) -> None:
        """Write the arm; nothing is started yet.

        Args:
            rows: Faults of the same ``group``, injected in this order.
            folder: Existing folder for the copy of the arm and the logs.
            seed: Of motion, noise and faults.
            interrupted: Whether the user has interrupted the run.

        """
        self.rows, self.folder, self.interrupted = rows, folder, interrupted
        self.arm = self.write_arm(seed)
        self.simulation = ArmSimulation(self.arm, IMPERFECTIONS)
        self.joints: Sequence[str] = self.simulation.joints
        self.judge = PoseJudge(self.simulation)

    @staticmethod
    @abstractmethod
    def group(row: FaultRow) -> str:
        """Return the title of the run to which a row belongs."""

    @abstractmethod
    def programs(self) -> list[Program]:
        """Return the programs of the nodes; they may write files into ``folder``."""

    @abstractmethod
    def begin(self, row: FaultRow) -> None:
        """Begin a fault."""

    @abstractmethod
    def end(self, row: FaultRow) -> None:
        """End a fault."""

    def write_arm(self, seed: int) -> ArmFile:
        """Write the copy of the arm."""
        return write_fault_arm(self.rows[0].arm, self.folder / "arm", CYCLE_S, seed)

    def prepare(self) -> None:
        """Wait for poses once the programs have been started."""
        self.wait_for_poses()

    def joint_of(self, _row: FaultRow) -> str:
        """Return the joint whose transforms are judged beside the endpoint; empty: no joint."""
        return self.joints[0] if self.joints else ""

    def wait_for_begin(self, _row: FaultRow) -> int:
        """Return the time at which a fault begins [ns], once it has come."""
        return time.time_ns()

    def in_order(self, rows: Sequence[FaultRow]) -> Sequence[FaultRow]:
        """Return rows in the order of their injection."""
        return rows

    def problem(self, _row: FaultRow, _span: Span) -> str:
        """Return why an injection does not count; empty: it counts."""
        return ""

    def first_faulted_ns(self, _row: FaultRow, span: Span) -> int:
        """Return the stamp of the first faulted message [ns]."""
        return span.begin_ns

    def first_naming_ns(self, row: FaultRow, span: Span) -> int | None:
        """Return when the first message came that names the fault [ns]; None: no message does."""
        return self.receiver.first_naming_ns(row.named_by, span.begin_ns, span.until_ns, self.joint_of(row))

    def count_wrong(self, row: FaultRow, span: Span) -> int:
        """Return how many poses published as valid are wrong."""
        return self.judge.count_wrong(self.receiver, span.begin_ns, span.until_ns, self.joint_of(row))

    def run(self) -> list[RowResult]:
        """Run the nodes, inject all faults; return the results.

        Raises:
            ProcessError: A node failed, or the arm has no poses.
            InterruptedRunError: The user interrupted the run.

        """
        self.receiver = ArrivalReceiver(self.arm.name, self.joints)
        with running_graph(self.programs(), self.receiver, self.folder, "faults", self.interrupted) as self.watch:
            self.prepare()
            results: dict[str, RowResult] = {}
            for _ in range(self.ATTEMPTS):
                pending = [row for row in self.rows if row.title not in results or results[row.title].problem]
                # Judged after the last fault: meanwhile messages would wait, and seem to arrive late.
                spans = [(row, self._inject(row)) for row in self.in_order(pending)]
                results |= {row.title: self.result(row, span) for row, span in spans}
            return [results[row.title] for row in self.rows]

    watch: GraphWatch
    receiver: ArrivalReceiver

    def wait_for_poses(self) -> None:
        """Wait until the arm has poses; acknowledge latched faults, as an operator does."""
        next_s = time.monotonic() + LATCHED_S

        def has_poses() -> bool:
            nonlocal next_s
            if time.monotonic() > next_s:
                next_s = time.monotonic() + LATCHED_S
                self.receiver.acknowledge_latched()
            return self.receiver.usable_endpoints(SETTLED_POSES)

        self.watch.wait(has_poses, lambda: "endpoint poses", SETTLING_TIMEOUT_S)

    def _inject(self, row: FaultRow) -> Span:
        if self.SETTLES:
            self.wait_for_poses()
            self.receiver.receive_for(self.SOUND_S)
        begin_ns = self.wait_for_begin(row)
        self.begin(row)
        self.receiver.receive_for(self.FAULT_S)
        end_ns = time.time_ns()
        self.end(row)
        self.receiver.receive_for(self.ACKNOWLEDGE_S)
        if joint := self.joint_of(row):
            self.receiver.acknowledge(joint)
        self.receiver.receive_for(self.REST_S)
        if self.SETTLES:
            self.wait_for_poses()
        return Span(begin_ns, end_ns, time.time_ns())

    def result(self, row: FaultRow, span: Span) -> RowResult:
        """Return what was published about a fault."""
        named_ns, begin_ns, until_ns = self.first_naming_ns(row, span), span.begin_ns, span.until_ns
        return RowResult(
            row,
            self.receiver.describe(begin_ns, span.end_ns, self.joint_of(row)),
            None if named_ns is None else max(0.0, (named_ns - self.first_faulted_ns(row, span)) / NS),
            self.count_wrong(row, span),
            covered=math.nan if row.is_observable else self.judge.covered_share(self.receiver, begin_ns, until_ns),
            problem=self.problem(row, span),
        )
