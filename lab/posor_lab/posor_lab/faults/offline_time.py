# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults of time through estimator, synchroniser and chain without nodes: more kinds and sizes than nodes can run.

An arm moves at up to 0.7 rad/s and rests in between, with 200 scans per second. ``inject`` of a row holds:

* ``faults``: each has a kind of the simulator with its size, or ``gap_jump``, a shift of all gap probes [m]; ``at``, if
  it does not begin at the usual time [s]; ``until``, if it does not last to the end;
* ``joints``: ``all``; else the faults fall on one joint after the other, in a run of its own;
* ``stamp_limit``: the largest error of the stamps that the drivers of these joints state [s];
* ``draws``: instead of these, so many runs with two different faults at random times.

A pose is wrong if it is valid, and beyond 5 standard deviations of the truth and the largest error by its stamp. The
truth is that of the readings where a clock was set, else that at the stamp. The mean delay of bursts shows nowhere:
with bursts only poses that are OK count.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from posor.bags.arm_estimator import EndpointPipeline
from posor.bags.recording import unpack_poses
from posor.chain.arm_file import CHAIN_NODE, chain_parameters
from posor.estimation.posor import Posor
from posor.messages.estimate_arrays import estimate_joint
from posor.messages.joint_transform import TransformConstants
from posor.messages.raw_scan import RecordedScans
from posor.model.fault import USABLE_STATES, Fault, State
from posor.node_parameters import ChainParameters
from posor.numerics.stamps import NS, tick_stamp_ns
from posor.parameter_model import validate_parameters
from posor.sensors.gap_probes import GapProbesCalibration
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.faults import KINDS, SimulatedFault
from posor_drivers.simulator.pose_array import PoseArray
from scipy.spatial.transform import Rotation

from posor_lab.faults.fault_table import IMPERFECTIONS, RowResult, fault_entry, write_fault_arm
from posor_lab.faults.pose_judge import SIGMAS, estimated_poses, true_poses
from posor_lab.harness.beams import quantity

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from posor.estimation.estimate import Estimates
    from posor.numerics.array_types import FloatArray, IntArray

    from posor_lab.faults.fault_table import ArmName, FaultRow

    Changes = Sequence[Mapping[str, Any]]
    """``faults`` of a row."""

RATE, CYCLE_S, RESTS = 200, 8, 2
FIRST_TICK = 1000 * CYCLE_S * RATE
AT_S = 2.7  # usual begin of a fault
FALSE_ALARM = 1e-9  # small, so that every LOST scan is due to the fault
CLOCK_IS_SET = ("clock", "restart", "number")
"""Kinds after which stamp or number of a scan are not those of its readings any more."""
GAP_JUMP = "gap_jump"
DRAWN = {
    "late_scan": (1, 60, (1,)),
    "clock": (0.003, 40.0, (-1, 1)),
    "restart": (0.001, 0.9, (-1,)),
    "number": (1, 9000, (-1, 1)),
    GAP_JUMP: (3e-4, 1e-3, (-1, 1)),
}
"""Least and greatest amount, uniform in its logarithm, and signs of faults that are drawn."""
SWINGS: Mapping[ArmName, tuple[float, float]] = {
    "six_axis": (0.2, 1.0),
    "five_axis": (0.2, 1.0),
    "five_axis_checked": (0.2, 1.0),
    "test_rig": (0.04, 0.25),
    "quad_rig": (0.04, 0.25),
}
"""Amplitude [rad], and time between two waypoints [s]."""


class TimeCount(NamedTuple):
    """Figures of a run."""

    wrong: int = 0  # valid poses of joints and endpoint that are wrong
    refused: int = 0  # scans refused because of their time, of the joint with most of them
    unusable: int = 0  # scans without a pose that have one without faults, of the joint with most of them
    ends_without: int = 0  # joints without a pose at the end


class OfflineArm:
    """An arm in motion, and what its scans give with and without faults."""

    def __init__(self, name: ArmName, folder: Path, seed: int, rate: int = RATE) -> None:
        """Write the arm into a new folder and estimate its scans without faults."""
        amplitude, waypoint_s = SWINGS[name]
        arm = write_fault_arm(
            name, folder, CYCLE_S, seed, waypoint_s=waypoint_s, amplitude=amplitude, rests=RESTS, rate=rate
        )
        self.simulation = ArmSimulation(arm, IMPERFECTIONS)
        self.joints: Sequence[str] = self.simulation.joints
        self._ticks, self._rate = FIRST_TICK // RATE * rate + np.arange(CYCLE_S * rate), rate
        self._parameters = validate_parameters(ChainParameters, dict(chain_parameters(arm)), node=CHAIN_NODE)
        self._sound = {joint: self._estimate(self.simulation, joint, (), 0.0) for joint in self.joints}

    def run(self, joints: Sequence[str], faults: Changes, stamp_limit: float = 0.0) -> TimeCount:
        """Return the figures with faults of joints."""
        entries = [each for joint in joints for fault in faults for each in self._entries(joint, fault)]
        simulation = self.simulation.with_faults(entries)
        found = {joint: self._estimate(simulation, joint, faults, stamp_limit) for joint in joints}
        usable = {joint: np.isin(each.states, USABLE_STATES) for joint, each in found.items()}
        sound = {joint: np.isin(self._sound[joint].states, USABLE_STATES) for joint in joints}
        is_set = any(kind in fault for fault in faults for kind in CLOCK_IS_SET)
        everywhere = is_set and len(joints) == len(self.joints)
        judged = dict(found)
        if any("burst" in fault for fault in faults):
            judged = {joint: each.select(each.states == State.OK) for joint, each in found.items()}
        wrong = sum(self._count_wrong_joint(joint, each, is_set=is_set) for joint, each in judged.items())
        return TimeCount(
            wrong + self._count_wrong_endpoints({**self._sound, **judged}, is_set=everywhere),
            max(int(np.count_nonzero(each.faults & Fault.BAD_READING)) for each in found.values()),
            max(int(np.count_nonzero(sound[joint] & ~each)) for joint, each in usable.items()),
            sum(not each[-self._rate // 10 :].any() for each in usable.values()),
        )

    def _entries(self, joint: str, fault: Mapping[str, Any]) -> list[SimulatedFault]:
        """Return a fault of a row as entries of a scenario file."""
        begin_s, end_s = fault.get("at", AT_S), fault.get("until", float(CYCLE_S))
        ((kind, size),) = [(key, value) for key, value in fault.items() if key not in ("at", "until")]
        changes: list[dict[str, Any]] = []
        if kind == GAP_JUMP:
            calibration = self.simulation.calibrations[joint]
            (sensor,) = [each for each in calibration.sensors if isinstance(each, GapProbesCalibration)]
            for probe in sensor.probes:
                volts = quantity(size / float(probe.volts_to_gap.array[1]), "V")
                changes.append({"kind": "offset", "channel": probe.name, "size": volts})
        else:
            changes.append({"kind": kind, "size": quantity(size, KINDS[kind].unit)})
        return [SimulatedFault.model_validate(fault_entry(joint, each, begin_s, end_s)) for each in changes]

    def _estimate(self, simulation: ArmSimulation, joint: str, faults: Changes, stamp_limit: float) -> Estimates:
        """Return the estimates of a joint; the time of their readings is stated as that of the log."""
        ticks = self._ticks_of_readings(faults)
        simulation.start_at(joint, int(ticks[0]))
        scans = simulation.scans(joint, self._ticks).scans
        posor = Posor(simulation.calibrations[joint], false_alarm=FALSE_ALARM)
        if stamp_limit:
            scans = scans.with_fields({"stamp_limits": np.full(len(scans), stamp_limit)})
        stamps = np.column_stack(np.divmod(scans.stamps_ns, NS))
        order = len(self.joints) * np.arange(len(scans)) + self.joints.index(joint)
        times_ns = tick_stamp_ns(ticks, self._rate)
        frame = posor.calibration.frames.parent
        return estimate_joint(posor, RecordedScans(times_ns, order, scans, stamps, scans.statuses, frame))

    def _ticks_of_readings(self, faults: Changes) -> IntArray:
        """Return the tick of the readings of each scan."""
        ticks = self._ticks.copy()
        for fault in faults:
            begin = round(fault.get("at", AT_S) * self._rate)
            if "late_scan" in fault:
                exchanged = slice(begin, begin + fault["late_scan"] + 1)
                ticks[exchanged] = np.roll(ticks[exchanged], -1)
            if "aged" in fault:
                ticks[begin : round(fault.get("until", CYCLE_S) * self._rate)] -= round(fault["aged"] * self._rate)
        return ticks

    def _count_wrong_joint(self, joint: str, found: Estimates, *, is_set: bool) -> int:
        valid = np.isin(found.states, USABLE_STATES)
        times_ns = found.log_times_ns if is_set else found.stamps_ns
        true = true_poses(self.simulation, times_ns[valid], joint)
        poses, covariances = estimated_poses(found.select(valid))
        return _count_wrong(poses, true, covariances, found.stamp_shifts[valid])

    def _count_wrong_endpoints(self, joints: Mapping[str, Estimates], *, is_set: bool) -> int:
        calibrations = self.simulation.calibrations
        transforms = {name: TransformConstants.of(Posor(each)) for name, each in calibrations.items()}
        pipeline = EndpointPipeline(self.simulation.chain, self._parameters, transforms)
        orders = {name: len(joints) * np.arange(len(each)) + n for n, (name, each) in enumerate(joints.items())}
        found = pipeline.estimate(joints, orders)
        if not len(found):
            return 0
        true = true_poses(self.simulation, found.log_times_ns if is_set else found.stamps_ns)
        return _count_wrong(PoseArray(*unpack_poses(found.poses)), true, found.covariances(), found.stamp_shifts)


def _count_wrong(found: PoseArray, true: PoseArray, covariances: FloatArray, shifts: FloatArray) -> int:
    """Return how many poses are wrong; ``shifts``: largest errors by the stamps, (n, 6)."""
    turns = Rotation.from_matrix(found.rotations @ np.swapaxes(true.rotations, 1, 2)).as_rotvec()
    errors = np.column_stack([found.translations - true.translations, turns])
    allowed = SIGMAS * np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)) + shifts
    return int(np.count_nonzero(~np.all(np.abs(errors) <= allowed, axis=1)))


def run_offline_times(rows: Sequence[FaultRow], folder: Path, seed: int) -> list[RowResult]:
    """Return the results of rows of one arm."""
    arm = OfflineArm(cast("ArmName", rows[0].arm), folder / rows[0].arm, seed)
    return [_run_row(row, arm, seed) for row in rows]


def _run_row(row: FaultRow, arm: OfflineArm, seed: int) -> RowResult:
    counts = [arm.run(**each) for each in _runs(row.inject, arm.joints, seed)]
    wrong, refused, unusable, ended = np.array(counts).T
    seen = f"at most {refused.max()} scans refused, {unusable.max()} without a pose; {len(counts)} runs"
    problem = f"{ended.sum()} joints end without a pose" if row.recovers and ended.any() else ""
    lost = int((refused if row.uncounts else unusable).max())
    return RowResult(row, seen, None, int(wrong.sum()), lost=lost, scans=CYCLE_S * RATE, problem=problem)


def _runs(inject: Mapping[str, Any], joints: Sequence[str], seed: int) -> Iterator[dict[str, Any]]:
    """Return the arguments of ``OfflineArm.run`` for each run of a row."""
    if "draws" not in inject:
        groups = [joints] if inject.get("joints") == "all" else [[joint] for joint in joints]
        for group in groups:
            yield {**inject, "joints": group}
        return
    random = np.random.default_rng(seed)
    for _ in range(inject["draws"]):
        begins = np.sort(random.uniform(0.5, CYCLE_S - 2.0, 2)).tolist()
        kinds = random.choice(list(DRAWN), 2, replace=False).tolist()
        faults = [_drawn_fault(kind, begin_s, random) for kind, begin_s in zip(kinds, begins, strict=True)]
        faults.sort(key=lambda fault: "late_scan" not in fault)  # others shift the stamps of exchanged scans, too
        everywhere = random.uniform() < 0.3  # noqa: PLR2004  a share
        yield {"joints": joints if everywhere else [joints[int(random.integers(len(joints)))]], "faults": faults}


def _drawn_fault(kind: str, begin_s: float, random: np.random.Generator) -> dict[str, Any]:
    low, high, signs = DRAWN[kind]
    size = float(random.choice(signs)) * math.exp(random.uniform(math.log(low), math.log(high)))
    is_whole = kind in KINDS and KINDS[kind].unit == "1"
    return {kind: round(size) if is_whole else size, "at": round(begin_s * RATE) / RATE}
