"""Runs a trial: servers, one process with drivers and nodes, and the endpoint compared with the truth."""

from __future__ import annotations

import shutil
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml
from geometry_msgs.msg import PoseWithCovarianceStamped
from posor.errors import TopicError
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_COVARIANCE_TOPIC
from posor_bringup.arms import ARM_FILE, load_checked_arm
from posor_ros.message_conversion import stamp_ns
from rclpy.serialization import deserialize_message
from scipy.stats import chi2

from posor_lab.accuracy.consistency import REGION, normalised_squares
from posor_lab.harness.graph import BEST_EFFORT, Graph
from posor_lab.harness.program import Program, installed
from posor_lab.instruments.simulated_readings import SimulatedReadings
from posor_lab.reports.console_progress import InterruptedRunError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor.chain.arm_file import Arm
    from posor.numerics.array_types import FloatArray

    from posor_lab.instruments.device_trials import Devices, DeviceTrial

SETTLED_POSES = 5
STALL_S = 2.0
TIMEOUT_S = 120.0


@dataclass(frozen=True)
class TrialFigures:
    """Figures of a trial; all simulated."""

    name: str
    arm: str
    rate: int  # scans per second, as the instruments file states it
    seconds: float
    poses: int
    keeps_pace: bool  # whether the rate of the poses is judged
    stamps_matter: bool  # whether the region is judged with the uncertainty of the stamps
    pose_rate: float  # poses per second between the first and the last one
    inside_region: float  # share of the poses whose true position is inside their 95 % region
    rms_um: float  # position error, of all three axes together
    stated_um: float  # root of the mean trace of the stated covariance of the position
    clock_us: float  # standard uncertainty of the stamps of all devices, root mean square, from the diagnostics
    inside_with_stamps: float  # as inside_region, with the motion in this time added to the covariance
    stamps_late_us: float  # time by which the motion explains the errors best; it holds the least delay of the device
    latency_ms: float  # median time from stamp to reception
    named_after_s: float  # from the stall of a device to the first diagnostics that name it
    poses_in_stall: int  # received later than named_after_s, while the device sent nothing
    back_after_s: float | None  # from the end of the stall to the first pose; None if it is not waited for


class _Receiver:
    """Serialised poses of the endpoint with their time of reception."""

    def __init__(self, graph: Graph, topic: str) -> None:
        self.poses: list[bytes] = []
        self.received_ns: list[int] = []
        self._subscription = graph.node.create_subscription(
            PoseWithCovarianceStamped, topic, self._on_pose, BEST_EFFORT, raw=True
        )

    def _on_pose(self, pose: bytes) -> None:
        self.poses.append(pose)
        self.received_ns.append(time.time_ns())


def run_trial(trial: DeviceTrial, folder: Path, interrupted: Callable[[], bool]) -> TrialFigures:
    """Run a trial.

    Args:
        trial: The trial.
        folder: Existing folder for files and logs.
        interrupted: Called often; ends the trial where it returns True.

    Raises:
        InterruptedRunError: ``interrupted`` has returned True.
        TopicError: What must happen did not happen in time.

    """
    readings = SimulatedReadings(load_checked_arm(trial.arm), trial.slowness)
    with ExitStack() as stack:
        devices = trial.serve(readings, stack)
        arm = write_arm(readings.arm, trial, devices, folder)
        arguments = [str(arm), "--layout", "composed", "--output", str(folder / "out")]
        program = stack.enter_context(Program([*installed("posor_bringup", "bringup"), *arguments]))
        graph = stack.enter_context(Graph())
        receiver = _Receiver(graph, f"/{trial.arm}/{ENDPOINT_COVARIANCE_TOPIC}")
        graph.watch_diagnostics()

        def wait(condition: Callable[[], bool], what: str, limit_s: float = TIMEOUT_S) -> float:
            start_s = time.monotonic()
            while not condition():
                graph.receive()
                if interrupted():
                    raise InterruptedRunError("interrupted", where=trial.name)
                if time.monotonic() - start_s > limit_s:
                    raise TopicError(f"no {what} within {limit_s:g} s", where=trial.name, expected="a running arm")
            return time.monotonic() - start_s

        wait(lambda: len(receiver.poses) >= SETTLED_POSES, "poses")
        readings.start_motion()
        begin, end_s = len(receiver.poses), time.monotonic() + trial.seconds
        wait(lambda: time.monotonic() >= end_s, "end", trial.seconds + TIMEOUT_S)
        measured = _Measured(receiver.poses[begin:], receiver.received_ns[begin:], _clock_uncertainty(graph))
        seen = len(graph.diagnostics)
        devices.stalled.set()
        named_s = wait(lambda: _is_stall_named(graph, seen), "diagnostics that name the stall")
        at_stall = len(receiver.poses)
        end_s = time.monotonic() + STALL_S
        wait(lambda: time.monotonic() >= end_s, "end of the stall")
        in_stall = len(receiver.poses) - at_stall
        devices.stalled.clear()
        taken = len(receiver.poses)
        back_s = wait(lambda: len(receiver.poses) > taken, "pose after the stall") if trial.returns else None
        program.end()
    return _figures(trial, readings, measured, named_s, in_stall, back_s)


class _Measured(NamedTuple):
    """Serialised poses of the measurement, and the uncertainty of their stamps."""

    poses: list[bytes]
    received_ns: list[int]
    clock_s: float


def _clock_uncertainty(graph: Graph) -> float:
    """Return the standard uncertainty of the stamps of all devices, root mean square [s]."""
    newest = {each.name: each.values for each in graph.diagnostics if ": device " in each.name}
    found = [float(pair.value) for values in newest.values() for pair in values if pair.key == "clock_uncertainty"]
    return float(np.sqrt(np.mean(np.square(found))))


def _share_inside(errors: FloatArray, covariances: FloatArray) -> float:
    """Return the share of errors, (n, 3), inside the 95 % region of their covariances, (n, 3, 3)."""
    return float(np.mean(normalised_squares(errors, covariances) < chi2.ppf(REGION, 3)))


def _is_stall_named(graph: Graph, seen: int) -> bool:
    """Return whether diagnostics after the first ``seen`` ones have an error of a device."""
    return any(": device " in each.name and each.level == each.ERROR for each in graph.diagnostics[seen:])


def _figures(
    trial: DeviceTrial,
    readings: SimulatedReadings,
    measured: _Measured,
    named_s: float,
    in_stall: int,
    back_s: float | None,
) -> TrialFigures:
    poses: list[Any] = [deserialize_message(pose, PoseWithCovarianceStamped) for pose in measured.poses]
    stamps = [stamp_ns(pose) for pose in poses]
    points = [pose.pose.pose.position for pose in poses]
    errors = np.array([(point.x, point.y, point.z) for point in points]) - readings.true_points(stamps)
    velocities = readings.joint_velocities(stamps)
    of_stamps = measured.clock_s**2 * np.einsum("nji,njk->nik", velocities, velocities)
    velocity = velocities.sum(axis=1)
    covariances = np.array([np.reshape(pose.pose.covariance, (6, 6))[:3, :3] for pose in poses])
    return TrialFigures(
        name=trial.name,
        arm=trial.arm,
        rate=trial.rate,
        seconds=trial.seconds,
        poses=len(poses),
        keeps_pace=trial.keeps_pace,
        stamps_matter=trial.stamps_matter,
        pose_rate=(len(poses) - 1) / ((stamps[-1] - stamps[0]) / NS),
        inside_region=_share_inside(errors, covariances),
        rms_um=float(1e6 * np.sqrt(np.mean(np.sum(errors**2, axis=1)))),
        stated_um=float(1e6 * np.sqrt(np.mean(np.trace(covariances, axis1=1, axis2=2)))),
        clock_us=1e6 * measured.clock_s,
        inside_with_stamps=_share_inside(errors, covariances + of_stamps),
        stamps_late_us=float(-1e6 * np.sum(errors * velocity) / square) if (square := np.sum(velocity**2)) else 0.0,
        latency_ms=float(np.median(np.array(measured.received_ns) - np.array(stamps)) * 1e3 / NS),
        named_after_s=named_s,
        poses_in_stall=in_stall,
        back_after_s=back_s,
    )


def write_arm(arm: Arm, trial: DeviceTrial, devices: Devices, folder: Path) -> Path:
    """Write a copy of an arm whose drivers read an instruments file; return the arm file.

    Only noise is simulated behind the servers: one arm has one set of calibration errors, so the share of its poses
    inside a region says nothing about them (``posor_lab arm`` draws many arms). The copy publishes the random
    part of the covariance alone, and its beams are exact.
    """
    instruments = {
        "format": "posor_instruments",
        "version": 1,
        "name": trial.arm,
        "rate": {"value": trial.rate, "unit": "Hz"},
        "latency": {"value": trial.latency_s, "unit": "s"},
        "devices": devices.devices,
        "joints": devices.joints,
    }
    copy = folder / "arm"
    shutil.copytree(arm.path.parent, copy)
    (copy / "instruments.yaml").write_text(yaml.safe_dump(instruments), encoding="utf-8")
    content = yaml.safe_load((copy / ARM_FILE).read_text(encoding="utf-8"))
    del content["scenario"]
    for joint in content["joints"].values():
        joint["parameters"] = {"covariance": "random"}
    _write_exact_beams(copy / content["beams"])
    parameters = {"instruments.file": "{folder}/instruments.yaml", "instruments.joint": "{joint}"}
    content["driver"] = {"source": "instruments", "parameters": parameters}
    (copy / ARM_FILE).write_text(yaml.safe_dump(content), encoding="utf-8")
    return copy / ARM_FILE


def _write_exact_beams(path: Path) -> None:
    """Set the uncertainties of a beams file to zero."""
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    for beam in content["beams"]:
        for quantity in beam.get("uncertainty", {}).values():
            quantity["value"] = [0.0] * len(quantity["value"])
        if "sag" in beam:
            beam["sag"]["uncertainty"]["value"] = 0.0
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
