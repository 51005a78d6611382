"""Faults of devices: a capaNCDT behind real sockets stalls, loses, corrupts or restarts its frames, or goes away.

The test rig reads its gap probes from the counterpart of the controller, whose clock drifts by 50 ppm and which also
splits and merges packets, and everything else from another device. The poses are compared with the truth behind both.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.errors import TopicError
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_COVARIANCE_TOPIC
from posor_bringup.arms import load_checked_arm
from posor_ros.message_conversion import stamp_ns

from posor_lab.faults.fault_receiver import FaultReceiver
from posor_lab.faults.fault_table import Arm, FaultKind, FaultRow, RowResult
from posor_lab.faults.pose_judge import SIGMAS
from posor_lab.harness.program import Program, installed
from posor_lab.instruments.device_trials import DeviceTrial, serve_with_probes
from posor_lab.instruments.simulated_readings import SimulatedReadings
from posor_lab.instruments.trial_run import write_arm
from posor_lab.reports.console_progress import InterruptedRunError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor_lab.device_servers.capancdt_server import CapaNcdtServer

ARM: Arm = "test_rig"
RATE, LATENCY_S = 100, 0.1
SLOWNESS = 20.0
"""Of the arm: a busy host delays frames, and the motion in this time is no fault of the device."""
FAULT_S, SOUND_S = 1.0, 0.5
BACK_WITHIN_S = 2.0
"""From the end of a fault to the first pose."""
TIMEOUT_S = 60.0
SETTLED_POSES = 20
FRAMES_LOST = 1200
"""Consecutive frames, 0.3 s."""


class DeviceFault(NamedTuple):
    """A row, and how the fault begins and ends."""

    row: FaultRow
    begin: Callable[[CapaNcdtServer], None]
    end: Callable[[CapaNcdtServer], None] = lambda _: None


def _row(name: str, kind: FaultKind, expected: str, *named_by: str) -> FaultRow:
    return FaultRow(f"device {name}", kind, ARM, expected, named_by)


def _set(name: str, value: object) -> Callable[[CapaNcdtServer], None]:
    return lambda server: setattr(server, name, value)


def _go_away(server: CapaNcdtServer) -> None:
    """Close the connection and accept no other one that works."""
    server.answers["VER"] = "OTHER"
    server.drop_client()


NAMED = "the diagnostics name the device within 0.5 s, no wrong pose, connected again"
DEVICE_FAULTS = (
    DeviceFault(_row("stalled", "off", NAMED, "no frame for"), lambda s: s.stalled.set(), lambda s: s.stalled.clear()),
    DeviceFault(_row("loses frames", "network", NAMED, "no frames of probes"), _set("skip", FRAMES_LOST)),
    DeviceFault(
        _row("corrupts frames", "network", NAMED, "a packet begins with"),
        _set("preamble", b"NOIS"),
        _set("preamble", b"SAEM"),
    ),
    DeviceFault(_row("restarts its counter", "network", NAMED, "went back"), lambda s: s.restart_counter()),
    DeviceFault(_row("closes the connection", "network", NAMED, "closed the connection"), lambda s: s.drop_client()),
    DeviceFault(
        _row("replaced by another model", "network", NAMED, "the answer to '$VER'"),
        _go_away,
        lambda s: s.answers.clear(),
    ),
    DeviceFault(
        _row("sends half a packet", "off", NAMED, "no frame for"), _set("split_at", 40), lambda s: s.released.set()
    ),
)


class DeviceRun:
    """A run of the test rig over devices, with one fault after the other."""

    def __init__(
        self, faults: Sequence[DeviceFault], folder: Path, seed: int, interrupted: Callable[[], bool] = lambda: False
    ) -> None:
        """Compute motion and readings; nothing is started yet.

        Args:
            faults: What to do, in this order.
            folder: Existing folder for the copy of the arm and the logs.
            seed: Of the noise.
            interrupted: Whether the user has interrupted the run.

        """
        self._faults, self._folder, self._interrupted = faults, folder, interrupted
        self._readings = SimulatedReadings(load_checked_arm(ARM), SLOWNESS, seed)
        (self._joint,) = self._readings.channels

    def run(self) -> list[RowResult]:
        """Start devices and nodes, inject all faults, and return the results.

        Raises:
            TopicError: The arm has no poses.
            InterruptedRunError: The user interrupted the run.

        """
        with ExitStack() as stack:
            self._server, devices = serve_with_probes(self._readings, stack)
            self._server.merged = 2
            trial = DeviceTrial("faults", ARM, RATE, LATENCY_S, 0.0, lambda *_: devices)
            arm = write_arm(self._readings.arm, trial, devices, self._folder)
            arguments = [str(arm), "--layout", "composed", "--output", str(self._folder / "out")]
            program = stack.enter_context(Program([*installed("posor_bringup", "bringup"), *arguments]))
            self._receiver = stack.enter_context(FaultReceiver(ARM, [self._joint]))
            self._wait_for_poses()
            self._readings.start_motion()
            results = [self._inject(fault) for fault in self._faults]
            program.end()
        return results

    def _wait_for_poses(self) -> None:
        deadline_s = time.monotonic() + TIMEOUT_S
        receiver = self._receiver
        receiver.receive_until(
            lambda: receiver.usable_endpoints(SETTLED_POSES) or self._interrupted() or time.monotonic() > deadline_s
        )
        if self._interrupted():
            raise InterruptedRunError("interrupted", where="faults")
        if not receiver.usable_endpoints(SETTLED_POSES):
            raise TopicError(f"no poses within {TIMEOUT_S:g} s", where="faults of devices", expected="a running arm")

    def _inject(self, fault: DeviceFault) -> RowResult:
        """Inject one fault, end it, and wait until the arm has poses again."""
        receiver = self._receiver
        self._wait_for_poses()
        receiver.receive_for(SOUND_S)
        begin_ns = time.time_ns()
        fault.begin(self._server)
        receiver.receive_for(FAULT_S)
        end_ns = time.time_ns()
        fault.end(self._server)
        self._wait_for_poses()
        back_ns = next(each.time_ns for each in receiver.between(ENDPOINT_COVARIANCE_TOPIC, end_ns, time.time_ns()))
        named_ns = receiver.first_naming_ns(fault.row.named_by, begin_ns, end_ns)
        seen = f"{receiver.describe(begin_ns, end_ns)}; poses after {(back_ns - end_ns) / NS:.2f} s"
        late = back_ns - end_ns > BACK_WITHIN_S * NS
        result = RowResult(
            fault.row,
            seen,
            None if named_ns is None else (named_ns - begin_ns) / NS,
            self._count_wrong(begin_ns, time.time_ns()),
        )
        return replace(result, problem=f"no pose within {BACK_WITHIN_S:g} s of its end") if late else result

    def _count_wrong(self, begin_ns: int, end_ns: int) -> int:
        """Return how many endpoint poses that came between two times [ns] are wrong."""
        poses = [each.message for each in self._receiver.between(ENDPOINT_COVARIANCE_TOPIC, begin_ns, end_ns)]
        if not poses:
            return 0
        points = np.array([(p.x, p.y, p.z) for p in (each.pose.pose.position for each in poses)])
        errors = points - self._readings.true_points([stamp_ns(each) for each in poses])
        spreads = np.sqrt([np.diagonal(np.reshape(each.pose.covariance, (6, 6)))[:3] for each in poses])
        return int(np.count_nonzero(~np.all(np.abs(errors) <= SIGMAS * spreads, axis=1)))
