# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Runs a trial: servers, one process with drivers and nodes, and the endpoint compared with the truth."""

from __future__ import annotations

import shutil
import time
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from posor.arm_names import ARM_FILE
from posor.chain.arm_file import ArmFile, load_arm_file
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_COVARIANCE_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_bringup.arms import load_checked_arm
from scipy.stats import chi2

from posor_lab.accuracy.consistency import REGION, normalised_squares
from posor_lab.harness.beams import quantity
from posor_lab.harness.message_conversion import stamp_ns
from posor_lab.instruments.simulated_readings import SimulatedReadings
from posor_lab.reports.arrival_receiver import ArrivalReceiver
from posor_lab.reports.graph_receiver import running_graph

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor.numerics.array_types import FloatArray

    from posor_lab.instruments.device_trials import Devices, DeviceTrial
    from posor_lab.reports.arrival_receiver import Arrival

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
    stamps_matter: bool  # whether the uncertainty of the stamps, of which only a bound is known, may enlarge the region
    pose_rate: float  # poses per second between the first and the last one
    inside_region: float  # share of the poses whose true position is inside their 95 % region
    rms_um: float  # position error, of all three axes together
    stated_um: float  # root of the mean trace of the stated covariance of the position
    clock_us: float  # standard uncertainty of the stamps of all devices, root mean square, from the diagnostics
    stamps_late_us: float  # time by which the motion explains the errors best; it holds the least delay of the device
    latency_ms: float  # median time from stamp to reception
    named_after_s: float  # from the stall of a device to the first diagnostics that name it
    poses_in_stall: int  # received later than named_after_s, while the device was silent
    back_after_s: float | None  # from the end of the stall to the first pose; None if it is not waited for


def run_trial(trial: DeviceTrial, folder: Path, interrupted: Callable[[], bool]) -> TrialFigures:
    """Run a trial with files and logs in an existing folder, until ``interrupted`` returns True.

    Raises InterruptedRunError: ``interrupted`` has returned True. Raises ProcessError: a node failed, or something that
    must happen did not happen in time.
    """
    readings = SimulatedReadings(load_checked_arm(trial.arm), trial.slowness)
    with ExitStack() as stack:
        devices = trial.serve(readings, stack)
        arm = write_arm(readings.arm, trial, devices, folder)
        receiver = ArrivalReceiver(arm.name)
        programs = group_programs(arm_programs(arm), "composed", folder)
        watch = stack.enter_context(running_graph(programs, receiver, folder, trial.name, interrupted))

        def wait_for_poses(count: int) -> float:
            start_s, begin = time.monotonic(), receiver.count(ENDPOINT_COVARIANCE_TOPIC)
            watch.wait(lambda: receiver.count(ENDPOINT_COVARIANCE_TOPIC) >= begin + count, lambda: "poses", TIMEOUT_S)
            return time.monotonic() - start_s

        wait_for_poses(SETTLED_POSES)
        readings.start_motion()
        begin_ns = time.time_ns()
        watch.wait_for(trial.seconds)
        clock_s, stall_ns = _clock_uncertainty(receiver), time.time_ns()
        devices.stalled.set()
        watch.wait(lambda: _is_stall_named(receiver, stall_ns), lambda: "diagnostics that name the stall", TIMEOUT_S)
        named_s, at_stall = (time.time_ns() - stall_ns) / NS, receiver.count(ENDPOINT_COVARIANCE_TOPIC)
        watch.wait_for(STALL_S)
        in_stall = receiver.count(ENDPOINT_COVARIANCE_TOPIC) - at_stall
        devices.stalled.clear()
        back_s = wait_for_poses(1) if trial.returns else None
    arrivals = receiver.endpoints_between(begin_ns, stall_ns)  # decoding them earlier would delay the servers
    return TrialFigures(
        name=trial.name,
        arm=trial.arm,
        rate=trial.rate,
        seconds=trial.seconds,
        keeps_pace=trial.keeps_pace,
        stamps_matter=trial.stamps_matter,
        clock_us=1e6 * clock_s,
        named_after_s=named_s,
        poses_in_stall=in_stall,
        back_after_s=back_s,
        **_pose_figures(readings, arrivals),
    )


def _clock_uncertainty(receiver: ArrivalReceiver) -> float:
    """Return the standard uncertainty of the stamps of all devices, root mean square [s]."""
    newest = {each.name: each.values for _, each in receiver.diagnostics if ": device " in each.name}
    found = [float(pair.value) for values in newest.values() for pair in values if pair.key == "clock_uncertainty"]
    return float(np.sqrt(np.mean(np.square(found))))


def _is_stall_named(receiver: ArrivalReceiver, stall_ns: int) -> bool:
    """Return whether diagnostics after a time [ns] have an error of a device."""
    newest = reversed(receiver.diagnostics)
    statuses = [status for _, status in takewhile(lambda arrival: arrival[0] > stall_ns, newest)]
    return any(": device " in each.name and each.level == each.ERROR for each in statuses)


def _share_inside(errors: FloatArray, covariances: FloatArray) -> float:
    """Return the share of errors, (n, 3), inside the 95 % region of their covariances, (n, 3, 3)."""
    return float(np.mean(normalised_squares(errors, covariances) < chi2.ppf(REGION, 3)))


def _pose_figures(readings: SimulatedReadings, arrivals: Sequence[Arrival]) -> dict[str, Any]:
    """Return the figures of the measured poses.

    Only noise is simulated behind the servers: one arm has one set of calibration errors, so the share of its poses
    inside a region shows nothing about them (``posor_lab arm`` draws many arms). The region is that of the random part.
    """
    stamps = [stamp_ns(each.message) for each in arrivals]
    points = [each.message.pose.position for each in arrivals]
    errors = np.array([(point.x, point.y, point.z) for point in points]) - readings.true_points(stamps)
    velocity = readings.joint_velocities(stamps).sum(axis=1)
    covariances = np.array([np.reshape(each.message.covariance_random, (6, 6))[:3, :3] for each in arrivals])
    latencies_ns = np.array([each.time_ns for each in arrivals]) - np.array(stamps)
    return {
        "poses": len(arrivals),
        "pose_rate": (len(arrivals) - 1) / ((stamps[-1] - stamps[0]) / NS),
        "inside_region": _share_inside(errors, covariances),
        "rms_um": float(1e6 * np.sqrt(np.mean(np.sum(errors**2, axis=1)))),
        "stated_um": float(1e6 * np.sqrt(np.mean(np.trace(covariances, axis1=1, axis2=2)))),
        "stamps_late_us": float(-1e6 * np.sum(errors * velocity) / square) if (square := np.sum(velocity**2)) else 0.0,
        "latency_ms": float(np.median(latencies_ns) * 1e3 / NS),
    }


def write_arm(arm: ArmFile, trial: DeviceTrial, devices: Devices, folder: Path) -> ArmFile:
    """Write a copy of an arm whose drivers read an instruments file."""
    instruments = {
        "format": "posor_instruments",
        "version": 1,
        "name": trial.arm,
        "rate": quantity(trial.rate, "Hz"),
        "latency": quantity(trial.latency_s, "s"),
        "devices": devices.devices,
        "joints": devices.joints,
    }
    copy = folder / "arm"
    shutil.copytree(arm.path.parent, copy)
    (copy / "instruments.yaml").write_text(yaml.safe_dump(instruments), encoding="utf-8")
    content = yaml.safe_load((copy / ARM_FILE).read_text(encoding="utf-8"))
    del content["scenario"]
    parameters = {"instruments.file": "{folder}/instruments.yaml", "instruments.joint": "{joint}"}
    content["driver"] = {"source": "instruments", "parameters": parameters}
    (copy / ARM_FILE).write_text(yaml.safe_dump(content), encoding="utf-8")
    return load_arm_file(copy / ARM_FILE)
