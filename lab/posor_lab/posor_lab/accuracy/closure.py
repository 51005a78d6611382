"""Noise-free closure: scans of known poses through the estimator and through the closed form of the thesis.

The closed form holds for small angles without tilts, slanting rays and bump profile. Of more than three gap probes it
takes the plane of least squares. Source: thesis, equations 5.3 to 5.5 and 5.32.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.designs import BUMPS, DesignName, design
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.model.native_coordinates import rotation_from_native, thetas_of
from posor.model.reading_rows import GAP, RING, SPOT_X

from posor_lab.harness.random_poses import errors_in_parent, readable_poses

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from posor.numerics.array_types import FloatArray, IntArray


@dataclass(frozen=True)
class LargestError:
    """Largest errors over all poses; infinite if a pose was not found."""

    translation_m: float
    rotation_rad: float


def _largest(errors: FloatArray) -> LargestError:
    return LargestError(*(float(np.max(np.linalg.norm(part, axis=1))) for part in (errors[:, :3], errors[:, 3:])))


def closure(stack: DesignName, count: int, seed: int) -> tuple[LargestError, LargestError]:
    """Return the largest error of the estimator and of the closed form over random poses of a design."""
    random = np.random.default_rng(seed)
    posor = Posor(design(stack))
    rotations, translations = readable_poses(posor, stack, count, random)
    scans = scans_at(posor.stack, rotations, translations, np.arange(count, dtype=np.int64))
    thetas = thetas_of(rotations)
    bumps = [sensor.bump_angle for sensor in posor.calibration.sensors if sensor.bump_angle > 0.0]
    estimates = posor.estimate_each(scans, bumps[0] * np.round(thetas / bumps[0]) if bumps else None)
    if np.any(estimates.states != State.OK):
        exact = LargestError(math.inf, math.inf)
    else:
        exact = _largest(errors_in_parent(estimates.rotations, estimates.translations, rotations, translations))
    readings, pool = posor.stack.linearise(scans), posor.stack.pool
    poses = [
        closed_form(pool[rows], values, BUMPS, theta)
        for rows, values, theta in zip(readings.selected, readings.values, thetas, strict=True)
    ]
    found_rotations, found_translations = (np.array(part) for part in zip(*poses, strict=True))
    return exact, _largest(errors_in_parent(found_rotations, found_translations, rotations, translations))


def closed_form(
    rows: NDArray[np.void], readings: FloatArray, bumps: int, known_theta: float
) -> tuple[FloatArray, FloatArray]:
    """Return R_R_T (3, 3) and the origin of T in R (3,) [m] of one scan by the closed form.

    Args:
        rows: Reading rows, shape (m,), dtype ROW: three or more gaps, then two spots or four ring gaps.
        readings: Linearised readings [m], shape (m,).
        bumps: Number of bumps of the ring.
        known_theta: Theta to half a bump [rad]; for rings.

    """
    kinds = rows["kind"]
    tips = rows["tip"][kinds == GAP]
    plane = np.column_stack([np.ones(len(tips)), tips[:, 1], -tips[:, 0]])
    (gap, tan_alpha, tan_beta), *_ = np.linalg.lstsq(plane, readings[kinds == GAP])
    alpha, beta = math.atan(tan_alpha), math.atan(tan_beta)
    if np.any(kinds == RING):
        x, y, theta = _solve_ring(rows[kinds == RING], readings[kinds == RING], bumps, known_theta)
    else:
        x, y, theta = _solve_spots(rows, readings, np.flatnonzero(kinds == SPOT_X))
    return rotation_from_native(alpha, beta, theta), np.array([x, y, gap])


def _solve_spots(rows: NDArray[np.void], readings: FloatArray, spots: IntArray) -> tuple[float, float, float]:
    seen = rows["diode_origin"][spots, :2] + np.column_stack([readings[spots], readings[spots + 1]])
    sources = rows["source_origin"][spots, :2]
    along, before = seen[0] - seen[1], sources[0] - sources[1]
    theta = math.atan2(along[1], along[0]) - math.atan2(before[1], before[0])
    theta = math.remainder(theta, 2.0 * math.pi)
    turn = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
    x, y = np.mean(seen - sources @ turn.T, axis=0)
    return float(x), float(y), theta


def _solve_ring(rows: NDArray[np.void], gaps: FloatArray, bumps: int, known_theta: float) -> tuple[float, float, float]:
    # Opposite probes are in phase, the two pairs in quadrature: sums contain theta, differences the runout.
    middle = math.hypot(*rows["tip"][0, :2]) - rows["mean_radius"][0]
    phase = math.atan2(middle - 0.5 * (gaps[1] + gaps[3]), middle - 0.5 * (gaps[0] + gaps[2]))
    theta = known_theta + math.remainder(phase - bumps * known_theta, 2.0 * math.pi) / bumps
    return 0.5 * (gaps[2] - gaps[0]), 0.5 * (gaps[3] - gaps[1]), theta
