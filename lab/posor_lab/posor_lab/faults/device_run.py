# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults of devices: a capaNCDT behind real sockets stalls, loses, corrupts or restarts its frames, or goes away.

The test rig reads its gap probes from the counterpart of the controller, whose clock drifts by 50 ppm and which also
splits and merges packets, and everything else from another device. The poses are compared with the truth behind both.
"""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_COVARIANCE_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_bringup.arms import load_checked_arm

from posor_lab.faults.injection_run import InjectionRun
from posor_lab.faults.pose_judge import SIGMAS
from posor_lab.harness.message_conversion import stamp_ns
from posor_lab.instruments.device_trials import DeviceTrial, serve_with_probes
from posor_lab.instruments.simulated_readings import SimulatedReadings
from posor_lab.instruments.trial_run import write_arm

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from posor_bringup.supervisor import ProgramCommand

    from posor_lab.device_servers.capancdt_server import CapaNcdtServer
    from posor_lab.faults.fault_table import FaultRow, RowResult
    from posor_lab.faults.injection_run import Span

RATE, LATENCY_S = 100, 0.1
SLOWNESS = 20.0
"""The arm moves slowly: a busy host delays frames, and the motion in this time is not a fault of the device."""
BACK_WITHIN_S = 2.0  # longest time from the end of a fault to the first pose
FRAMES_LOST = 1200  # consecutive frames, 0.3 s


def _set(name: str, value: object) -> Callable[[CapaNcdtServer], None]:
    return lambda server: setattr(server, name, value)


def _go_away(server: CapaNcdtServer) -> None:
    """Close the connection; later connections fail the check of the version."""
    server.answers["VER"] = "OTHER"
    server.drop_client()


ACTIONS: Mapping[str, Sequence[Callable[[CapaNcdtServer], None]]] = {
    "stalled": (lambda server: server.stalled.set(), lambda server: server.stalled.clear()),
    "loses frames": (_set("skip", FRAMES_LOST), lambda _: None),
    "corrupts frames": (_set("preamble", b"NOIS"), _set("preamble", b"SAEM")),
    "restarts its counter": (lambda server: server.restart_counter(), lambda _: None),
    "closes the connection": (lambda server: server.drop_client(), lambda _: None),
    "replaced by another model": (_go_away, lambda server: server.answers.clear()),
    "sends half a packet": (_set("split_at", 40), lambda server: server.released.set()),
}
"""How each fault begins and ends, by the name of its row without ``device``."""


class DeviceRun(InjectionRun):
    """A run of the test rig over devices."""

    TITLE, ACKNOWLEDGE_S = "devices", 0.0

    def __init__(
        self, rows: Sequence[FaultRow], folder: Path, seed: int, interrupted: Callable[[], bool] = lambda: False
    ) -> None:
        """Compute motion and readings; nothing is started yet. See ``InjectionRun``."""
        self.rows, self.folder, self.interrupted, self.joints = rows, folder, interrupted, []
        self._readings = SimulatedReadings(load_checked_arm(rows[0].arm), SLOWNESS, seed)
        self.arm = self._readings.arm

    def run(self) -> list[RowResult]:
        """Start the devices and run."""
        with ExitStack() as stack:
            self._server, self._devices = serve_with_probes(self._readings, stack)
            self._server.merged = 2
            return super().run()

    def _programs(self) -> list[ProgramCommand]:
        trial = DeviceTrial("faults", self.arm.name, RATE, LATENCY_S, 0.0, "capancdt_6200")
        arm = write_arm(self._readings.arm, trial, self._devices, self.folder)
        return group_programs(arm_programs(arm), "composed", self.folder)

    def _prepare(self) -> None:
        """Begin the motion when the arm has poses."""
        super()._prepare()
        self._readings.start_motion()

    def _begin(self, row: FaultRow) -> None:
        ACTIONS[row.name.removeprefix("device ")][0](self._server)

    def _end(self, row: FaultRow) -> None:
        ACTIONS[row.name.removeprefix("device ")][1](self._server)

    def _result(self, row: FaultRow, span: Span) -> RowResult:
        """Return the messages published about a fault, and when poses came again."""
        arrivals = self.receiver.between(ENDPOINT_COVARIANCE_TOPIC, span.end_ns, span.until_ns)
        back_s, found = math.inf, super()._result(row, span)
        if arrivals:
            back_s = (arrivals[0].time_ns - span.end_ns) / NS
        problem = f"no pose within {BACK_WITHIN_S:g} s of its end" if back_s > BACK_WITHIN_S else ""
        return replace(found, seen=f"{found.seen}; poses after {back_s:.2f} s", problem=problem)

    def _count_wrong(self, _row: FaultRow, span: Span) -> int:
        """Return how many positions of the endpoint are wrong."""
        poses = [each.message for each in self.receiver.endpoints_between(span.begin_ns, span.until_ns)]
        points = np.array([(p.x, p.y, p.z) for p in (each.pose.position for each in poses)]).reshape(-1, 3)
        errors = points - self._readings.true_points([stamp_ns(each) for each in poses]).reshape(-1, 3)
        variances = np.array([each.covariance_random for each in poses]).reshape(-1, 36)[:, [0, 7, 14]]
        return int(np.count_nonzero(~np.all(np.abs(errors) <= SIGMAS * np.sqrt(variances), axis=1)))
