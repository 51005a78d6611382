"""Faults of processes and links: nodes of the test rig are stopped or killed, its link is cut, one after the other.

The nodes run in processes of their own. A relay between driver_node and posor_node is the link: when its process is
stopped, no scan arrives and no node announces its end, as when a cable is pulled.
"""

from __future__ import annotations

import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from posor_bringup.arm_programs import arm_programs
from posor_bringup.supervisor import Program, Supervisor
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_estimator.numerics.stamps import NS
from posor_estimator.ros_names import ENDPOINT_STATE_TOPIC, RAW_TOPIC

from posor_validation.faults import relay
from posor_validation.faults.fault_arm import write_fault_arm
from posor_validation.faults.fault_receiver import FaultReceiver
from posor_validation.faults.fault_table import FaultRow, RowResult
from posor_validation.faults.pose_judge import PoseJudge
from posor_validation.faults.reading_faults import IMPERFECTIONS, SETTLED_POSES
from posor_validation.reports.graph_receiver import GraphWatch

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor_bringup.supervisor import RunningProgram

    from posor_validation.faults.fault_table import FaultKind

FAULT_S = 1.0
"""Time from a fault to the restart or continuation of the process."""
SOUND_S = 0.5
ABSENCE_S = 0.3
"""Silence of the endpoint's state that a subscriber takes for the loss of chain_node [s].

During a silence of the input the state is published every 0.08 s, but only from its detection on (0.2 s to 0.28 s).
"""
ABSENCE = "absence"
"""In ``FaultRow.named_by``: the fault is named by the absence of the endpoint's state."""
CYCLE_S = 20


class ProcessFault(NamedTuple):
    """A row, the program that it concerns, and the signal that it receives."""

    row: FaultRow
    program: str
    signal: signal.Signals


def _rows() -> list[ProcessFault]:
    rows = []

    def add(name: str, kind: FaultKind, expected: str, program: str, number: signal.Signals, *named_by: str) -> None:
        rows.append(ProcessFault(FaultRow(name, kind, "test_rig", expected, named_by), program, number))

    stale, gone = ("no input", "missing"), "the endpoint's state stays away"
    names = "STALE within 0.5 s, names the topic"
    add("driver_node stopped", "off", names, "driver_node", signal.SIGSTOP, *stale)
    add("posor_node stopped", "off", names, "posor_node", signal.SIGSTOP, *stale)
    add("chain_node stopped", "off", gone, "chain_node", signal.SIGSTOP, ABSENCE)
    add("link cut", "network", names, "relay", signal.SIGSTOP, *stale)
    add("driver_node killed", "off", names, "driver_node", signal.SIGKILL, *stale)
    add("posor_node killed", "off", names, "posor_node", signal.SIGKILL, *stale)
    add("chain_node killed", "off", gone, "chain_node", signal.SIGKILL, ABSENCE)
    return rows


PROCESS_FAULTS = tuple(_rows())


class ProcessRun:
    """A run of the test rig in separate processes."""

    def __init__(
        self, faults: Sequence[ProcessFault], folder: Path, seed: int, interrupted: Callable[[], bool] = lambda: False
    ) -> None:
        """Write the arm; nothing is started yet.

        Args:
            faults: What to do, in this order.
            folder: Existing folder for the copy of the arm and the logs.
            seed: Of motion and noise.
            interrupted: Whether the user has interrupted the run.

        """
        self._faults, self._folder, self._interrupted = faults, folder, interrupted
        self._arm = write_fault_arm("test_rig", folder / "arm", CYCLE_S, seed)
        simulation = ArmSimulation(self._arm, Imperfections(dropouts=False, zero_drift=False))
        (self._joint,) = simulation.joints
        self._poses = PoseJudge(simulation)

    def run(self) -> list[RowResult]:
        """Run the nodes and inject all faults; return the results.

        Raises:
            ProcessError: A node failed, or the arm has no poses.

        """
        with Supervisor(self._folder) as supervisor:
            receiver = FaultReceiver(self._arm.name, [self._joint])
            try:
                self._watch = GraphWatch(supervisor, receiver, "faults", interrupted=self._interrupted)
                running = {program.name.rpartition("/")[2]: supervisor.start(program) for program in self._programs()}
                return [self._inject(fault, receiver, supervisor, running) for fault in self._faults]
            finally:
                receiver.close()

    def _programs(self) -> list[Program]:
        """Return the nodes, with a relay between the driver and the topic of its scans."""
        link = f"/{self._arm.name}/link"
        path, ends = str(Path(relay.__file__)), (f"{link}/{RAW_TOPIC}", f"/{self._arm.name}/{self._joint}/{RAW_TOPIC}")
        programs = arm_programs(self._arm, driver_parameters=IMPERFECTIONS)
        return [
            *(replace(each, namespace=link) if each.ends else each for each in programs),
            Program("relay", "", path, ends),
        ]

    def _wait_for_poses(self, receiver: FaultReceiver) -> None:
        self._watch.wait(lambda: receiver.usable_endpoints(SETTLED_POSES), lambda: "endpoint poses")
        receiver.receive_for(SOUND_S)

    def _inject(
        self, fault: ProcessFault, receiver: FaultReceiver, supervisor: Supervisor, running: dict[str, RunningProgram]
    ) -> RowResult:
        """Inject one fault, end it, and wait until the arm has poses again."""
        self._wait_for_poses(receiver)
        program, begin_ns = running[fault.program], time.time_ns()
        is_killed = fault.signal == signal.SIGKILL
        if is_killed:
            supervisor.kill(program)
        else:
            program.process.send_signal(fault.signal)
        receiver.receive_for(FAULT_S)
        end_ns = time.time_ns()
        if is_killed:
            running[fault.program] = supervisor.start(program.program)
        else:
            program.process.send_signal(signal.SIGCONT)
        receiver.receive_for(SOUND_S)
        receiver.acknowledge(self._joint)
        self._wait_for_poses(receiver)
        if ABSENCE in fault.row.named_by:
            named_ns = first_absence_ns(receiver, begin_ns, end_ns)
        else:
            named_ns = receiver.first_naming_ns(fault.row.named_by, begin_ns, end_ns)
        return RowResult(
            fault.row,
            receiver.describe(begin_ns, end_ns),
            None if named_ns is None else (named_ns - begin_ns) / NS,
            self._poses.count_wrong(receiver, begin_ns, time.time_ns(), self._joint),
        )


def first_absence_ns(receiver: FaultReceiver, begin_ns: int, end_ns: int) -> int | None:
    """Return when the endpoint's state has stayed away for ``ABSENCE_S`` after a time [ns]; None: it has not."""
    newest = receiver.newest(ENDPOINT_STATE_TOPIC)
    if newest is None:
        return None
    arrivals = [each.time_ns for each in receiver.between(ENDPOINT_STATE_TOPIC, begin_ns, end_ns)]
    last_ns, absence_ns = begin_ns, round(ABSENCE_S * NS)
    for arrival_ns in [*arrivals, end_ns]:
        if arrival_ns - last_ns > absence_ns:
            return last_ns + absence_ns
        last_ns = arrival_ns
    return None
