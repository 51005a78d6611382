# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The section ``electronics`` of a scenario file; a missing entry means perfect electronics."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from posor.calibration.file_model import EntryError, FrozenModel, format_value
from posor.calibration.quantity import Quantity, measured
from pydantic import Field, model_validator

from posor_drivers.quantity_limits import INTERVAL, NOT_NEGATIVE, POSITIVE, PROBABILITY, Delay, Seconds

Voltage = Annotated[Quantity, measured("V"), POSITIVE]
Amplitude = Annotated[Quantity, measured("V"), NOT_NEGATIVE]


class Converter(FrozenModel):
    """Analogue-to-digital converter: ``2^bits`` codes over the range of probe voltages and of diode currents."""

    bits: Annotated[int, Field(strict=True, ge=12, le=24)]
    probes: Annotated[Quantity, measured("V", 2), INTERVAL]
    diodes: Annotated[Quantity, measured("A", 2), INTERVAL]


class ZeroDrift(FrozenModel):
    """Drift of each probe's zero: a slow sine with its own phase, at most ``2 pi amplitude / period`` per second."""

    amplitude: Amplitude
    period: Seconds


class Supply(FrozenModel):
    """Supply voltage of the probe electronics: ``mean`` and a sine; scans hold it if it is ``measured``."""

    mean: Voltage
    amplitude: Amplitude
    period: Seconds
    measured: bool = Field(strict=True)


class TimedEntry(FrozenModel):
    """Disturbance of a joint during a part of each cycle, between two scenario times.

    ``channel`` is the name of a probe or diode in the joint's calibration, ``contact`` a contact of a diode.
    """

    joint: str
    channel: str | None = None
    contact: Literal["A", "B", "C", "D"] | None = None
    begin: Annotated[Quantity, measured("s"), NOT_NEGATIVE] = Field(alias="from")
    end: Annotated[Quantity, measured("s"), POSITIVE] = Field(alias="until")
    size: Quantity | None = None

    @model_validator(mode="after")
    def _check_times(self) -> Self:
        if not self.begin.number < self.end.number:
            expected = f"more than {self.begin.number:g} s, where it begins"
            raise EntryError(f"until {self.end.number:g} s", key=("until", "value"), expected=expected)
        return self


class Contamination(TimedEntry):
    """Dirt on one channel.

    ``size`` is a shift of the probe's voltage [V], or the relative change [1] of the current of one ``contact`` of a
    diode (-0.1: a tenth less).
    """

    channel: str
    size: Quantity

    @model_validator(mode="after")
    def _check_size(self) -> Self:
        unit = "V" if self.contact is None else "1"
        if self.size.unit != unit or self.size.array.shape:
            expected = f"one number, unit '{unit}'"
            what = f"size {format_value(self.size.value)} '{self.size.unit}'"
            raise EntryError(what, key=("size",), expected=expected)
        if self.contact is not None and not self.size.number > -1.0:
            expected = "more than -1, which leaves no current"
            raise EntryError(f"size {self.size.number:g}", key=("size", "value"), expected=expected)
        return self


class Dropouts(FrozenModel):
    """Probability that a scan is never published."""

    probability: Annotated[Quantity, measured("1"), PROBABILITY]


class Latency(FrozenModel):
    """Delay from mid-exposure to publication, uniform within ``mean`` plus or minus ``jitter``."""

    mean: Delay
    jitter: Annotated[Quantity, measured("s"), NOT_NEGATIVE]

    @model_validator(mode="after")
    def _not_before_the_exposure(self) -> Self:
        if self.jitter.number > self.mean.number:
            expected = f"at most {self.mean.number:g} s, the mean"
            raise EntryError(f"jitter {self.jitter.number:g} s", key=("jitter", "value"), expected=expected)
        return self


class AmbientLight(FrozenModel):
    """Ambient light, and the interval at which all light sources are off for one scan, a dark scan.

    The first scan of a driver is dark, and each whose tick is a multiple of the interval. Joints whose calibration has
    no key ``ambient`` have neither; without this section no joint has: the diode currents count as demodulated.
    ``current`` is that of each contact.
    """

    current: Annotated[Quantity, measured("A"), NOT_NEGATIVE]
    interval: Seconds


class Multiplexer(FrozenModel):
    """Channels are read one after another, in the order gap probes, ring probes, contact currents, about the stamp.

    ``offsets``: whether scans state the exposures, state none, which means that there is one, or that they are unknown.
    """

    interval: Seconds
    offsets: Literal["stated", "unstated", "unknown"] = "stated"


class ElectronicsSettings(FrozenModel):
    """Electronics of all joints."""

    converter: Converter
    zero_drift: ZeroDrift | None = None
    supply: Supply | None = None
    contamination: tuple[Contamination, ...] = ()
    dropouts: Dropouts | None = None
    latency: Latency | None = None
    ambient: AmbientLight | None = None
    multiplexer: Multiplexer | None = None
