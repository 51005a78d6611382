"""Noise of lateral effect diodes, resolution of converters, and the angle that two distances resolve."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor.errors import ParameterError
from scipy.constants import Boltzmann, elementary_charge

from posor_design.checks import require_non_negative, require_positive

if TYPE_CHECKING:
    from posor_design.units import (
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
    """Noise of a lateral effect diode.

    Attributes:
        thermal_noise: Current noise of the resistance between the contacts.
        amplifier_noise: Current noise that the amplifier's voltage noise drives through this resistance.
        shot_noise: Current noise of the photocurrent.
        position_noise: Standard deviation of a position in a bandwidth of 1 Hz.
        resolution: Standard deviation of a position in the given bandwidth.
        bits: Bits of a converter whose step over the side is the resolution.

    """

    thermal_noise: AmperePerRootHertz
    amplifier_noise: AmperePerRootHertz
    shot_noise: AmperePerRootHertz
    position_noise: MetrePerRootHertz
    resolution: Metre
    bits: Number


def diode_noise(
    side: Metre,
    power: Watt,
    responsivity: AmperePerWatt,
    resistance: Ohm,
    amplifier_voltage_noise: VoltPerRootHertz,
    bandwidth: Hertz,
    temperature: Kelvin = 300.0,
) -> DiodeNoise:
    """Noise of the position that a lateral effect diode measures.

    Three current noises add up as independent ones. Their ratio to the photocurrent, times the side and over the root
    of 2, is the noise of the position.

    Args:
        side: Distance between opposite contacts.
        power: Power of the light on the diode.
        responsivity: Photocurrent over this power.
        resistance: Resistance between opposite contacts.
        amplifier_voltage_noise: Voltage noise at the input of the amplifier.
        bandwidth: Bandwidth of the measurement; one reading for each period of a pulsed source has 1 over the period.
        temperature: Temperature of the diode.

    Raises:
        ParameterError: An argument is not finite or not positive.

    Source: thesis 4.3, equation 4.3 (after O'Kelly).

    Example:
        posor design diode-noise --side '1.25 in' --power '1 mW' --responsivity '.25 A/W' --resistance '1000 Ohm'
        --amplifier-voltage-noise '10 nV/Hz^0.5' --bandwidth '2.5 kHz'

    """
    require_positive(side=side, power=power, responsivity=responsivity, resistance=resistance)
    require_positive(amplifier_voltage_noise=amplifier_voltage_noise, bandwidth=bandwidth, temperature=temperature)
    current = power * responsivity
    thermal = math.sqrt(4.0 * Boltzmann * temperature / resistance)
    amplifier = amplifier_voltage_noise / resistance
    shot = math.sqrt(2.0 * elementary_charge * current)
    position_noise = math.hypot(thermal, amplifier, shot) * side / (math.sqrt(2.0) * current)
    resolution = position_noise * math.sqrt(bandwidth)
    return DiodeNoise(thermal, amplifier, shot, position_noise, resolution, math.log2(side / resolution))


@dataclass(frozen=True)
class ConverterResolution:
    """Resolution of a sensor behind a converter.

    Attributes:
        parts: Input range over accuracy.
        bits: Logarithm of the parts to the base 2.
        step: Part of the travel that the accuracy is worth.
        rounding: Standard deviation of rounding to this step.
        noise: Standard deviation of the mean of the samples.
        time: Time that the samples take.

    """

    parts: Number
    bits: Number
    step: Metre
    rounding: Metre
    noise: Metre
    time: Second


def converter_resolution(
    travel: Metre,
    input_range: Volt,
    accuracy: Volt,
    sample_noise: Volt = 0.0,
    samples: int = 1,
    sample_time: Second = 0.0,
) -> ConverterResolution:
    """Resolution that a converter leaves of a sensor, and the noise of the mean of several samples.

    Args:
        travel: Travel of the sensor over the input range.
        input_range: Input range of the converter that the travel fills.
        accuracy: Accuracy of the converter, or its step.
        sample_noise: Standard deviation of a sample; the mean of independent samples has it over the root of their
            number, while the error of the converter remains.
        samples: Number of samples of a mean.
        sample_time: Time of a sample.

    Raises:
        ParameterError: An argument is not finite, a range or the number of samples is not positive, or the accuracy
            exceeds the input range.

    Source: thesis 4.4 and 7.2; rounding: JCGM 100, F.2.2.1.

    Example:
        posor design converter-resolution --travel '.05 in' --input-range '1 V' --accuracy '65 uV'

    """
    require_positive(travel=travel, input_range=input_range, accuracy=accuracy, samples=samples)
    require_non_negative(sample_noise=sample_noise, sample_time=sample_time)
    if accuracy > input_range:
        raise ParameterError(
            f"{accuracy:g} V", where="accuracy", expected=f"at most the input range, {input_range:g} V"
        )
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
    """Angle that two distances resolve.

    Attributes:
        step: Angle of a step of one distance.
        noise: Standard deviation of the angle if both distances have the step as their standard deviation.

    """

    step: Radian
    noise: Radian


def angle_resolution(resolution: Metre, base: Metre) -> AngleResolution:
    """Angle that two distance sensors resolve, or one at a radius.

    Args:
        resolution: Step or standard deviation of a distance.
        base: Distance between the sensors across their direction, or radius of a single one.

    Raises:
        ParameterError: An argument is not finite or not positive.

    Source: thesis 3.2.2 (step) and 5.3.1, equation 5.13 (standard deviation).

    Example:
        posor design angle-resolution --resolution '12.2 uin' --base '5 in'

    """
    require_positive(resolution=resolution, base=base)
    step = math.atan(resolution / base)
    return AngleResolution(step, math.sqrt(2.0) * step)
