# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which causes of wrong readings the redundancy of a layout shows at every theta, and which it cannot.

A cause shifts several readings at once, along the columns D (m, k) of its directions. The residuals of the fit show it
where no combination of them is a change of the pose: with the derivatives J of the readings and their weights W, the
smallest share of chi-square that the residuals keep,

    min_a  a' D' M D a / a' D' W D a,   M = W - W J (J' W J)^-1 J' W,

is above UNOBSERVED at every theta (Baarda 1968, for several parameters).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.designs import STANDOFF
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.native_coordinates import rotation_from_native
from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration
from scipy.linalg import eigh

from posor_design.requirement import LEAST_TARGET_TILT

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

UNOBSERVED = 1e-3  # share of chi-square below which a cause of thirty standard deviations passes the test
JUDGED = ("reading", "light spot", "growth of gaps", "wedge of gaps")
"""Causes whose hypotheses are judged, at any bound but zero."""
THETAS = 240  # within a period of the ring, so that phases of 1 % of it are met


def unobservable_causes(calibration: Calibration, gap: float = STANDOFF, rotation: float = math.pi) -> tuple[str, ...]:
    """Return the names of the causes that no reading shows, at some theta within ``rotation`` [rad].

    ``gap``: in the middle of the range [m].
    """
    posor = Posor(calibration)
    stack = posor.stack
    thetas = np.linspace(0.0, min(_period(calibration), rotation), THETAS, endpoint=False)
    rotations = np.array([rotation_from_native(0.0, 0.0, theta) for theta in thetas])
    translations = np.tile([0.0, 0.0, gap], (THETAS, 1))
    readings = stack.linearise(scans_at(stack, rotations, translations, np.arange(THETAS, dtype=np.int64)))
    shares: dict[str, float] = {}
    for n in range(THETAS):
        jacobian = stack.evaluate(readings.selected[n], rotations[n], translations[n])[1]
        weights = 1.0 / readings.variances[n]
        weighted = weights[:, None] * jacobian
        seen = np.diag(weights) - weighted @ np.linalg.solve(jacobian.T @ weighted, weighted.T)
        for name, directions in _directions(posor, readings.values[n]).items():
            whole = directions.T @ (weights[:, None] * directions)
            share = float(eigh(directions.T @ seen @ directions, whole, eigvals_only=True)[0])
            shares[name] = min(share, shares.get(name, math.inf))
    found = [name for name, share in shares.items() if share < UNOBSERVED]
    for sensor in calibration.sensors:
        if isinstance(sensor, GapProbesCalibration):
            tilt = math.hypot(*sensor.target_plane.tilt.array)
            found += ["gain of the converter"] if sensor.reference is None else []
            found += ["exchanged plugs of gap probes"] if tilt < LEAST_TARGET_TILT else []
    return tuple(found)


def _period(calibration: Calibration) -> float:
    """Return the angle after which the ring of a calibration repeats, nearly for light sources [rad]."""
    for sensor in calibration.sensors:
        if isinstance(sensor, BumpyRingCalibration):
            return sensor.bump_angle
        if isinstance(sensor, DiodesCalibration) and len(sensor.light_sources) > len(sensor.diodes):
            return 4.0 * math.pi / len(sensor.light_sources)
    return math.pi


def _directions(posor: Posor, values: FloatArray) -> dict[str, FloatArray]:
    """Return the directions (m, k) of each judged hypothesis, by its name; ``values``: the readings (m,) [m]."""
    hypotheses = posor.hypotheses
    found: dict[str, list[FloatArray]] = {}
    for name, number, entries in zip(
        hypotheses.names, hypotheses.of_columns, hypotheses.model.coefficients, strict=True
    ):
        if hypotheses.causes[number].name in JUDGED:
            found.setdefault(name, []).append(entries)
    directions = {name: np.column_stack(columns) for name, columns in found.items()}
    for sensor, first in zip(posor.calibration.sensors, posor.stack.first_readings, strict=True):
        if isinstance(sensor, DiodesCalibration) and sensor.ambient is None:
            spots = np.zeros((len(values), 1))
            spots[first : first + 2 * len(sensor.diodes), 0] = values[first : first + 2 * len(sensor.diodes)]
            directions["ambient light"] = spots  # it draws all spots towards the middles of the diodes
    return directions
