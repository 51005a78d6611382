"""From a probe's voltage to its gap: a polynomial with zero shift, supply and temperature sensitivity.

``gap = sum_k A_k V^k + supply (U - U0) + thermal (K - K0)`` with ``V = voltage + zero_shift`` (thesis table 7.10 for
the polynomial, 7.11 for the supply). Where supply or temperature was not measured (NaN) it counts as at its reference.

Channel parameters (n + 5): A_0 ... A_(n-1) [m/V^k], zero shift [V], supply sensitivity [m/V], supply reference [V],
temperature sensitivity [m/K], temperature reference [K].
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled, in_place, inlined
from posor_estimator.core.kernels.eight import chosen

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

EXTRA_PARAMETERS = 5
COLUMNS = 8
"""A channel's numbers beside its coefficients: the extra parameters, and the three that are none."""
LOWEST, HIGHEST, NOISE = 5, 6, 7
"""Where those three stand, counted from the end of the coefficients."""

FINE = 0
NOT_FINITE = 1
OUT_OF_RANGE = 2


@inlined
def polynomial(channel: FloatArray, order: int, volt: float) -> tuple[float, float]:
    """Return the polynomial [m] of a shifted voltage and its slope [m/V]."""
    value = 0.0
    slope = 0.0
    for k in range(order - 1, -1, -1):
        slope = slope * volt + value
        value = value * volt + channel[k]
    return value, slope


@inlined
def linearise_voltages(
    volts: FloatArray,
    supply: float,
    temperature: float,
    channels: FloatArray,
    begin: int,
    values: FloatArray,
    variances: FloatArray,
    less_by: FloatArray,
    first: int,
) -> int:
    """Linearise the voltages of one scan into readings ``first`` and following.

    Args:
        volts: Outputs of the probes [V], shape (p,).
        supply: Supply voltage [V] or NaN.
        temperature: Temperature [K] or NaN.
        channels: Of each channel its parameters, lowest and highest shifted voltage [V], and the standard deviation of
            its voltage [V], shape (channels, n + 8).
        begin: Which channel the first probe has.
        values: Gaps [m] to write, shape (m,).
        variances: Their variances from the noise [m^2] to write, shape (m,).
        less_by: What they fall by for each of the channel's parameters to write, shape (m, n + 5 or more).
        first: Reading of the first probe.

    Returns:
        FINE, or ``1 + 2 * probe`` for a voltage that is not finite, ``2 + 2 * probe`` for one outside the range.

    """
    order = channels.shape[1] - COLUMNS
    for i in range(volts.shape[0]):
        c, r = begin + i, first + i
        volt = volts[i] + channels[c, order]
        if not math.isfinite(volt):
            return NOT_FINITE + 2 * i
        if volt < channels[c, order + LOWEST] or volt > channels[c, order + HIGHEST]:
            return OUT_OF_RANGE + 2 * i
        write_gap(volt, supply, temperature, channels, c, values, variances, less_by, r)
    return FINE


@inlined
def write_gap(
    volt: float,
    supply: float,
    temperature: float,
    channels: FloatArray,
    c: int,
    values: FloatArray,
    variances: FloatArray,
    less_by: FloatArray,
    r: int,
) -> None:
    """Write reading r from the shifted voltage of channel c [V], which is fit; others as ``linearise_voltages``."""
    order = channels.shape[1] - COLUMNS
    value, slope = polynomial(channels[c], order, volt)
    above_supply = chosen(abs(supply) < math.inf, supply - channels[c, order + 2], 0.0)
    above_temperature = chosen(abs(temperature) < math.inf, temperature - channels[c, order + 4], 0.0)
    values[r] = value + channels[c, order + 1] * above_supply + channels[c, order + 3] * above_temperature
    noise = channels[c, order + NOISE]
    variances[r] = slope * slope * noise * noise
    power = -1.0
    for k in range(order):
        less_by[r, k] = power
        power *= volt
    less_by[r, order] = -slope
    less_by[r, order + 1], less_by[r, order + 2] = -above_supply, channels[c, order + 1]
    less_by[r, order + 3], less_by[r, order + 4] = -above_temperature, channels[c, order + 3]


@compiled
def linearise_all(
    volts: FloatArray,
    supplies: FloatArray,
    temperatures: FloatArray,
    channels: FloatArray,
    values: FloatArray,
    variances: FloatArray,
    first: int,
    codes: IntArray,
) -> None:
    """Do ``linearise_voltages`` for every scan; values and variances have a leading axis of scans."""
    less_by = np.empty((values.shape[1], channels.shape[1]))
    for n in range(volts.shape[0]):
        codes[n] = linearise_voltages(
            volts[n], supplies[n], temperatures[n], channels, 0, values[n], variances[n], less_by, first
        )


@compiled
def gap_derivatives(
    volts: FloatArray, supply: float, temperature: float, channels: FloatArray, by_parameter: FloatArray
) -> None:
    """Write the derivatives of the gaps of one scan's voltages (p,) into ``by_parameter`` (p, n + 5)."""
    p = volts.shape[0]
    linearise_voltages(volts, supply, temperature, channels, 0, np.empty(p), np.empty(p), by_parameter, 0)
    for i in range(p):
        for k in range(by_parameter.shape[1]):
            by_parameter[i, k] = -by_parameter[i, k]


@compiled
def gap_sigmas(
    volts: FloatArray,
    supplies: FloatArray,
    temperatures: FloatArray,
    channels: FloatArray,
    parameter_sigmas: FloatArray,
    sigmas: FloatArray,
) -> None:
    """Write the gaps' standard uncertainties (n, p) [m] from those of their channels' parameters (p, n + 5)."""
    p = volts.shape[1]
    values, variances, less_by = np.empty(p), np.empty(p), np.empty(parameter_sigmas.shape)
    for n in range(volts.shape[0]):
        linearise_voltages(volts[n], supplies[n], temperatures[n], channels, 0, values, variances, less_by, 0)
        for i in range(p):
            total = 0.0
            for k in range(parameter_sigmas.shape[1]):
                effect = less_by[i, k] * parameter_sigmas[i, k]
                total += effect * effect
            sigmas[n, i] = math.sqrt(total)


@in_place
def voltages_of_gaps(
    gaps: FloatArray,
    supplies: FloatArray,
    temperatures: FloatArray,
    channels: FloatArray,
    volts: FloatArray,
) -> None:
    """Write the voltages (n, p) that the probes give for gaps (n, p) [m]; NaN where no voltage in the range does.

    Bisection to a half of the range's 2^-20, then Newton steps: the polynomial is monotonic over the range.
    """
    order = channels.shape[1] - COLUMNS
    for n in range(gaps.shape[0]):
        for i in range(gaps.shape[1]):
            channel = channels[i]
            wanted = gaps[n, i]
            if math.isfinite(supplies[n]):
                wanted -= channel[order + 1] * (supplies[n] - channel[order + 2])
            if math.isfinite(temperatures[n]):
                wanted -= channel[order + 3] * (temperatures[n] - channel[order + 4])
            low, high = channel[order + LOWEST], channel[order + HIGHEST]
            at_low = polynomial(channel, order, low)[0] - wanted
            at_high = polynomial(channel, order, high)[0] - wanted
            volts[n, i] = math.nan
            if at_low * at_high > 0.0:
                continue
            for _ in range(20):
                middle = 0.5 * (low + high)
                if (polynomial(channel, order, middle)[0] - wanted) * at_low > 0.0:
                    low = middle
                else:
                    high = middle
            volt = 0.5 * (low + high)
            for _ in range(4):
                value, slope = polynomial(channel, order, volt)
                volt -= (value - wanted) / slope
            volts[n, i] = volt - channel[order]
