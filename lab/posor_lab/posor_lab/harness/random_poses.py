# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Random poses over the range of a design that all sensors can read."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.designs import THETA_OF_TWO_SOURCES, DesignName
from posor.estimation.forward import scans_at
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import STATED_HOME
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from collections.abc import Iterable

    from posor.estimation.posor import Posor
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray

STACKS: tuple[DesignName, ...] = ("triad_diodes", "triad_light_ring", "triad_bumpy_ring", "quad_light_ring")
"""The designs that tests go through: each sensor for theta, and a fourth gap probe."""

LEAN = 0.01
GAPS = (0.1e-3, 1.3e-3)
TICK_NS = 1_000_000
_RUNOUT, _RUNOUT_OF_BUMPY_RING = 1e-3, 0.3e-3


def draw_poses(stack: DesignName, count: int, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw poses uniformly over the full range: R_R_T (n, 3, 3) and the origin of T in R (n, 3) [m]."""
    leans = random.uniform(-LEAN, LEAN, (count, 2))
    largest_theta = THETA_OF_TWO_SOURCES if stack.endswith("_diodes") else math.pi
    runout = _RUNOUT_OF_BUMPY_RING if stack.endswith("_bumpy_ring") else _RUNOUT
    thetas = random.uniform(-largest_theta, largest_theta, count)
    across = random.uniform(-runout, runout, (count, 2))
    along = random.uniform(*GAPS, count)
    rotations = np.array([rotation_from_native(a, b, t) for (a, b), t in zip(leans, thetas, strict=True)])
    return rotations, np.column_stack([across, along])


def readable(scans: Scans) -> BoolArray:
    """Return which scans have every reading, (n,): in the others a probe touches the target or loses it."""
    return np.asarray(
        np.isfinite(scans.gap_voltages).all(axis=1)
        & np.isfinite(scans.ring_voltages).all(axis=1)
        & np.isfinite(scans.diode_currents).all(axis=(1, 2))
    )


def readable_poses(
    posor: Posor, stack: DesignName, count: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Draw poses as ``draw_poses`` does until ``count`` of them can be read by every sensor."""
    rotations, translations = np.empty((0, 3, 3)), np.empty((0, 3))
    while len(rotations) < count:
        more_rotations, more_translations = draw_poses(stack, count, random)
        scans = scans_at(posor.stack, more_rotations, more_translations, np.arange(count, dtype=np.int64))
        good = readable(scans)
        rotations = np.concatenate([rotations, more_rotations[good]])
        translations = np.concatenate([translations, more_translations[good]])
    return rotations[:count], translations[:count]


def turning_scans(
    posor: Posor, thetas: FloatArray, seed: int | None = None, *, home: Iterable[int] = (), marks: Iterable[int] = ()
) -> Scans:
    """Return scans at 1 kHz of an inclined target that turns off the axis, with noise if there is a seed.

    ``home``: scans that are stated to be at home. ``marks``: scans that see the home mark. The scans can be changed.
    """
    rotations = np.array([rotation_from_native(1e-4, -2e-4, theta) for theta in thetas])
    translations = np.tile([2e-5, 1e-5, 0.7e-3], (len(thetas), 1))
    stamps = np.arange(1, len(thetas) + 1, dtype=np.int64) * TICK_NS
    noise = None if seed is None else np.random.default_rng(seed)
    scans = scans_at(posor.stack, rotations, translations, stamps, noise=noise).editable()
    scans.at_home[list(home)], scans.at_home[list(marks)] = STATED_HOME, 1
    return scans


def errors_in_parent(
    rotations: FloatArray, translations: FloatArray, true_rotations: FloatArray, true_translations: FloatArray
) -> FloatArray:
    """Return the errors of poses in ROS order, shape (n, 6): x, y, z [m], small turn about X, Y, Z of R [rad]."""
    turns = Rotation.from_matrix(rotations @ np.swapaxes(true_rotations, 1, 2)).as_rotvec()
    return np.column_stack([translations - true_translations, turns])
