"""What a scenario says of the electronics: converter, drifts, dirt, lost scans, delay. What is left out is perfect."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from posor_estimator.core.calibration.entry import EntryError, shown
from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.core.calibration.quantity import Quantity, measured
from pydantic import Field, model_validator

from posor_drivers.simulator.limits import INTERVAL, NOT_NEGATIVE, POSITIVE, PROBABILITY

Voltage = Annotated[Quantity, measured("V"), POSITIVE]
Amplitude = Annotated[Quantity, measured("V"), NOT_NEGATIVE]
Period = Annotated[Quantity, measured("s"), POSITIVE]


class Converter(FrozenModel):
    """Analogue to digital: ``2^bits`` steps over the range of the probes' voltages and of the diodes' currents."""

    bits: Annotated[int, Field(strict=True, ge=12, le=16)]
    probes: Annotated[Quantity, measured("V", 2), INTERVAL]
    diodes: Annotated[Quantity, measured("A", 2), INTERVAL]


class ZeroDrift(FrozenModel):
    """Each probe's zero wanders as a slow sine of its own phase; the fastest is ``2 pi amplitude / period``."""

    amplitude: Amplitude
    period: Period


class Supply(FrozenModel):
    """Supply of the probe electronics: ``mean``, and a sine about it; told in the scans where it is ``measured``."""

    mean: Voltage
    amplitude: Amplitude
    period: Period
    measured: bool = Field(strict=True)


class Contamination(FrozenModel):
    """Dirt on one channel for part of each cycle, from one scenario time until another.

    ``channel`` is the name of a probe or of a diode in the joint's calibration. A probe's voltage is shifted by
    ``size`` [V]; of a diode, the current of one ``contact`` changes by the relative ``size`` [1], -0.1: a tenth less.
    """

    joint: str
    channel: str
    contact: Literal["A", "B", "C", "D"] | None = None
    begin: Annotated[Quantity, measured("s"), NOT_NEGATIVE] = Field(alias="from")
    end: Annotated[Quantity, measured("s"), POSITIVE] = Field(alias="until")
    size: Quantity

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.begin.number < self.end.number:
            expected = f"more than {self.begin.number:g} s, where it begins"
            raise EntryError(f"until {self.end.number:g} s", key=("until", "value"), expected=expected)
        unit = "V" if self.contact is None else "1"
        if self.size.unit != unit or self.size.array.shape:
            expected = f"one number, unit '{unit}'"
            raise EntryError(f"size {shown(self.size.value)} '{self.size.unit}'", key=("size",), expected=expected)
        if self.contact is not None and not self.size.number > -1.0:
            expected = "more than -1, where no current is left"
            raise EntryError(f"size {self.size.number:g}", key=("size", "value"), expected=expected)
        return self


class Dropouts(FrozenModel):
    """Scans that are never sent, each with this probability."""

    probability: Annotated[Quantity, measured("1"), PROBABILITY]


class Latency(FrozenModel):
    """From the middle of the exposure to the publication: evenly spread, ``jitter`` to either side of ``mean``."""

    mean: Annotated[Quantity, measured("s"), NOT_NEGATIVE]
    jitter: Annotated[Quantity, measured("s"), NOT_NEGATIVE]

    @model_validator(mode="after")
    def _not_before_the_exposure(self) -> Self:
        if self.jitter.number > self.mean.number:
            expected = f"at most {self.mean.number:g} s, the mean"
            raise EntryError(f"jitter {self.jitter.number:g} s", key=("jitter", "value"), expected=expected)
        return self


class ElectronicsFile(FrozenModel):
    """The electronics of all joints."""

    converter: Converter
    zero_drift: ZeroDrift | None = None
    supply: Supply | None = None
    contamination: tuple[Contamination, ...] = ()
    dropouts: Dropouts | None = None
    latency: Latency | None = None
