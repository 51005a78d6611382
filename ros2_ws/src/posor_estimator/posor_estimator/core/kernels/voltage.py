"""From a probe's voltage to its gap: a polynomial with zero shift, supply and temperature sensitivity.

``gap = sum_k A_k V^k + supply (U - U0) + thermal (K - K0)`` with ``V = voltage + zero_shift`` (thesis table 7.10 for
the polynomial, 7.11 for the supply). Where supply or temperature was not measured (NaN) it counts as at its reference.

Channel parameters (n + 5): A_0 ... A_(n-1) [m/V^k], zero shift [V], supply sensitivity [m/V], supply reference [V],
temperature sensitivity [m/K], temperature reference [K].
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.vector import square

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

EXTRA_PARAMETERS = 5

FINE = 0
NOT_FINITE = 1
OUT_OF_RANGE = 2


@compiled
def polynomial(channel: FloatArray, order: int, volt: float) -> tuple[float, float]:
    """Return the polynomial [m] of a shifted voltage and its slope [m/V]."""
    value = 0.0
    slope = 0.0
    for k in range(order - 1, -1, -1):
        slope = slope * volt + value
        value = value * volt + channel[k]
    return value, slope


@compiled
def linearise_voltages(
    volts: FloatArray,
    supply: float,
    temperature: float,
    channels: FloatArray,
    channel_sigmas: FloatArray,
    ranges: FloatArray,
    noises: FloatArray,
    values: FloatArray,
    variances: FloatArray,
    systematic: FloatArray,
    first: int,
) -> int:
    """Linearise the voltages of one scan into rows ``first`` and following.

    Args:
        volts: Outputs of the probes [V], shape (p,).
        supply: Supply voltage [V] or NaN.
        temperature: Temperature [K] or NaN.
        channels: Parameters of each channel, shape (p, n + 5).
        channel_sigmas: Their standard uncertainties, the same shape.
        ranges: Calibrated lowest and highest shifted voltage [V], shape (p, 2).
        noises: Standard deviation of each voltage [V], shape (p,).
        values: Gaps [m] to write, shape (m,).
        variances: Their variances from the noise [m^2] to write, shape (m,).
        systematic: Covariance of the readings from the channels' parameters [m^2] to write, shape (m, m).
        first: Row of the first probe.

    Returns:
        FINE, or ``1 + 2 * probe`` for a voltage that is not finite, ``2 + 2 * probe`` for one outside the range.

    """
    order = channels.shape[1] - EXTRA_PARAMETERS
    for i in range(volts.shape[0]):
        channel = channels[i]
        volt = volts[i] + channel[order]
        if not math.isfinite(volt):
            return NOT_FINITE + 2 * i
        if volt < ranges[i, 0] or volt > ranges[i, 1]:
            return OUT_OF_RANGE + 2 * i
        value, slope = polynomial(channel, order, volt)
        above_supply = supply - channel[order + 2] if math.isfinite(supply) else 0.0
        above_temperature = temperature - channel[order + 4] if math.isfinite(temperature) else 0.0
        values[first + i] = value + channel[order + 1] * above_supply + channel[order + 3] * above_temperature
        variances[first + i] = slope * slope * noises[i] * noises[i]
        sigma = channel_sigmas[i]
        total = 0.0
        power = 1.0
        for k in range(order):
            total += square(power * sigma[k])
            power *= volt
        total += square(slope * sigma[order])
        total += square(above_supply * sigma[order + 1]) + square(channel[order + 1] * sigma[order + 2])
        total += square(above_temperature * sigma[order + 3]) + square(channel[order + 3] * sigma[order + 4])
        systematic[first + i, first + i] += total
    return FINE


@compiled
def linearise_all(
    volts: FloatArray,
    supplies: FloatArray,
    temperatures: FloatArray,
    channels: FloatArray,
    channel_sigmas: FloatArray,
    ranges: FloatArray,
    noises: FloatArray,
    values: FloatArray,
    variances: FloatArray,
    systematic: FloatArray,
    first: int,
    codes: IntArray,
) -> None:
    """Do ``linearise_voltages`` for every scan; all arrays but the channels' have a leading axis of scans."""
    for n in range(volts.shape[0]):
        codes[n] = linearise_voltages(
            volts[n],
            supplies[n],
            temperatures[n],
            channels,
            channel_sigmas,
            ranges,
            noises,
            values[n],
            variances[n],
            systematic[n],
            first,
        )


@compiled
def voltages_of_gaps(
    gaps: FloatArray,
    supplies: FloatArray,
    temperatures: FloatArray,
    channels: FloatArray,
    ranges: FloatArray,
    volts: FloatArray,
) -> None:
    """Write the voltages (n, p) that the probes give for gaps (n, p) [m]; NaN where no voltage in the range does.

    Bisection to a half of the range's 2^-20, then Newton steps: the polynomial is monotonic over the range.
    """
    order = channels.shape[1] - EXTRA_PARAMETERS
    for n in range(gaps.shape[0]):
        for i in range(gaps.shape[1]):
            channel = channels[i]
            wanted = gaps[n, i]
            if math.isfinite(supplies[n]):
                wanted -= channel[order + 1] * (supplies[n] - channel[order + 2])
            if math.isfinite(temperatures[n]):
                wanted -= channel[order + 3] * (temperatures[n] - channel[order + 4])
            low, high = ranges[i, 0], ranges[i, 1]
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
