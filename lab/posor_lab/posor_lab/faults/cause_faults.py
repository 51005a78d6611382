"""Faults of a physical cause in raw scans, and what becomes of the poses: the judge of the protection levels.

The faults are made in voltages, currents and positions, not by the directions with which the estimator bounds them. A
pose is wrong where it is OK or DEGRADED, beyond 5 standard deviations of the truth, and beyond its own protection level
along or about an axis.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.calibration.causes import Pattern, Readings
from posor.calibration.designs import design, sized_design
from posor.estimation.estimate import ESTIMATE, Estimates
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES
from posor.numerics.vector import thetas_of
from posor.sensors.base import RowSensor
from posor.uncertainty.protection_level import joint_protection_levels

from posor_lab.faults.fault_table import RowResult
from posor_lab.faults.offline_faults import draw_joint_poses
from posor_lab.faults.pose_judge import SIGMAS, estimated_poses, small_errors
from posor_lab.faults.storm import draw_sensors
from posor_lab.true_scans import TruePosor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.calibration.causes import Cause
    from posor.calibration.designs import SizedDesignName
    from posor.estimation.sensor_stack import Stack
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray
    from posor_drivers.simulator.pose_array import PoseArray

    from posor_lab.faults.fault_table import FaultRow

UNLIMITED = {"m": (2e-7, 5e-5), "1": (1e-4, 2e-2)}
"""Smallest and largest size of an unlimited cause by its unit; it is drawn evenly by its logarithm."""
FIELDS = {"gap": "gap_voltages", "ring": "ring_voltages"}


def draw_sizes(cause: Cause, share: float, count: int, random: np.random.Generator) -> FloatArray:
    """Return sizes of a cause, half of them the bound, the others evenly up to it, times ``share``, (n,)."""
    if cause.bound is None:
        low, high = np.log(UNLIMITED[cause.unit])
        return share * np.asarray(np.exp(random.uniform(low, high, count)))
    sizes = cause.bound * random.uniform(0.0, 1.0, count)
    sizes[::2] = cause.bound
    return share * sizes


def inject(cause: Cause, sizes: FloatArray, scans: Scans, stack: Stack, random: np.random.Generator) -> Scans:
    """Return scans with a fault of random direction and random readings of one cause.

    ``sizes``: of the fault in each scan, (n,), in the cause's unit; ``stack``: the sensors that the scans come from.
    """
    readings, pattern, by = cause.move.readings, cause.move.pattern, cause.move.units[cause.unit]
    signed = sizes * random.choice([-1.0, 1.0], len(sizes))
    if by in {"supply", "temperature"}:
        field = "supply_voltages" if by == "supply" else "temperatures"
        return scans.with_fields({field: getattr(scans, field) + signed})
    if readings is Readings.DIODES and by != "length":
        return _inject_currents(pattern, by, sizes, scans, random)
    moved = _moves(readings, pattern, signed, stack, random)
    if by == "length":
        return with_readings(scans, stack, stack.linearise(scans).values + moved)
    changes = {}
    for kind, field in FIELDS.items():
        own = [n for n, name in enumerate(stack.reading_names) if name.startswith(kind)]
        volts = getattr(scans, field)
        changes[field] = volts * (1.0 + moved[:, own]) if by == "gain" else volts + moved[:, own]
    return scans.with_fields(changes)


def _moves(
    readings: Readings, pattern: Pattern, sizes: FloatArray, stack: Stack, random: np.random.Generator
) -> FloatArray:
    """Return by how much each reading moves in each scan, (n, m)."""
    prefixes = {Readings.GAPS: ("gap",), Readings.RING: ("ring",), Readings.DIODES: ("spot",)}
    prefix = prefixes.get(readings, ("gap", "ring") if readings is Readings.PROBES else ("",))
    rows = np.array([n for n, name in enumerate(stack.reading_names) if name.startswith(prefix)])
    count, out = len(sizes), np.zeros((len(sizes), stack.readings))
    angles = random.uniform(0.0, 2.0 * np.pi, count)
    direction = sizes[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    if pattern is Pattern.EACH:
        out[np.arange(count), random.choice(rows, count)] = sizes
    elif pattern is Pattern.COMMON:
        out[:, rows] = sizes[:, None]
    elif pattern is Pattern.SUBSETS:
        out[:, rows] = sizes[:, None] * random.integers(2, size=(count, len(rows)))
    elif pattern is Pattern.GRADIENT:  # probes are spread evenly over the circle
        around = 2.0 * np.pi * np.arange(len(rows)) / len(rows)
        out[:, rows] = direction @ np.stack([np.cos(around), np.sin(around)])
    elif pattern is Pattern.PLANE_COMMON:
        out[:, rows] = np.tile(direction, len(rows) // 2)
    else:
        first = rows[0] + 2 * random.integers(len(rows) // 2, size=count)
        out[np.arange(count), first], out[np.arange(count), first + 1] = direction.T
    return out


def _inject_currents(pattern: Pattern, by: str, sizes: FloatArray, scans: Scans, random: np.random.Generator) -> Scans:
    """Return scans with another gain of contacts, or with ambient light as a share of the source's."""
    currents, count = scans.diode_currents.copy(), len(sizes)
    diodes, each = currents.shape[1], np.arange(count)
    changed = np.zeros_like(currents)  # relative, or as a share of the mean current of a contact
    which = random.integers(diodes, size=count)
    angles = random.uniform(0.0, 2.0 * np.pi, count)
    if by == "ambient":
        share = currents.mean(axis=2) * np.abs(sizes)[:, None]
        if pattern is Pattern.COMMON:
            currents += share[..., None]
        else:
            currents[each, which] += share[each, which][:, None]
        return scans.with_fields({"diode_currents": currents})
    if pattern is Pattern.EACH:
        changed[each, which, random.integers(4, size=count)] = sizes
    else:
        of_axes = sizes[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        if pattern is Pattern.PLANE_COMMON:
            changed[:, :, :2] = of_axes[:, None]
        else:
            changed[each, which, :2] = of_axes
    return scans.with_fields({"diode_currents": currents * (1.0 + changed)})


def with_readings(scans: Scans, stack: Stack, readings: FloatArray) -> Scans:
    """Return scans whose linearised readings are ``readings``, (n, m)."""
    done = 0
    for sensor in stack.sensors:
        if isinstance(sensor, RowSensor):
            own = readings[:, done : done + len(sensor.reading_names)]
            done += own.shape[1]
            scans = scans.with_fields(sensor.encode(own, scans))
    return scans


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
