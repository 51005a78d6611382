# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""From a probe's voltage to its gap: gain of the converter, then a polynomial with zero shift and sensitivities.

``gap = sum_k A_k V^k + supply (U - U0) + thermal (K - K0)`` with ``V = voltage + zero_shift`` (thesis table 7.10 for
the polynomial, 7.11 for the supply). A supply or temperature that was not measured (NaN) counts as at its reference.

A converter that reads a known voltage U as U' has the gain ``g = U'/U``; all voltages are divided by g. The relative
uncertainty of U' and U is common to all gaps: ``-V dgap/dV`` times it, in one factor.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.numerics.compiled import in_place

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from posor.numerics.array_types import FloatArray

MAX_COEFFICIENTS = 16
CHANNEL_PARAMETERS = MAX_COEFFICIENTS + 5

_PARAMETERS: dict[str, tuple[Any, int]] = {
    "parameters": (("f8", (CHANNEL_PARAMETERS,)), 0),
    "coefficients": (("f8", (MAX_COEFFICIENTS,)), 0),  # A_k [m/V^k]
    "zero_shift": ("f8", 8 * MAX_COEFFICIENTS),  # [V]
    "supply_sensitivity": ("f8", 8 * MAX_COEFFICIENTS + 8),  # [m/V]
    "supply_reference": ("f8", 8 * MAX_COEFFICIENTS + 16),  # [V]
    "temperature_sensitivity": ("f8", 8 * MAX_COEFFICIENTS + 24),  # [m/K]
    "temperature_reference": ("f8", 8 * MAX_COEFFICIENTS + 32),  # [K]
}


def _record(fields: dict[str, tuple[Any, int]]) -> np.dtype[np.void]:
    return np.dtype(
        {
            "names": list(fields),
            "formats": [form for form, _ in fields.values()],
            "offsets": [offset for _, offset in fields.values()],
        }
    )


CHANNEL_DERIVATIVES = _record(_PARAMETERS)
"""Derivatives of a linearised gap with respect to the parameters of its channel; ``parameters`` holds all of them."""

CHANNEL = _record(  # the calibration of one voltage channel
    {
        **_PARAMETERS,
        "order": ("i8", 8 * CHANNEL_PARAMETERS),  # number of coefficients
        "lowest": ("f8", 8 * CHANNEL_PARAMETERS + 8),  # calibrated range of the shifted voltage [V]
        "highest": ("f8", 8 * CHANNEL_PARAMETERS + 16),
        "noise": ("f8", 8 * CHANNEL_PARAMETERS + 24),  # standard deviation of the voltage [V]
    }
)

VALID, NOT_FINITE, OUT_OF_RANGE = 0, 1, 2


@in_place
def polynomial(channel: Any, volt: float) -> tuple[float, float]:
    """Return the polynomial [m] of a shifted voltage and its slope [m/V]."""
    value = 0.0
    slope = 0.0
    for k in range(channel.order - 1, -1, -1):
        slope = slope * volt + value
        value = value * volt + channel.coefficients[k]
    return value, slope


@in_place
def voltage_code(channel: Any, volt: float) -> int:
    """Return VALID, NOT_FINITE or OUT_OF_RANGE for a shifted voltage [V]."""
    if not math.isfinite(volt):
        return NOT_FINITE
    return VALID if channel.lowest <= volt <= channel.highest else OUT_OF_RANGE


@in_place
def deviation_from_reference(measured: float, reference: float) -> float:
    """Return how far a supply or a temperature is from its reference; zero where it was not measured."""
    return measured - reference if math.isfinite(measured) else 0.0


@in_place
def linearise_voltage(
    channel: Any, volt: float, supply: float, temperature: float, residual_derivatives: Any
) -> tuple[float, float]:
    """Return the gap [m] of a valid shifted voltage [V] and the variance of its noise [m^2].

    Writes the derivatives of prediction minus reading, so with the opposite sign of the gap's own derivatives, into
    ``residual_derivatives`` (dtype CHANNEL_DERIVATIVES).
    """
    value, slope = polynomial(channel, volt)
    above_supply = deviation_from_reference(supply, channel.supply_reference)
    above_temperature = deviation_from_reference(temperature, channel.temperature_reference)
    power = -1.0
    for k in range(channel.order):
        residual_derivatives.coefficients[k] = power
        power *= volt
    residual_derivatives.zero_shift = -slope
    residual_derivatives.supply_sensitivity = -above_supply
    residual_derivatives.supply_reference = channel.supply_sensitivity
    residual_derivatives.temperature_sensitivity = -above_temperature
    residual_derivatives.temperature_reference = channel.temperature_sensitivity
    gap = value + channel.supply_sensitivity * above_supply + channel.temperature_sensitivity * above_temperature
    return gap, slope * slope * channel.noise * channel.noise


@in_place
def converter_gain(settings: Any, scan: Any) -> tuple[float, float]:
    """Return the gain of the probes' converter and its standard uncertainty; without a reading: one, and its spread."""
    if not settings.reference_voltage > 0.0:
        return 1.0, 0.0
    if math.isnan(scan.reference_voltage):
        return 1.0, settings.gain_spread
    if scan.reference_voltage == 0.0:
        return 1.0, 0.0  # not valid: see ``gain_is_valid``
    return scan.reference_voltage / settings.reference_voltage, settings.reference_sigma


@in_place
def gain_is_valid(settings: Any, scan: Any) -> bool:
    """Return whether the gain is within its limit of one, or not measured."""
    known, reading = settings.reference_voltage, scan.reference_voltage
    return bool(not known > 0.0 or math.isnan(reading) or abs(reading - known) <= settings.gain_limit * known)


@in_place
def linearise_channels(
    volts: FloatArray,
    supply: float,
    temperature: float,
    channels: NDArray[np.void],
    residual_derivatives: NDArray[np.void],
) -> None:
    """Write the derivatives of one scan's gaps, with opposite sign, for valid voltages (p,) of channels (p,)."""
    for i in range(volts.shape[0]):
        channel = channels[i]
        linearise_voltage(channel, volts[i] + channel.zero_shift, supply, temperature, residual_derivatives[i])


@in_place
def voltages_of_gaps(
    gaps: FloatArray, supplies: FloatArray, temperatures: FloatArray, channels: NDArray[np.void], volts: FloatArray
) -> None:
    """Write the voltages (n, p) that the probes give for gaps (n, p) [m]; NaN where no voltage in the range does.

    20 bisections, then Newton steps; ``ProbeCalibration`` checks that the polynomial is monotonic over the range.
    """
    for n in range(gaps.shape[0]):
        for i in range(gaps.shape[1]):
            channel = channels[i]
            wanted = (
                gaps[n, i]
                - channel.supply_sensitivity * deviation_from_reference(supplies[n], channel.supply_reference)
                - channel.temperature_sensitivity
                * deviation_from_reference(temperatures[n], channel.temperature_reference)
            )
            volts[n, i] = _voltage_of_polynomial(channel, wanted) - channel.zero_shift


@in_place
def _voltage_of_polynomial(channel: Any, wanted: float) -> float:
    """Return the shifted voltage [V] at which the polynomial has a value [m], NaN outside the range."""
    low, high = channel.lowest, channel.highest
    at_low = polynomial(channel, low)[0] - wanted
    at_high = polynomial(channel, high)[0] - wanted
    if at_low * at_high > 0.0:
        return math.nan
    for _ in range(20):
        middle = 0.5 * (low + high)
        if (polynomial(channel, middle)[0] - wanted) * at_low > 0.0:
            low = middle
        else:
            high = middle
    volt = 0.5 * (low + high)
    for _ in range(4):
        value, slope = polynomial(channel, volt)
        volt -= (value - wanted) / slope
    return float(volt)
