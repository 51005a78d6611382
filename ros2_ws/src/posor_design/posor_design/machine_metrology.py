"""Errors of stages, machines and setups: straightness, alignment, Abbe offset, thermal growth, zero of a probe."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.polynomial import polynomial

from posor_design.calculators import calculator, require_as_many
from posor_design.line_fit import fit_line

if TYPE_CHECKING:
    from posor_design.units import (
        NON_NEGATIVE,
        NON_ZERO,
        POSITIVE,
        SMALL_ANGLE,
        Kelvin,
        Metre,
        MetrePerVolt,
        Number,
        PerKelvin,
        Radian,
        Volt,
        at_least,
    )


@dataclass(frozen=True)
class Straightness:
    """Straightness of a motion."""

    intercept: Annotated[Metre, "Intercept of the least squares line."]
    slope: Annotated[
        Number, "Slope of this line: the angle between the motion and the axis of the straightness optics."
    ]
    deviation: Annotated[Metre, "Standard deviation of the readings from this line."]
    least_squares: Annotated[Metre, "Straightness: largest less least deviation from this line."]
    minimum_zone: Annotated[Metre, "Straightness: width of the narrowest band with all readings."]


@calculator
def straightness(
    positions: Annotated[tuple[Metre, ...], "Positions along the motion."],
    readings: Annotated[tuple[Metre, ...], "Reading across the motion at each position."],
) -> Straightness:
    """Straightness of a motion from readings across it; a line takes the misalignment of the optics away.

    Source: thesis 7.2, figure 7.3 and table 7.1 (least squares line); ISO 230-1:2012, straightness (minimum zone).

    Example:
        posor design straightness --positions '0, .25, .5, .75 in' --readings '-.3, 3, 5.8, 9.2 mil'

    """
    line = fit_line(positions, readings, "positions", "readings")
    return Straightness(line.intercept, line.slope, line.standard_deviation, line.peak_to_valley, line.band)


@dataclass(frozen=True)
class StraightnessRuns:
    """Repeated runs of a straightness measurement."""

    mean_deviation: Annotated[Metre, "Mean of the deviations."]
    deviation_scatter: Annotated[Metre, "Standard deviation of the deviations from run to run."]
    mean_slope: Annotated[Number, "Mean slope of the lines."]
    spread: Annotated[Metre, "Largest distance between the lines of two runs, over the travel."]


@calculator
def straightness_runs(
    intercepts: Annotated[tuple[Metre, ...], at_least(2), "Intercept of the line of each run."],
    slopes: Annotated[tuple[Number, ...], "Slope of the line of each run."],
    deviations: Annotated[tuple[Metre, ...], NON_NEGATIVE, "Deviation of each run from its line."],
    travel: Annotated[Metre, POSITIVE, "Travel from position 0."],
) -> StraightnessRuns:
    """Mean and repeatability of runs of a straightness measurement, each with its line and its deviation.

    Source: thesis 7.2, table 7.1.

    Example:
        posor design straightness-runs --intercepts '-322, -213 uin' --slopes '.012730, .012335' --deviations
        '410, 416 uin' --travel '.75 in'

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

    angle: Annotated[Radian, "Root sum square of the misalignments."]
    cosine_error: Annotated[Metre, "Travel less its component along the measured axis."]
    lateral_error: Annotated[
        Metre, "Component of the travel across the measured axis: the error of squareness or parallelism."
    ]


@calculator
def alignment(
    misalignments: Annotated[
        tuple[Radian, ...],
        SMALL_ANGLE,
        at_least(1),
        "Independent misalignments, such as stage to machine, optics to machine, sensor to stage.",
    ],
    travel: Annotated[Metre, NON_NEGATIVE, "Travel along the axis."],
) -> Alignment:
    """Cosine error and lateral error of axes that are not parallel, or not square, to each other.

    Source: thesis 7.2 and 7.4 (root sum square, cosine error and orthogonality of the axes).

    Example:
        posor design alignment --misalignments '1, 2, 5 mrad' --travel '.625 in'

    """
    angle = math.hypot(*misalignments)
    return Alignment(angle, 2.0 * travel * math.sin(0.5 * angle) ** 2, travel * math.sin(angle))


@dataclass(frozen=True)
class AbbeError:
    """Effect of an Abbe offset."""

    error: Annotated[Metre, "Displacement of the point of interest less displacement at the axis of measurement."]


@calculator
def abbe_error(
    offset: Annotated[Metre, "Distance across the motion from the axis of measurement to the point of interest."],
    angle: Annotated[Radian, SMALL_ANGLE, "Turn of the carriage: pitch, yaw or roll."],
) -> AbbeError:
    """Error of a displacement that is measured at a distance from the point of interest, while the carriage turns.

    Source: thesis 4.1, 7.4.2 and 7.5.1.

    Example:
        posor design abbe-error --offset '2 in' --angle '5 arcsec'

    """
    return AbbeError(offset * math.sin(angle))


@dataclass(frozen=True)
class ThermalGrowth:
    """Growth of a part."""

    growth: Annotated[Metre, "Change of its length."]


@calculator
def thermal_growth(
    length: Annotated[Metre, NON_NEGATIVE, "Length of the part."],
    expansion: Annotated[PerKelvin, "Coefficient of thermal expansion of its material."],
    temperature_change: Annotated[Kelvin, "Change of its temperature."],
) -> ThermalGrowth:
    """Growth of a part of a machine that lies between reference and sensor.

    Source: thesis 7.2 and 7.4.1.

    Example:
        posor design thermal-growth --length '10 in' --expansion '10.8 ppm/K' --temperature-change '.056 K'

    """
    return ThermalGrowth(length * expansion * temperature_change)


@dataclass(frozen=True)
class ProbeZero:
    """Effect of a zero of a probe that is known with an error."""

    zero_error: Annotated[Volt, "Error of the zero as a voltage."]
    motion: Annotated[Metre, "Motion between the two voltages, by the polynomial."]
    motion_error: Annotated[Metre, "Error of this motion: the polynomial is entered at shifted voltages."]


@calculator
def probe_zero(
    coefficients: Annotated[
        tuple[Number, ...], at_least(1), "Gap in metres over voltage in volts, from the constant to the highest power."
    ],
    start: Annotated[Volt, "Voltage at the start of the motion."],
    finish: Annotated[Volt, "Voltage at its end."],
    gauge_error: Annotated[Metre, "Error of the gap that the gauge blocks set."],
    gain: Annotated[MetrePerVolt, NON_ZERO, "Gap over voltage of the probe, by which this error becomes a voltage."],
) -> ProbeZero:
    """Error of a motion whose probe was set to zero by gauge blocks.

    A wrong zero shifts both voltages. A straight line would show the same motion; a curve does not.

    Source: thesis 8.3.1, with equation 5.2.

    Example:
        posor design probe-zero --coefficients '-1.554e-4, -1.3662e-3, -3.446e-5, -3.1752e-4, 1.0216e-4' --start '.1 V'
        --finish '.8 V' --gauge-error '.001 in' --gain '.05 in/V'

    """
    zero_error = gauge_error / gain

    def motion(shift: float) -> float:
        gaps = polynomial.polyval(np.array([start, finish]) + shift, coefficients)
        return float(gaps[1] - gaps[0])

    return ProbeZero(zero_error, motion(0.0), motion(zero_error) - motion(0.0))
