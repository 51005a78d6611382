"""Random poses over the range of a design, and what they are read as."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.designs import THETA_OF_TWO_SOURCES, DesignName
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import native_from_rotation, rotation_from_native

if TYPE_CHECKING:
    from posor_estimator.core.posor import Posor
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import FloatArray

STACKS: tuple[DesignName, ...] = ("triad_diodes", "triad_light_ring", "triad_bumpy_ring")

LEAN = 0.01
GAPS = (0.1e-3, 1.3e-3)
TICK_NS = 1_000_000
_RUNOUT: dict[DesignName, float] = {"triad_diodes": 1e-3, "triad_light_ring": 1e-3, "triad_bumpy_ring": 0.3e-3}
_THETA: dict[DesignName, float] = {
    "triad_diodes": THETA_OF_TWO_SOURCES,
    "triad_light_ring": math.pi,
    "triad_bumpy_ring": math.pi,
}


def draw_poses(stack: DesignName, count: int, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw poses uniformly over the full range: R_R_T (n, 3, 3) and the origin of T in R (n, 3) [m]."""
    leans = random.uniform(-LEAN, LEAN, (count, 2))
    thetas = random.uniform(-_THETA[stack], _THETA[stack], count)
    across = random.uniform(-_RUNOUT[stack], _RUNOUT[stack], (count, 2))
    along = random.uniform(*GAPS, count)
    rotations = np.array([rotation_from_native(a, b, t) for (a, b), t in zip(leans, thetas, strict=True)])
    return rotations, np.column_stack([across, along])


def readable(scans: Scans) -> FloatArray:
    """Return which scans have every reading: the others have a probe that would touch the target or lose it."""
    return np.asarray(
        np.isfinite(scans.gap_voltages).all(axis=1)
        & np.isfinite(scans.ring_voltages).all(axis=1)
        & np.isfinite(scans.diode_currents).all(axis=(1, 2))
    )


def readable_poses(
    posor: Posor, stack: DesignName, count: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Draw poses as ``draw_poses`` does, again and again until ``count`` of them can be read by every sensor."""
    rotations, translations = np.empty((0, 3, 3)), np.empty((0, 3))
    while len(rotations) < count:
        more_rotations, more_translations = draw_poses(stack, count, random)
        scans = scans_at(posor.stack, more_rotations, more_translations, np.arange(count, dtype=np.int64))
        good = readable(scans)
        rotations = np.concatenate([rotations, more_rotations[good]])
        translations = np.concatenate([translations, more_translations[good]])
    return rotations[:count], translations[:count]


def thetas_of(rotations: FloatArray) -> FloatArray:
    """Return theta [rad] of each rotation, shape (n,)."""
    return np.array([native_from_rotation(rotation)[2] for rotation in rotations])


def count_known(posor: Posor, rotations: FloatArray) -> FloatArray | None:
    """Return theta rounded to a whole bump [rad], shape (n,), for a POSOR that counts; None for any other."""
    bumps = [sensor.bump_angle for sensor in posor.calibration.sensors if sensor.bump_angle > 0.0]
    if not bumps:
        return None
    thetas = thetas_of(rotations)
    return np.asarray(bumps[0] * np.round(thetas / bumps[0]))


def errors_in_parent(
    rotations: FloatArray, translations: FloatArray, true_rotations: FloatArray, true_translations: FloatArray
) -> FloatArray:
    """Return the errors of poses in ROS order, shape (n, 6): x, y, z [m], small turn about X, Y, Z of R [rad]."""
    turns = [pin.log3(r @ t.T) for r, t in zip(rotations, true_rotations, strict=True)]
    return np.column_stack([translations - true_translations, np.array(turns)])
