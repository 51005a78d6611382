"""Faults of processes and links: nodes of the test rig are ended in every way, its link is cut, one after the other.

The nodes run in processes of their own. A relay between driver_node and posor_node is the link: when its process is
stopped, no scan arrives and no node announces its end, as when a cable is pulled. Lifecycle transitions are faults of
nodes that share a process: it must survive them.
"""

from __future__ import annotations

import signal
import time
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_STATE_TOPIC, RAW_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_bringup.supervisor import ProcessError, Program, Supervisor
from posor_drivers.simulator.arm_simulation import ArmSimulation

from posor_lab.faults import relay
from posor_lab.faults.fault_arm import IMPERFECTION_PARAMETERS, IMPERFECTIONS, write_fault_arm
from posor_lab.faults.fault_receiver import FaultReceiver
from posor_lab.faults.fault_table import FaultRow, RowResult
from posor_lab.faults.pose_judge import PoseJudge
from posor_lab.faults.reading_faults import SETTLED_POSES
from posor_lab.reports.graph_receiver import GraphWatch

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor_bringup.arm_programs import Layout
    from posor_bringup.supervisor import RunningProgram

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


class Disturbance(StrEnum):
    """What happens to a node, and how it is undone."""

    STOP = "stopped"
    """SIGSTOP, then SIGCONT."""
    KILL = "killed"
    """SIGKILL, then a new process."""
    INTERRUPT = "interrupted twice"
    """SIGINT, twice, then a new process; the exit code must be one of an orderly end."""
    CLEAN_UP = "deactivated and cleaned up beside other nodes"
    """Two lifecycle transitions of a node that shares its process, then two back."""


class ProcessFault(NamedTuple):
    """A row, the program that it concerns, and what happens to it."""

    row: FaultRow
    program: str
    disturbance: Disturbance

    @property
    def layout(self) -> Layout:
        """Which nodes share a process."""
        return "composed" if self.disturbance == Disturbance.CLEAN_UP else "separate"


def _rows() -> list[ProcessFault]:
    stale = ("STALE within 0.5 s, names the topic", "no input", "missing")
    gone = ("the endpoint's state stays away", ABSENCE)
    link = FaultRow("link cut", "network", "test_rig", stale[0], stale[1:])
    rows = [ProcessFault(link, "relay", Disturbance.STOP)]
    for disturbance in Disturbance:
        for program, (expected, *named_by) in {"driver_node": stale, "posor_node": stale, "chain_node": gone}.items():
            row = FaultRow(f"{program} {disturbance}", "off", "test_rig", expected, tuple(named_by))
            rows.append(ProcessFault(row, program, disturbance))
    return rows


PROCESS_FAULTS = tuple(_rows())


class ProcessRun:
    """A run of the test rig with one layout of its processes."""

    def __init__(
        self, faults: Sequence[ProcessFault], folder: Path, seed: int, interrupted: Callable[[], bool] = lambda: False
    ) -> None:
        """Write the arm; nothing is started yet.

        Args:
            faults: What to do, in this order, all with the same layout.
            folder: Existing folder for the copy of the arm and the logs.
            seed: Of motion and noise.
            interrupted: Whether the user has interrupted the run.

        """
        self._faults, self._folder, self._interrupted = faults, folder, interrupted
        self._arm = write_fault_arm("test_rig", folder / "arm", CYCLE_S, seed)
        simulation = ArmSimulation(self._arm, IMPERFECTIONS)
        (self._joint,) = simulation.joints
        self._poses = PoseJudge(simulation)

    def run(self) -> list[RowResult]:
        """Run the nodes and inject all faults; return the results.

        Raises:
            ProcessError: A node failed, or the arm has no poses.

        """
        with Supervisor(self._folder) as supervisor, FaultReceiver(self._arm.name, [self._joint]) as receiver:
            self._watch = GraphWatch(supervisor, receiver, "faults", interrupted=self._interrupted)
            running = {program.name.rpartition("/")[2]: supervisor.start(program) for program in self._programs()}
            self._rig = _RunningRig(self._arm.name, self._joint, supervisor, receiver, self._watch, running)
            return [self._inject(fault, receiver) for fault in self._faults]

    def _programs(self) -> list[Program]:
        """Return the nodes; in separate processes with a relay between the driver and the topic of its scans."""
        programs = arm_programs(self._arm, driver_parameters=IMPERFECTION_PARAMETERS)
        layout = self._faults[0].layout
        if layout == "composed":
            return group_programs(programs, layout, self._folder)
        link = f"/{self._arm.name}/link"
        path, ends = str(Path(relay.__file__)), (f"{link}/{RAW_TOPIC}", f"/{self._arm.name}/{self._joint}/{RAW_TOPIC}")
        return [
            *(replace(each, namespace=link) if each.ends else each for each in programs),
            Program("relay", "", path, ends),
        ]

    def _wait_for_poses(self, receiver: FaultReceiver) -> None:
        self._watch.wait(lambda: receiver.usable_endpoints(SETTLED_POSES), lambda: "endpoint poses")
        receiver.receive_for(SOUND_S)

    def _inject(self, fault: ProcessFault, receiver: FaultReceiver) -> RowResult:
        """Inject one fault, end it, and wait until the arm has poses again."""
        self._wait_for_poses(receiver)
        begin_ns = time.time_ns()
        self._rig.disturb(fault)
        receiver.receive_for(FAULT_S)
        end_ns = time.time_ns()
        self._rig.restore(fault)
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


@dataclass
class _RunningRig:
    """The running programs, by name, and what disturbs them."""

    arm: str
    joint: str
    supervisor: Supervisor
    receiver: FaultReceiver
    watch: GraphWatch
    running: dict[str, RunningProgram]

    def disturb(self, fault: ProcessFault) -> None:
        """Do to a node what the fault says.

        Raises:
            ProcessError: A process ended, or a transition failed.

        """
        match fault.disturbance:
            case Disturbance.STOP:
                self.running[fault.program].process.send_signal(signal.SIGSTOP)
            case Disturbance.KILL:
                self.supervisor.kill(self.running[fault.program])
            case Disturbance.INTERRUPT:
                for _ in range(2):
                    self.running[fault.program].process.send_signal(signal.SIGINT)
            case Disturbance.CLEAN_UP:
                self._change(fault.program, Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)

    def restore(self, fault: ProcessFault) -> None:
        """Let the node work again.

        Raises:
            ProcessError: The process did not end in order, or a transition failed.

        """
        match fault.disturbance:
            case Disturbance.STOP:
                self.running[fault.program].process.send_signal(signal.SIGCONT)
            case Disturbance.KILL:
                self._start_again(fault.program)
            case Disturbance.INTERRUPT:
                if not self.running[fault.program].wait_or_kill():
                    raise ProcessError("did not end after two SIGINTs", where=fault.program)
                self.supervisor.end([self.running[fault.program]])
                self._start_again(fault.program)
            case Disturbance.CLEAN_UP:
                self._change(fault.program, Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)

    def _start_again(self, name: str) -> None:
        self.running[name] = self.supervisor.start(self.running[name].program)

    def _change(self, name: str, *transitions: int) -> None:
        joint = "" if name == "chain_node" else f"{self.joint}/"
        client: Any = self.receiver.create_client(ChangeState, f"/{self.arm}/{joint}{name}/change_state")
        self.watch.wait(client.service_is_ready, lambda: f"the lifecycle service of {name}")
        for transition in transitions:
            request = ChangeState.Request()
            request.transition.id = transition
            answer = client.call_async(request)
            self.watch.wait(answer.done, lambda: f"a lifecycle transition of {name}")
            if not answer.result().success:
                raise ProcessError(f"lifecycle transition {transition} failed", where=name)
        self.receiver.destroy_client(client)


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
