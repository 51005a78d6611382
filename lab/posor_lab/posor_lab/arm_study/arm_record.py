# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Record of an arm over a number of ticks: truth, endpoint by POSORs and by encoders, and why poses are missing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from posor_drivers.simulator.pose_array import PoseArray

from posor_lab.accuracy.consistency import REGION_LIMIT, normalised_squares
from posor_lab.harness.random_poses import errors_in_parent

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pinocchio as pin
    from posor.numerics.array_types import BoolArray, FloatArray
    from posor_drivers.simulator.arm_simulation import ArmSimulation

CHAIN, TRUTH = "chain", "truth"  # keys of ``ArmRecord.reasons`` beside the joints
NO_SCAN = "sent no scan"
GIVEN_UP = "given up by the chain, a transform came too late"
DROPPED = "scan dropped by the scenario"
MISSED = "tick missed, its process was late"
BLOCK = 200  # ticks simulated at a time, to know which scans are dropped
UNKNOWN = np.full((3, 3), np.nan), np.full(3, np.nan)


@dataclass(frozen=True)
class ArmRecord:
    """n successive ticks of an arm; NaN: no message was received."""

    ticks: range  # numbers of the ticks
    times_s: FloatArray  # times since the first tick [s], (n,)
    truth: PoseArray  # true poses of the endpoint in the base
    posor: PoseArray  # poses of the endpoint by the POSORs
    covariances: FloatArray  # covariances published with them, (n, 6, 6), ROS order
    encoders: PoseArray  # poses of the endpoint by the encoders and nominal kinematics
    target: PoseArray  # commanded poses of the endpoint
    stage: FloatArray  # position of the micromanipulator stage [m], (n, 3), axes of the endpoint
    reasons: tuple[Mapping[str, str], ...]  # for each tick without a pose the reasons, by joint, ``CHAIN`` or ``TRUTH``

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def has_pose(self) -> BoolArray:
        """Whether both the POSORs' pose and the truth are known, (n,)."""
        return np.isfinite(self.posor.translations[:, 0]) & np.isfinite(self.truth.translations[:, 0])

    @property
    def is_complete(self) -> bool:
        """Whether everything was received; the stage is optional."""
        known = all(np.isfinite(poses.translations).all() for poses in (self.encoders, self.target))
        return known and not any(self.reasons)

    @cached_property
    def posor_errors(self) -> FloatArray:
        """POSORs minus truth, (n, 6), ROS order: x, y, z [m], about X, Y, Z [rad], axes of the base."""
        return pose_errors(self.posor, self.truth)

    @cached_property
    def encoder_errors(self) -> FloatArray:
        """Encoders minus truth, as ``posor_errors``."""
        return pose_errors(self.encoders, self.truth)

    @cached_property
    def normalised(self) -> FloatArray:
        """Normalised error squared of the POSORs' pose with its published covariance, (n,)."""
        out = np.full(len(self), np.nan)
        known = self.has_pose
        out[known] = normalised_squares(self.posor_errors[known], self.covariances[known])
        return out

    @property
    def inside(self) -> float:
        """Share of the poses inside their published 95 % region; NaN without poses."""
        known = self.has_pose
        return float(np.mean(self.normalised[known] <= REGION_LIMIT)) if known.any() else float("nan")

    @cached_property
    def target_distances(self) -> FloatArray:
        """Distance of the true endpoint from its target [m], (n,)."""
        return np.asarray(np.linalg.norm(self.truth.translations - self.target.translations, axis=1))


def pose_errors(found: PoseArray, true: PoseArray) -> FloatArray:
    """Return errors of poses in ROS order, (n, 6); NaN where a pose is unknown."""
    out = np.full((len(found), 6), np.nan)
    known = np.isfinite(found.translations[:, 0]) & np.isfinite(true.translations[:, 0])
    if known.any():
        out[known] = errors_in_parent(
            found.rotations[known], found.translations[known], true.rotations[known], true.translations[known]
        )
    return out


def pose_array(poses: Sequence[pin.SE3 | None]) -> PoseArray:
    """Return poses as arrays, NaN for None."""
    parts = [UNKNOWN if pose is None else (pose.rotation, pose.translation) for pose in poses]
    return PoseArray(*map(np.array, zip(*parts, strict=True)))


def rms(values: FloatArray) -> float:
    """Return the root mean square of the known values (n,), or of the lengths of known vectors (n, 3)."""
    lengths = np.linalg.norm(values, axis=1) if values.ndim > 1 else values
    known = lengths[np.isfinite(lengths)]
    return float(np.sqrt(np.mean(np.square(known)))) if known.size else float("nan")


class Dropouts:
    """Scans that the scenario drops; they depend only on the tick."""

    def __init__(self, simulation: ArmSimulation) -> None:
        """Ticks are simulated in blocks when they are needed."""
        self._simulation = simulation
        self._sent: dict[int, dict[str, BoolArray]] = {}

    def dropped_joints(self, tick: int) -> frozenset[str]:
        """Return the joints whose scan of a tick is dropped."""
        block, index = divmod(tick, BLOCK)
        if block not in self._sent:
            ticks = np.arange(block * BLOCK, (block + 1) * BLOCK)
            self._sent[block] = {joint: self._simulation.scans(joint, ticks).sent for joint in self._simulation.joints}
        return frozenset(joint for joint, sent in self._sent[block].items() if not sent[index])


@dataclass(frozen=True)
class NodeCounters:
    """Counters of the nodes at the end of a run."""

    missed: Mapping[str, int]  # ticks missed by the driver of each joint
    incomplete: int  # scans that the chain gave up because a transform was missing or late


@dataclass(frozen=True)
class TickOutcomes:
    """Outcomes of the ticks of a run."""

    ticks: int  # number of ticks
    poses: int  # number of ticks with a pose
    causes: Mapping[str, int]  # number of ticks without a pose by cause; a tick may have several causes
    unaccounted: int  # number of ticks without a pose that no counter explains

    @property
    def sentence(self) -> str:
        """The outcomes as text."""
        causes = "; ".join(f"{cause}: {count}" for cause, count in self.causes.items())
        return f"{self.poses} with a pose, {self.ticks - self.poses} without" + (f" ({causes})" if causes else "")


def count_outcomes(records: Sequence[ArmRecord], simulation: ArmSimulation, counters: NodeCounters) -> TickOutcomes:
    """Return the outcomes of the ticks of some records: a pose, or the cause of its absence, as the nodes count it."""
    causes: Counter[str] = Counter()
    late: Counter[str] = Counter()
    dropouts, seen_by_chain = Dropouts(simulation), 0
    for record in records:
        for tick, reasons in zip(record.ticks, record.reasons, strict=True):
            for who, reason in reasons.items():
                cause = reason
                if who == TRUTH:  # the last joint's driver publishes the truth
                    cause = MISSED
                    late[simulation.joints[-1]] += 1
                elif reason == NO_SCAN:
                    dropped = who in dropouts.dropped_joints(tick)
                    cause = DROPPED if dropped else MISSED
                    late[who] += not dropped
                causes[cause if who == CHAIN else f"{who} {cause}"] += 1
            without_scan = sum(reason == NO_SCAN for who, reason in reasons.items() if who != TRUTH)
            seen_by_chain += (
                0 < without_scan < len(simulation.joints)
            )  # the chain does not notice a tick without any scan
    unaccounted = sum(max(0, count - counters.missed[joint]) for joint, count in late.items())
    unaccounted += max(0, causes[GIVEN_UP] + seen_by_chain - counters.incomplete)
    poses = int(sum(np.count_nonzero(record.has_pose) for record in records))
    return TickOutcomes(sum(map(len, records)), poses, dict(causes), unaccounted)
