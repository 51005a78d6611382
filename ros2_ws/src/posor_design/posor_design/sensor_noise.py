# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Noise of lateral effect diodes, resolution of converters, and the angle that two distances resolve."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from posor.errors import ParameterError
from scipy.constants import Boltzmann, elementary_charge

from posor_design.calculators import NON_NEGATIVE, POSITIVE, calculator


@dataclass(frozen=True)
class DiodeNoise:
    """Noise of a lateral effect diode."""

    thermal_noise: Annotated[float, "A/Hz^0.5", "Current noise of the resistance between the contacts."]
    amplifier_noise: Annotated[float, "A/Hz^0.5", "Current noise by the amplifier's voltage noise over the resistance."]
    shot_noise: Annotated[float, "A/Hz^0.5", "Current noise of the photocurrent."]
    position_noise: Annotated[float, "m/Hz^0.5", "Standard deviation of a position in a bandwidth of 1 Hz."]
    resolution: Annotated[float, "m", "Standard deviation of a position in the given bandwidth."]
    bits: Annotated[float, "1", "Bits of a converter whose step over the side is the resolution."]


@calculator
def diode_noise(
    side: Annotated[float, "m", POSITIVE, "Distance between opposite contacts."],
    power: Annotated[float, "W", POSITIVE, "Power of the light on the diode."],
    responsivity: Annotated[float, "A/W", POSITIVE, "Photocurrent over this power."],
    resistance: Annotated[float, "Ohm", POSITIVE, "Resistance between opposite contacts."],
    amplifier_voltage_noise: Annotated[float, "V/Hz^0.5", POSITIVE, "Voltage noise at the input of the amplifier."],
    bandwidth: Annotated[
        float,
        "Hz",
        POSITIVE,
        "Bandwidth of the measurement; one reading for each period of a pulsed source has 1 over the period.",
    ],
    temperature: Annotated[float, "K", POSITIVE, "Temperature of the diode."] = 300.0,
) -> DiodeNoise:
    """Noise of the position that a lateral effect diode measures.

    Three current noises add up as independent ones. Their ratio to the photocurrent, times the side and over the root
    of 2, is the noise of the position.

    Source: thesis 4.3, equation 4.3 (after O'Kelly).
    """
    current = power * responsivity
    thermal = math.sqrt(4.0 * Boltzmann * temperature / resistance)
    amplifier = amplifier_voltage_noise / resistance
    shot = math.sqrt(2.0 * elementary_charge * current)
    position_noise = math.hypot(thermal, amplifier, shot) * side / (math.sqrt(2.0) * current)
    resolution = position_noise * math.sqrt(bandwidth)
    return DiodeNoise(thermal, amplifier, shot, position_noise, resolution, math.log2(side / resolution))


@dataclass(frozen=True)
class ConverterResolution:
    """Resolution of a sensor behind a converter."""

    parts: Annotated[float, "1", "Input range over accuracy."]
    bits: Annotated[float, "1", "Logarithm of the parts to the base 2."]
    step: Annotated[float, "m", "Part of the travel that the accuracy is worth."]
    rounding: Annotated[float, "m", "Standard deviation of rounding to this step."]
    noise: Annotated[float, "m", "Standard deviation of the mean of the samples."]
    time: Annotated[float, "s", "Time that the samples take."]


@calculator
def converter_resolution(
    travel: Annotated[float, "m", POSITIVE, "Travel of the sensor over the input range."],
    input_range: Annotated[float, "V", POSITIVE, "Input range of the converter that the travel fills."],
    accuracy: Annotated[float, "V", POSITIVE, "Accuracy of the converter, or its step."],
    sample_noise: Annotated[
        float,
        "V",
        NON_NEGATIVE,
        "Standard deviation of a sample; the mean of independent samples has it over the root of their number, while "
        "the error of the converter remains.",
    ] = 0.0,
    samples: Annotated[int, POSITIVE, "Number of samples of a mean."] = 1,
    sample_time: Annotated[float, "s", NON_NEGATIVE, "Time of a sample."] = 0.0,
) -> ConverterResolution:
    """Resolution that a converter leaves of a sensor, and the noise of the mean of several samples.

    Source: thesis 4.4 and 7.2; rounding: JCGM 100, F.2.2.1.
    """
    if accuracy > input_range:
        expected = f"at most the input range, {input_range:g} V"
        raise ParameterError(f"{accuracy:g} V", where="accuracy", expected=expected)
    parts = input_range / accuracy
    return ConverterResolution(
        parts=parts,
        bits=math.log2(parts),
        step=travel / parts,
        rounding=travel / parts / math.sqrt(12.0),
        noise=travel * sample_noise / input_range / math.sqrt(samples),
        time=samples * sample_time,
    )


@dataclass(frozen=True)
class AngleResolution:
    """Angle that two distances resolve."""

    step: Annotated[float, "rad", "Angle of a step of one distance."]
    noise: Annotated[float, "rad", "Standard deviation of the angle if the step is that of both distances."]


@calculator
def angle_resolution(
    resolution: Annotated[float, "m", POSITIVE, "Step or standard deviation of a distance."],
    base: Annotated[float, "m", POSITIVE, "Distance between the sensors across their direction, or radius of one."],
) -> AngleResolution:
    """Angle that two distance sensors resolve, or one at a radius.

    Source: thesis 3.2.2 (step) and 5.3.1, equation 5.13 (standard deviation).
    """
    step = math.atan(resolution / base)
    return AngleResolution(step, math.sqrt(2.0) * step)
