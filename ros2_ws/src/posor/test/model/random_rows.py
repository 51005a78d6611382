# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Random parameters of reading rows, each with a pose at which the row reads a number."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from posor.model.gap import plane_normal
from posor.numerics.array_types import FloatArray
from scipy.spatial.transform import Rotation


def random_gap(rng: np.random.Generator) -> tuple[FloatArray, pin.SE3]:
    """Return a gap probe and a pose, anywhere in space; the axis meets the plane at 60 degrees or less."""
    pose = pin.SE3(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.1, 0.1, 3))
    tilt = rng.uniform(-1.2, 1.2, 2)
    turn = rng.uniform(-math.pi, math.pi)
    across = rng.normal(size=3)
    axis = -(pose.rotation @ np.array(plane_normal(tilt[0], tilt[1], turn))) + across / np.linalg.norm(across) * 0.8
    axis *= rng.uniform(0.5, 2.0) / np.linalg.norm(axis)
    return np.concatenate([rng.uniform(-0.1, 0.1, 3), axis, rng.uniform(-0.1, 0.1, 3), tilt, [turn]]), pose


def random_ring_gap(rng: np.random.Generator) -> tuple[FloatArray, pin.SE3]:
    """Return a probe that looks at a ring of 36 bumps, anywhere around it, and a pose."""
    lean = np.array([*rng.uniform(-0.05, 0.05, 2), 0.0])
    turn = pin.utils.rotate("z", rng.uniform(-math.pi, math.pi))
    pose = pin.SE3(pin.exp3(lean) @ turn, rng.uniform(-5e-4, 5e-4, 3))
    around = rng.uniform(-math.pi, math.pi)
    outward = np.array([math.cos(around), math.sin(around), 0.0])
    axis = -outward + rng.uniform(-0.05, 0.05, 3)
    harmonics = [[k, *rng.uniform(-size, size, 2)] for k, size in ((1, 1e-4), (36, 1e-4), (72, 1e-5))]
    radius = rng.uniform(0.03, 0.06)
    tip = (radius + 1e-3) * outward + [0.0, 0.0, 0.005]
    return np.array([*tip, *(axis / np.linalg.norm(axis)), radius, 3, *np.ravel(harmonics)]), pose


def random_spot(rng: np.random.Generator) -> tuple[FloatArray, pin.SE3]:
    """Return a light spot and a pose, anywhere in space; the ray meets a skewed diode at 60 degrees or less."""
    pose = pin.SE3(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.1, 0.1, 3))
    diode = Rotation.random(random_state=rng).as_matrix()
    u, v = diode[:, 0], diode[:, 1] + rng.uniform(-0.5, 0.5) * diode[:, 0]
    across = rng.normal(size=3)
    ray = pose.rotation.T @ (-diode[:, 2] + across / np.linalg.norm(across) * 0.8)
    origins = rng.uniform(-0.1, 0.1, (2, 3))
    lengths = rng.uniform(0.5, 2.0, 3)
    turn = rng.uniform(-0.3, 0.3)
    return np.concatenate([origins[0], lengths[0] * u, lengths[1] * v, origins[1], lengths[2] * ray, [turn]]), pose
