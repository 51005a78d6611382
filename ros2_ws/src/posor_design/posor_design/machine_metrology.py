"""Errors of stages, machines and setups: straightness, alignment, Abbe offset, thermal growth, zero of a probe."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import polynomial
from posor.errors import ParameterError

from posor_design.checks import require_finite, require_non_negative, require_positive, require_small_angle
from posor_design.line_fit import fit_line

if TYPE_CHECKING:
    from posor_design.units import Kelvin, Metre, MetrePerVolt, Number, PerKelvin, Radian, Volt


@dataclass(frozen=True)
class Straightness:
    """Straightness of a motion.

    Attributes:
        intercept: Intercept of the least squares line.
        slope: Slope of this line: the angle between the motion and the axis of the straightness optics.
        deviation: Standard deviation of the readings from this line.
        least_squares: Straightness: largest less least deviation from this line.
        minimum_zone: Straightness: width of the narrowest band with all readings.

    """

    intercept: Metre
    slope: Number
    deviation: Metre
    least_squares: Metre
    minimum_zone: Metre


def straightness(positions: tuple[Metre, ...], readings: tuple[Metre, ...]) -> Straightness:
    """Straightness of a motion from readings across it; a line takes the misalignment of the optics away.

    Args:
        positions: Positions along the motion.
        readings: Reading across the motion at each position.

    Raises:
        ParameterError: There are fewer than three positions, not as many readings, one is not finite, or all positions
            are equal.

    Source: thesis 7.2, figure 7.3 and table 7.1 (least squares line); ISO 230-1:2012, straightness (minimum zone).

    Example:
        posor design straightness --positions '0, .25, .5, .75 in' --readings '-.3, 3, 5.8, 9.2 mil'

    """
    line = fit_line(positions, readings, "positions", "readings")
    return Straightness(line.intercept, line.slope, line.standard_deviation, line.peak_to_valley, line.band)


@dataclass(frozen=True)
class StraightnessRuns:
    """Repeated runs of a straightness measurement.

    Attributes:
        mean_deviation: Mean of the deviations.
        deviation_scatter: Standard deviation of the deviations from run to run.
        mean_slope: Mean slope of the lines.
        spread: Largest distance between the lines of two runs, over the travel.

    """

    mean_deviation: Metre
    deviation_scatter: Metre
    mean_slope: Number
    spread: Metre


def straightness_runs(
    intercepts: tuple[Metre, ...], slopes: tuple[Number, ...], deviations: tuple[Metre, ...], travel: Metre
) -> StraightnessRuns:
    """Mean and repeatability of runs of a straightness measurement, each with its line and its deviation.

    Args:
        intercepts: Intercept of the line of each run.
        slopes: Slope of the line of each run.
        deviations: Deviation of each run from its line.
        travel: Travel from position 0.

    Raises:
        ParameterError: There are fewer than two runs, a run is incomplete, or an argument is not finite or out of
            range.

    Source: thesis 7.2, table 7.1.

    Example:
        posor design straightness-runs --intercepts '-322, -213 uin' --slopes '.012730, .012335' --deviations
        '410, 416 uin' --travel '.75 in'

    """
    require_positive(travel=travel)
    if len(intercepts) < 2:  # noqa: PLR2004
        raise ParameterError(f"{len(intercepts)} run", where="intercepts", expected="at least 2 runs")
    for name, values in (("slopes", slopes), ("deviations", deviations)):
        if len(values) != len(intercepts):
            raise ParameterError(f"{len(values)} values", where=name, expected=f"{len(intercepts)}, one for each run")
    for number, (intercept, slope, deviation) in enumerate(zip(intercepts, slopes, deviations, strict=True), start=1):
        require_finite(**{f"intercept of run {number}": intercept, f"slope of run {number}": slope})
        require_non_negative(**{f"deviation of run {number}": deviation})
    starts, ends = np.array(intercepts), np.array(intercepts) + travel * np.array(slopes)
    return StraightnessRuns(
        mean_deviation=float(np.mean(deviations)),
        deviation_scatter=float(np.std(deviations, ddof=1)),
        mean_slope=float(np.mean(slopes)),
        spread=float(max(np.ptp(starts), np.ptp(ends))),
    )


@dataclass(frozen=True)
class Alignment:
    """Effect of misalignments that add up as independent ones.

    Attributes:
        angle: Root sum square of the misalignments.
        cosine_error: Travel less its component along the measured axis.
        lateral_error: Component of the travel across the measured axis: the error of squareness or parallelism.

    """

    angle: Radian
    cosine_error: Metre
    lateral_error: Metre


def alignment(misalignments: tuple[Radian, ...], travel: Metre) -> Alignment:
    """Cosine error and lateral error of axes that are not parallel, or not square, to each other.

    Args:
        misalignments: Independent misalignments, such as stage to machine, optics to machine, sensor to stage.
        travel: Travel along the axis.

    Raises:
        ParameterError: There is no misalignment, an argument is not finite, an angle exceeds 0.2 rad, or the travel is
            negative.

    Source: thesis 7.2 and 7.4 (root sum square, cosine error and orthogonality of the axes).

    Example:
        posor design alignment --misalignments '1, 2, 5 mrad' --travel '.625 in'

    """
    require_non_negative(travel=travel)
    if not misalignments:
        raise ParameterError("no angle", where="misalignments", expected="at least one")
    require_small_angle(**{f"misalignment {number}": angle for number, angle in enumerate(misalignments, start=1)})
    angle = math.hypot(*misalignments)
    return Alignment(angle, 2.0 * travel * math.sin(0.5 * angle) ** 2, travel * math.sin(angle))


@dataclass(frozen=True)
class AbbeError:
    """Effect of an Abbe offset.

    Attributes:
        error: Displacement of the point of interest less displacement at the axis of measurement.

    """

    error: Metre


def abbe_error(offset: Metre, angle: Radian) -> AbbeError:
    """Error of a displacement that is measured at a distance from the point of interest, while the carriage turns.

    Args:
        offset: Distance across the motion from the axis of measurement to the point of interest.
        angle: Turn of the carriage: pitch, yaw or roll.

    Raises:
        ParameterError: An argument is not finite, or the angle exceeds 0.2 rad.

    Source: thesis 4.1, 7.4.2 and 7.5.1.

    Example:
        posor design abbe-error --offset '2 in' --angle '5 arcsec'

    """
    require_finite(offset=offset)
    require_small_angle(angle=angle)
    return AbbeError(offset * math.sin(angle))


@dataclass(frozen=True)
class ThermalGrowth:
    """Growth of a part.

    Attributes:
        growth: Change of its length.

    """

    growth: Metre


def thermal_growth(length: Metre, expansion: PerKelvin, temperature_change: Kelvin) -> ThermalGrowth:
    """Growth of a part of a machine that lies between reference and sensor.

    Args:
        length: Length of the part.
        expansion: Coefficient of thermal expansion of its material.
        temperature_change: Change of its temperature.

    Raises:
        ParameterError: An argument is not finite, or the length is negative.

    Source: thesis 7.2 and 7.4.1.

    Example:
        posor design thermal-growth --length '10 in' --expansion '10.8 ppm/K' --temperature-change '.056 K'

    """
    require_non_negative(length=length)
    require_finite(expansion=expansion, temperature_change=temperature_change)
    return ThermalGrowth(length * expansion * temperature_change)


@dataclass(frozen=True)
class ProbeZero:
    """Effect of a zero of a probe that is known with an error.

    Attributes:
        zero_error: Error of the zero as a voltage.
        motion: Motion between the two voltages, by the polynomial.
        motion_error: Error of this motion: the polynomial is entered at shifted voltages.

    """

    zero_error: Volt
    motion: Metre
    motion_error: Metre


def probe_zero(
    coefficients: tuple[Number, ...], start: Volt, finish: Volt, gauge_error: Metre, gain: MetrePerVolt
) -> ProbeZero:
    """Error of a motion whose probe was set to zero by gauge blocks.

    A wrong zero shifts both voltages. A straight line would show the same motion; a curve does not.

    Args:
        coefficients: Gap in metres over voltage in volts, from the constant to the highest power.
        start: Voltage at the start of the motion.
        finish: Voltage at its end.
        gauge_error: Error of the gap that the gauge blocks set.
        gain: Gap over voltage of the probe, by which this error becomes a voltage.

    Raises:
        ParameterError: There are no coefficients, an argument is not finite, or the gain is zero.

    Source: thesis 8.3.1, with equation 5.2.

    Example:
        posor design probe-zero --coefficients '-1.554e-4, -1.3662e-3, -3.446e-5, -3.1752e-4, 1.0216e-4' --start '.1 V'
        --finish '.8 V' --gauge-error '.001 in' --gain '.05 in/V'

    """
    if not coefficients:
        raise ParameterError("no coefficient", where="coefficients", expected="at least one")
    require_finite(**{f"coefficient {power}": value for power, value in enumerate(coefficients)})
    require_finite(start=start, finish=finish, gauge_error=gauge_error)
    require_positive(size_of_the_gain=abs(gain))
    zero_error = gauge_error / gain

    def motion(shift: float) -> float:
        gaps = polynomial.polyval(np.array([start, finish]) + shift, coefficients)
        return float(gaps[1] - gaps[0])

    return ProbeZero(zero_error, motion(0.0), motion(zero_error) - motion(0.0))
