# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of stages, machines and setups: straightness, alignment, Abbe offset, thermal growth, zero of a probe."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.polynomial import polynomial

from posor_design.calculators import (
    NON_NEGATIVE,
    NON_ZERO,
    POSITIVE,
    SMALL_ANGLE,
    at_least,
    calculator,
    require_as_many,
)
from posor_design.line_fit import fit_line


@dataclass(frozen=True)
class Straightness:
    """Straightness of a motion."""

    intercept: Annotated[float, "m", "Intercept of the least squares line."]
    slope: Annotated[float, "1", "Slope of this line: angle between the motion and the axis of straightness optics."]
    deviation: Annotated[float, "m", "Standard deviation of the readings from this line."]
    least_squares: Annotated[float, "m", "Straightness: largest less least deviation from this line."]
    minimum_zone: Annotated[float, "m", "Straightness: width of the narrowest band with all readings."]


@calculator
def straightness(
    positions: Annotated[tuple[float, ...], "m", at_least(3), "Positions along the motion."],
    readings: Annotated[tuple[float, ...], "m", "Reading across the motion at each position."],
) -> Straightness:
    """Straightness of a motion from readings across it; a line takes the misalignment of the optics away.

    Source: thesis 7.2, figure 7.3 and table 7.1 (least squares line); ISO 230-1:2012, straightness (minimum zone).
    """
    require_as_many("positions", positions=positions, readings=readings)
    line = fit_line(positions, readings, "positions")
    return Straightness(line.intercept, line.slope, line.standard_deviation, line.peak_to_valley, line.band)


@dataclass(frozen=True)
class StraightnessRuns:
    """Repeated runs of a straightness measurement."""

    mean_deviation: Annotated[float, "m", "Mean of the deviations."]
    deviation_scatter: Annotated[float, "m", "Standard deviation of the deviations from run to run."]
    mean_slope: Annotated[float, "1", "Mean slope of the lines."]
    spread: Annotated[float, "m", "Largest distance between the lines of two runs, over the travel."]


@calculator
def straightness_runs(
    intercepts: Annotated[tuple[float, ...], "m", at_least(2), "Intercept of the line of each run."],
    slopes: Annotated[tuple[float, ...], "1", "Slope of the line of each run."],
    deviations: Annotated[tuple[float, ...], "m", NON_NEGATIVE, "Deviation of each run from its line."],
    travel: Annotated[float, "m", POSITIVE, "Travel from position 0."],
) -> StraightnessRuns:
    """Mean and repeatability of runs of a straightness measurement, each with its line and its deviation.

    Source: thesis 7.2, table 7.1.
    """
    require_as_many("intercepts", intercepts=intercepts, slopes=slopes, deviations=deviations)
    starts, ends = np.array(intercepts), np.array(intercepts) + travel * np.array(slopes)
    return StraightnessRuns(
        mean_deviation=float(np.mean(deviations)),
        deviation_scatter=float(np.std(deviations, ddof=1)),
        mean_slope=float(np.mean(slopes)),
        spread=float(max(np.ptp(starts), np.ptp(ends))),
    )


@dataclass(frozen=True)
class Alignment:
    """Effect of misalignments that add up as independent ones."""

    angle: Annotated[float, "rad", "Root sum square of the misalignments."]
    cosine_error: Annotated[float, "m", "Travel less its component along the measured axis."]
    lateral_error: Annotated[float, "m", "Travel across the measured axis: error of squareness or parallelism."]


@calculator
def alignment(
    misalignments: Annotated[
        tuple[float, ...],
        "rad",
        SMALL_ANGLE,
        at_least(1),
        "Independent misalignments, such as stage to machine, optics to machine, sensor to stage.",
    ],
    travel: Annotated[float, "m", NON_NEGATIVE, "Travel along the axis."],
) -> Alignment:
    """Cosine error and lateral error of axes that are not parallel, or not square, to each other.

    Source: thesis 7.2 and 7.4 (root sum square, cosine error and orthogonality of the axes).
    """
    angle = math.hypot(*misalignments)
    return Alignment(angle, 2.0 * travel * math.sin(0.5 * angle) ** 2, travel * math.sin(angle))


@dataclass(frozen=True)
class AbbeError:
    """Effect of an Abbe offset."""

    error: Annotated[float, "m", "Displacement of the point of interest less displacement at the axis of measurement."]


@calculator
def abbe_error(
    offset: Annotated[float, "m", "Distance across the motion from the axis of measurement to the point of interest."],
    angle: Annotated[float, "rad", SMALL_ANGLE, "Turn of the carriage: pitch, yaw or roll."],
) -> AbbeError:
    """Error of a displacement that is measured at a distance from the point of interest, while the carriage turns.

    Source: thesis 4.1, 7.4.2 and 7.5.1.
    """
    return AbbeError(offset * math.sin(angle))


@dataclass(frozen=True)
class ThermalGrowth:
    """Growth of a part."""

    growth: Annotated[float, "m", "Change of its length."]


@calculator
def thermal_growth(
    length: Annotated[float, "m", NON_NEGATIVE, "Length of the part."],
    expansion: Annotated[float, "1/K", "Coefficient of thermal expansion of its material."],
    temperature_change: Annotated[float, "K", "Change of its temperature."],
) -> ThermalGrowth:
    """Growth of a part of a machine that lies between reference and sensor.

    Source: thesis 7.2 and 7.4.1.
    """
    return ThermalGrowth(length * expansion * temperature_change)


@dataclass(frozen=True)
class ProbeZero:
    """Effect of a zero of a probe that is known with an error."""

    zero_error: Annotated[float, "V", "Error of the zero as a voltage."]
    motion: Annotated[float, "m", "Motion between the two voltages, by the polynomial."]
    motion_error: Annotated[float, "m", "Error of this motion: the polynomial is entered at shifted voltages."]


@calculator
def probe_zero(
    coefficients: Annotated[tuple[float, ...], "1", at_least(1), "Gap [m] over voltage [V], constant term first."],
    start: Annotated[float, "V", "Voltage at the start of the motion."],
    finish: Annotated[float, "V", "Voltage at its end."],
    gauge_error: Annotated[float, "m", "Error of the gap that the gauge blocks set."],
    gain: Annotated[float, "m/V", NON_ZERO, "Gap over voltage of the probe, by which this error becomes a voltage."],
) -> ProbeZero:
    """Error of a motion whose probe was set to zero by gauge blocks.

    A wrong zero shifts both voltages. A straight line would show the same motion; a curve does not.

    Source: thesis 8.3.1, with equation 5.2.
    """
    zero_error = gauge_error / gain

    def motion(shift: float) -> float:
        gaps = polynomial.polyval(np.array([start, finish]) + shift, coefficients)
        return float(gaps[1] - gaps[0])

    return ProbeZero(zero_error, motion(0.0), motion(zero_error) - motion(0.0))
