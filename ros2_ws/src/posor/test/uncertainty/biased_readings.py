# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Scans with errors of single linearised readings, from POSORs with drawn calibration errors."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from posor.estimation.forward import empty_scans
from posor.estimation.posor import Posor
from posor.estimation.sensor_stack import Stack
from posor.model.reading_rows import evaluate_poses
from posor.model.scan import Scans
from posor.numerics.array_types import FloatArray
from posor.sensors.base import RowSensor


def drawn_stack(posor: Posor, random: np.random.Generator) -> Stack:
    """Return the sensors with calibration errors as the calibration states them."""
    root = posor.parameter_square_root
    return posor.stack.with_parameter_values(posor.stack.parameter_values + root @ random.normal(size=root.shape[1]))


def biased_scans(stack: Stack, pose: pin.SE3, biases: FloatArray, noise: np.random.Generator | None = None) -> Scans:
    """Return one scan at a pose whose linearised readings are wrong by ``biases`` (m,) [m]."""
    rotations, translations = pose.rotation[None], pose.translation[None]
    scans, done = empty_scans(np.ones(1, dtype=np.int64)), 0
    for sensor in stack.sensors:
        assert isinstance(sensor, RowSensor)
        selected, fields = sensor.rows_at(rotations, translations)
        readings = evaluate_poses(sensor.rows, selected, rotations, translations)
        own = biases[done : done + readings.shape[1]]
        done += len(own)
        scans = scans.with_fields(fields)
        scans = scans.with_fields(sensor.encode(readings + own, scans))
        if noise is not None:
            scans = scans.with_fields(sensor.disturbed(scans, noise))
    return scans
