"""Noise of lateral effect diodes, resolution of converters, and the angle that two distances resolve."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from posor.errors import ParameterError
from scipy.constants import Boltzmann, elementary_charge

from posor_design.calculators import calculator

if TYPE_CHECKING:
    from posor_design.units import (
        NON_NEGATIVE,
        POSITIVE,
        AmperePerRootHertz,
        AmperePerWatt,
        Hertz,
        Kelvin,
        Metre,
        MetrePerRootHertz,
        Number,
        Ohm,
        Radian,
        Second,
        Volt,
        VoltPerRootHertz,
        Watt,
    )


@dataclass(frozen=True)
class DiodeNoise:
    """Noise of a lateral effect diode."""

    thermal_noise: Annotated[AmperePerRootHertz, "Current noise of the resistance between the contacts."]
    amplifier_noise: Annotated[
        AmperePerRootHertz, "Current noise that the amplifier's voltage noise drives through this resistance."
    ]
    shot_noise: Annotated[AmperePerRootHertz, "Current noise of the photocurrent."]
    position_noise: Annotated[MetrePerRootHertz, "Standard deviation of a position in a bandwidth of 1 Hz."]
    resolution: Annotated[Metre, "Standard deviation of a position in the given bandwidth."]
    bits: Annotated[Number, "Bits of a converter whose step over the side is the resolution."]


@calculator
def diode_noise(
    side: Annotated[Metre, POSITIVE, "Distance between opposite contacts."],
    power: Annotated[Watt, POSITIVE, "Power of the light on the diode."],
    responsivity: Annotated[AmperePerWatt, POSITIVE, "Photocurrent over this power."],
    resistance: Annotated[Ohm, POSITIVE, "Resistance between opposite contacts."],
    amplifier_voltage_noise: Annotated[VoltPerRootHertz, POSITIVE, "Voltage noise at the input of the amplifier."],
    bandwidth: Annotated[
        Hertz,
        POSITIVE,
        "Bandwidth of the measurement; one reading for each period of a pulsed source has 1 over the period.",
    ],
    temperature: Annotated[Kelvin, POSITIVE, "Temperature of the diode."] = 300.0,
) -> DiodeNoise:
    """Noise of the position that a lateral effect diode measures.

    Three current noises add up as independent ones. Their ratio to the photocurrent, times the side and over the root
    of 2, is the noise of the position.

    Source: thesis 4.3, equation 4.3 (after O'Kelly).

    Example:
        posor design diode-noise --side '1.25 in' --power '1 mW' --responsivity '.25 A/W' --resistance '1000 Ohm'
        --amplifier-voltage-noise '10 nV/Hz^0.5' --bandwidth '2.5 kHz'

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

    parts: Annotated[Number, "Input range over accuracy."]
    bits: Annotated[Number, "Logarithm of the parts to the base 2."]
    step: Annotated[Metre, "Part of the travel that the accuracy is worth."]
    rounding: Annotated[Metre, "Standard deviation of rounding to this step."]
    noise: Annotated[Metre, "Standard deviation of the mean of the samples."]
    time: Annotated[Second, "Time that the samples take."]


@calculator
def converter_resolution(
    travel: Annotated[Metre, POSITIVE, "Travel of the sensor over the input range."],
    input_range: Annotated[Volt, POSITIVE, "Input range of the converter that the travel fills."],
    accuracy: Annotated[Volt, POSITIVE, "Accuracy of the converter, or its step."],
    sample_noise: Annotated[
        Volt,
        NON_NEGATIVE,
        "Standard deviation of a sample; the mean of independent samples has it over the root of their number, while "
        "the error of the converter remains.",
    ] = 0.0,
    samples: Annotated[int, POSITIVE, "Number of samples of a mean."] = 1,
    sample_time: Annotated[Second, NON_NEGATIVE, "Time of a sample."] = 0.0,
) -> ConverterResolution:
    """Resolution that a converter leaves of a sensor, and the noise of the mean of several samples.

    Source: thesis 4.4 and 7.2; rounding: JCGM 100, F.2.2.1.

    Example:
        posor design converter-resolution --travel '.05 in' --input-range '1 V' --accuracy '65 uV'

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

    step: Annotated[Radian, "Angle of a step of one distance."]
    noise: Annotated[
        Radian, "Standard deviation of the angle if both distances have the step as their standard deviation."
    ]


@calculator
def angle_resolution(
    resolution: Annotated[Metre, POSITIVE, "Step or standard deviation of a distance."],
    base: Annotated[Metre, POSITIVE, "Distance between the sensors across their direction, or radius of a single one."],
) -> AngleResolution:
    """Angle that two distance sensors resolve, or one at a radius.

    Source: thesis 3.2.2 (step) and 5.3.1, equation 5.13 (standard deviation).

    Example:
        posor design angle-resolution --resolution '12.2 uin' --base '5 in'

    """
    step = math.atan(resolution / base)
    return AngleResolution(step, math.sqrt(2.0) * step)
