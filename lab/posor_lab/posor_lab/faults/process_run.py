# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults of processes and links: nodes of the test rig are ended in every way, its link is cut, one after the other.

The nodes run in processes of their own. A relay between driver_node and posor_node is the link: when its process is
stopped, no scan arrives and no node announces its end, as when a cable is pulled. Lifecycle transitions are faults of
nodes that share a process: it must survive them. ``inject`` of a row: ``layout``, ``program``, its ``disturbance``:

- ``stop``: SIGSTOP, then SIGCONT.
- ``kill``: SIGKILL, then a new process.
- ``interrupt``: SIGINT, twice, then a new process; the exit code must show an orderly end.
- ``clean_up``: two lifecycle transitions of a node that shares its process, then two back.
"""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_STATE_TOPIC, RAW_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_bringup.supervisor import ProcessError, ProgramCommand

from posor_lab.faults import relay
from posor_lab.faults.fault_table import IMPERFECTION_PARAMETERS
from posor_lab.faults.injection_run import InjectionRun

if TYPE_CHECKING:
    from posor_bringup.supervisor import RunningProgram

    from posor_lab.faults.fault_table import FaultRow
    from posor_lab.faults.injection_run import Span
    from posor_lab.reports.arrival_receiver import ArrivalReceiver

ABSENCE_S = 0.3
"""Silence of the endpoint's state that a subscriber takes for the loss of chain_node [s].

During a silence of the input the state is published every 0.08 s, but only from its detection on (0.2 s to 0.28 s).
"""
ABSENCE = "absence"  # in ``FaultRow.named_by``: the fault is named by the absence of the endpoint's state


class ProcessRun(InjectionRun):
    """A run of the test rig with one layout of its processes."""

    TITLE = "processes, layout {0.inject[layout]}"

    def _programs(self) -> list[ProgramCommand]:
        """Return the nodes; in separate processes with a relay between the driver and the topic of its scans."""
        programs = arm_programs(self.arm, driver_parameters=IMPERFECTION_PARAMETERS)
        if self.rows[0].inject["layout"] == "composed":
            return group_programs(programs, "composed", self.folder)
        link = f"/{self.arm.name}/link"
        ends = f"{link}/{RAW_TOPIC}", f"/{self.arm.name}/{self.joints[0]}/{RAW_TOPIC}"
        return [
            *(replace(each, namespace=link) if each.ends else each for each in programs),
            ProgramCommand("relay", "", str(Path(relay.__file__)), ends),
        ]

    def _prepare(self) -> None:
        """Name the running programs by their executables."""
        super()._prepare()
        self._running: dict[str, RunningProgram] = {
            name.rpartition("/")[2]: running for name, running in self.watch.running.items()
        }

    def _begin(self, row: FaultRow) -> None:
        name = row.inject["program"]
        match row.inject["disturbance"]:
            case "stop":
                self._running[name].process.send_signal(signal.SIGSTOP)
            case "kill":
                self.watch.supervisor.kill(self._running[name])
            case "interrupt":
                for _ in range(2):
                    self._running[name].process.send_signal(signal.SIGINT)
            case "clean_up":
                self._change(name, Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)

    def _end(self, row: FaultRow) -> None:
        name = row.inject["program"]
        match row.inject["disturbance"]:
            case "stop":
                self._running[name].process.send_signal(signal.SIGCONT)
                return
            case "clean_up":
                self._change(name, Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
                return
            case "interrupt":
                if not self._running[name].wait_or_kill():
                    raise ProcessError("did not end after two SIGINTs", where=name)
                self.watch.supervisor.end([self._running[name]])
        self._running[name] = self.watch.supervisor.start(self._running[name].program)

    def _change(self, name: str, *transitions: int) -> None:
        joint = "" if name == "chain_node" else f"{self.joints[0]}/"
        service = f"/{self.arm.name}/{joint}{name}/change_state"
        for transition in transitions:
            request = ChangeState.Request(transition=Transition(id=transition))
            if not self.watch.call(ChangeState, service, request).success:
                raise ProcessError(f"lifecycle transition {transition} failed", where=name)

    def _first_naming_ns(self, row: FaultRow, span: Span) -> int | None:
        """Return when the first message came that names the fault, or the absence of messages does [ns]."""
        if ABSENCE in row.named_by:
            return first_absence_ns(self.receiver, span.begin_ns, span.end_ns)
        return super()._first_naming_ns(row, span)


def first_absence_ns(receiver: ArrivalReceiver, begin_ns: int, end_ns: int) -> int | None:
    """Return when the endpoint's state has stayed away for ``ABSENCE_S`` after a time [ns]; None: it has not."""
    last_ns, absence_ns = begin_ns, round(ABSENCE_S * NS)
    for arrival_ns in [*(each.time_ns for each in receiver.between(ENDPOINT_STATE_TOPIC, begin_ns, end_ns)), end_ns]:
        if arrival_ns - last_ns > absence_ns:
            return last_ns + absence_ns
        last_ns = arrival_ns
    return None
