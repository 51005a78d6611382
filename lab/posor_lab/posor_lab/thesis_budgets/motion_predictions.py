# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors that section 8.4 predicts for the motion tests: the budgets of chapter 7 over the travels of table 8.1.

Lengths are in inch and angles in rad, as in the other budgets of the thesis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

from posor_lab.thesis_budgets.budget_tables import DIODE_TOTAL, PROBE_FILE, computed_cell
from posor_lab.thesis_budgets.chapter5 import LEG_X, LEVERS, Chapter5, Slopes, root_sum_square
from posor_lab.thesis_data import URAD, data_path, read_numbers

if TYPE_CHECKING:
    from collections.abc import Mapping

RANGES_FILE = "sensor_ranges.csv"
DIMENSIONS_FILE = "posor_dimensions.csv"

STAGE_STRAIGHTNESS = 0.0004
"""Standard deviation of the straightness of the stage that calibrated the diodes, section 8.4 [inch]."""
PEAK_TO_VALLEY = 0.025
"""Travel across a diode over which a linearisation follows this error from peak to valley, section 8.4 [inch]."""
CURVE_PEAK = 0.00041  # peak of a linearisation curve by this error, section 8.4.4 [inch]
DIODE_RANGE = 0.5  # travel across a diode over which the total of table 7.9 holds, section 8.4 [inch]
READOUT = 0.0002  # accuracy of the machining centre along any axis, section 8.2 [inch]
READING_DISTANCE = 3.5  # distance of the two readings that give alpha, section 8.2 [inch]
BEARING_RUNOUT, BEARING_DISTANCE = 50e-6, 3.0  # bearings of the twist stage, section 8.2 [inch]

MotionName = Literal["ZMO", "YMO", "YZMO", "TWIS", "GEN"]


@dataclass(frozen=True)
class SensorTravel:
    """Travel of the sensors in one motion test, table 8.1 [inch]."""

    spots_x: tuple[float, float]  # of the light spots along X of diodes 1 and 2, from start to finish, signed
    spots_y: tuple[float, float]  # the same along Y
    probes: tuple[float, float, float]  # change of the gaps of probes 1 to 3, without its sign

    @property
    def mean_x(self) -> float:
        """Mean travel along X of a diode."""
        return (abs(self.spots_x[0]) + abs(self.spots_x[1])) / 2.0

    @property
    def mean_distance(self) -> float:
        """Mean distance that a spot travels across its diode."""
        return sum(math.hypot(x, y) for x, y in zip(self.spots_x, self.spots_y, strict=True)) / 2.0

    @property
    def slopes(self) -> Slopes:
        """Change of the plate's inclination, if all gaps change in the same sense."""
        one, two, three = self.probes
        return Slopes(across=three - two, along=one - (two + three) / 2.0)


def sensor_travel(test: MotionName) -> SensorTravel:
    """Return the travel of the sensors in a test.

    Raises DataFileError: table 8.1 cannot be read, or has an invalid number.
    """
    x1, y1, x2, y2 = (end - start for start, end in zip(spots_at(test, "start"), spots_at(test, "finish"), strict=True))
    one, two, three = (_sensor_cells(test)[f"probe{k}_range_in"] for k in (1, 2, 3))
    return SensorTravel((x1, x2), (y1, y2), (one, two, three))


def spots_at(test: MotionName, moment: Literal["start", "finish"]) -> tuple[float, float, float, float]:
    """Return X1, Y1, X2, Y2 of the light spots on their diodes at the start or the finish of a test [inch].

    Raises DataFileError: table 8.1 cannot be read, or has an invalid number.
    """
    cells = _sensor_cells(test)
    x1, y1, x2, y2 = (cells[f"{axis}d{k}_{moment}_in"] for k in (1, 2) for axis in "xy")
    return x1, y1, x2, y2


@cache
def _sensor_cells(test: MotionName) -> Mapping[str, float]:
    """Return the column of a test in table 8.1."""
    return read_numbers(data_path(RANGES_FILE), "quantity", test)


@cache
def dimensions() -> Mapping[str, float]:
    """Return the dimensions of POSOR and tests by name (inch, radian).

    Raises DataFileError: the table cannot be read, or has an invalid number.
    """
    return read_numbers(data_path(DIMENSIONS_FILE), "quantity", "value")


@dataclass(frozen=True)
class ProbePrediction:
    """Errors of alpha and beta by the impedance probes that increase with the motion [rad]."""

    alpha: float
    beta: float

    @property
    def y(self) -> float:
        """Of the end of the beam along Y: beta with its lever [inch]."""
        return self.beta * dimensions()["lever_endpoint"]


def increasing_errors(slopes: Slopes) -> ProbePrediction:
    """Return the errors by the uncertain spacings a, b, c of the probes at a change of inclination (5.21 to 5.25).

    Raises DataFileError: table 7.12 cannot be read.
    """
    model = Chapter5(slopes)
    sigmas = read_numbers(data_path(PROBE_FILE), "perturbation", "value", LEVERS)

    def total(output: str) -> float:
        return root_sum_square(
            *(model.parameter_sensitivity(output, lever) * sigmas[name] for name, (lever, _) in LEVERS.items())
        )

    return ProbePrediction(total("alpha"), total("beta"))


@cache
def probe_budget(kind: Literal["increasing", "random"], angle: Literal["alpha", "beta"]) -> float:
    """Return the total of table 7.12 for an angle [rad], by the model."""
    row = "increasing: root mean square (section 8.4)" if kind == "increasing" else "random: root mean square"
    return computed_cell("7.12", row, f"sigma_{angle}_urad") * URAD


@cache
def diode_budget(column: Literal["induced_sigma_X_uin", "induced_sigma_Y_uin", "induced_sigma_theta_urad"]) -> float:
    """Return a total of table 7.9 [inch or rad], by the model."""
    return computed_cell("7.9", DIODE_TOTAL, column) * 1e-6


def straightness_error(travel: float = PEAK_TO_VALLEY, straightness: float = STAGE_STRAIGHTNESS) -> float:
    """Return the error of theta by the straightness of the calibration stage [rad], section 8.4.

    Both diodes contribute, 3 in apart; the error goes with the travel of the spots along X of a diode [inch].
    """
    return root_sum_square(straightness, straightness) / LEG_X * travel / PEAK_TO_VALLEY


def diode_error(distance: float) -> float:
    """Return the error of theta by the terms of table 7.9 [rad] for a distance across the diodes [inch]."""
    return diode_budget("induced_sigma_theta_urad") * distance / DIODE_RANGE


def machining_centre_alpha() -> float:
    """Return the error of alpha by the machining centre [rad], section 8.2."""
    return root_sum_square(READOUT, READOUT) / READING_DISTANCE


def twist_stage_alpha() -> float:
    """Return the error of alpha by the bearings of the twist stage [rad], section 8.2."""
    return BEARING_RUNOUT / BEARING_DISTANCE


def random_alpha() -> float:
    """Return the random error of alpha in TWIS and GEN [rad]: POSOR, machining centre and twist stage."""
    return root_sum_square(probe_budget("random", "alpha"), machining_centre_alpha(), twist_stage_alpha())
