# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults of a physical cause in raw scans, and what becomes of the poses: the judge of the protection levels.

A pose is wrong where it is OK or DEGRADED, beyond 5 standard deviations of the truth, and beyond its own protection
level along or about an axis.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.calibration.designs import design, sized_design
from posor.estimation.estimate import ESTIMATE, Estimates
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES
from posor.numerics.vector import thetas_of
from posor.uncertainty.protection_level import joint_protection_levels

from posor_lab.faults.cause_injection import draw_sensors, draw_sizes, inject
from posor_lab.faults.fault_table import RowResult
from posor_lab.faults.offline_faults import draw_joint_poses
from posor_lab.faults.pose_judge import SIGMAS, estimated_poses, small_errors
from posor_lab.true_scans import TruePosor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.calibration.causes import Cause
    from posor.calibration.designs import SizedDesignName
    from posor.estimation.sensor_stack import Stack
    from posor.model.scan import Scans
    from posor_drivers.simulator.pose_array import PoseArray

    from posor_lab.faults.fault_table import FaultRow


@dataclass(frozen=True)
class CauseCount:
    """What became of scans with faults."""

    scans: int = 0
    ok: int = 0  # with a usable pose
    beyond: int = 0  # of these beyond 5 standard deviations
    wrong: int = 0  # of these beyond the protection level of the same scan
    unbounded: int = 0  # usable, with an infinite level on an axis
    largest: float = 0.0  # largest error as a share of its level

    def __add__(self, other: CauseCount) -> CauseCount:
        """Return the sums, and the larger share."""
        sums = {each.name: getattr(self, each.name) + getattr(other, each.name) for each in fields(self)[:-1]}
        return CauseCount(**sums, largest=max(self.largest, other.largest))

    def describe(self) -> str:
        """Return the figures as a phrase."""
        text = f"{self.ok} of {self.scans} with a pose, {self.beyond} beyond {SIGMAS:g} sigma, {self.wrong} of these"
        unbounded = f", level not bounded in {self.unbounded}" if self.unbounded else ""
        return f"{text} beyond the level, error at most {self.largest:.2f} of the level{unbounded}"


def judge_causes(
    calibration: Calibration,
    causes: Sequence[tuple[Cause, float]],
    truth: PoseArray,
    random: np.random.Generator,
    encoder: float = 0.0,
) -> CauseCount:
    """Return what becomes of scans of one drawn device with faults of all ``causes`` at once.

    ``causes``: with the share of the drawn size; ``truth``: pose of each scan; each scan is estimated by itself.
    ``encoder``: standard uncertainty of an encoder that is compared with each scan [rad]; zero: none.
    """
    posor = Posor(calibration)
    stack = draw_sensors(posor, random)
    scans = sound_scans(calibration, stack, truth, random)
    for cause, share in causes:
        scans = inject(cause, draw_sizes(cause, share, len(truth), random), scans, stack, random)
    thetas = thetas_of(truth.rotations) if posor.counts_bumps else None
    if encoder == 0.0:
        return judge_levels(posor, posor.estimate_each(scans, thetas, fault_effects=True), truth)
    records, effects = np.zeros(len(scans), dtype=ESTIMATE), posor.allocate_effects(len(scans))
    for n, theta in enumerate((thetas_of(truth.rotations) + encoder * random.normal(size=len(scans))).tolist()):
        posor.reset()
        posor.confirm_theta(theta, encoder)
        posor.estimate_records(scans._records[n : n + 1].copy(), records[n : n + 1], effects[n : n + 1])
    return judge_levels(posor, Estimates(records, scans, posor.reason, fault_effects=effects), truth)


def sound_scans(calibration: Calibration, stack: Stack, truth: PoseArray, random: np.random.Generator) -> Scans:
    """Return scans of a device by the independent truth, with noise, at the references of supply and temperature."""
    numbers: dict[str, Any] = {
        "supply_voltages": np.full(len(truth), 15.0),
        "temperatures": np.full(len(truth), 293.15),
    }
    stamps = np.arange(1, len(truth) + 1, dtype=np.int64) * 1_000_000
    real = TruePosor(calibration)
    return real.scans_at(stack, truth.rotations, truth.translations, stamps, noise=random, **numbers)


def judge_levels(posor: Posor, estimates: Any, truth: PoseArray) -> CauseCount:
    """Return the figures of estimates with fault effects."""
    usable = np.isin(estimates.states, USABLE_STATES)
    levels = joint_protection_levels(posor, estimates).levels[usable]
    poses, covariances = estimated_poses(estimates)
    errors = np.abs(small_errors(poses, truth)[usable])
    beyond = np.any(errors > SIGMAS * np.sqrt(np.diagonal(covariances[usable], axis1=1, axis2=2)), axis=1)
    outside = ~np.all(errors <= levels, axis=1)
    return CauseCount(
        scans=len(truth),
        ok=int(np.count_nonzero(usable)),
        beyond=int(np.count_nonzero(beyond)),
        wrong=int(np.count_nonzero(beyond & outside)),
        unbounded=int(np.count_nonzero(np.isinf(levels).any(axis=1))),
        largest=float(np.max(errors / levels, initial=0.0)),
    )


PAIR_SHARE = 0.5  # of the bounds of two causes at once
SCANS, DEVICES = 400, 5  # of each cause and stack: scans of a drawn device, and drawn devices


def cause_stacks() -> dict[str, Calibration]:
    """Return the calibration of each stack; each scan is estimated by itself, so there are no motion limits."""
    frames = ("receiving", "target")
    names: tuple[SizedDesignName, ...] = ("quad_light_ring", "quad_bumpy_ring", "triad_light_ring")
    stacks = {"quad_diodes": design("quad_diodes", frames=frames)}
    for name in names:
        sized = sized_design(name, 0.15, frames=frames, title=name)
        stacks[name] = sized.model_copy(update={"motion": None})
    return stacks


def run_causes(row: FaultRow, seed: int, scans: int = SCANS) -> RowResult:
    """Return the result of a row of causes in all stacks that have them.

    ``inject`` of the row: ``cause``, the name of one, or ``pairs``, for each two causes with bounds.
    """
    total, stacks = CauseCount(), []
    for number, (name, calibration) in enumerate(cause_stacks().items()):
        known = {cause.name: cause for cause in Posor(calibration).hypotheses.causes}
        if row.inject.get("pairs"):
            bounded = [cause for cause in known.values() if not cause.unlimited]
            cases = [[(one, PAIR_SHARE), (other, PAIR_SHARE)] for one, other in combinations(bounded, 2)]
        else:
            cause = known.get(row.inject["cause"])
            cases = [[(cause, 1.0)]] if cause else []
        found = CauseCount()
        for n, case in enumerate(cases):
            for device in range(1 if row.inject.get("pairs") else DEVICES):
                random = np.random.default_rng([seed, number, n, device])
                found += judge_causes(calibration, case, draw_joint_poses(scans, random), random)
        if cases:
            stacks.append(f"{name}: {found.describe()}")
            total += found
    covered = 1.0 if total.beyond == 0 else 1.0 - total.wrong / total.beyond
    return RowResult(row, "; ".join(stacks), None, total.beyond, covered=covered)
