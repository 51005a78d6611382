# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""References of a calibration in an instruments file: channel, uncertainty, and corrections of an interferometer.

::

References:
      laser:
        joint: elbow                    # its driver publishes /reference/laser at the ticks of the scans
        frame_id: table
        unit: m                         # or rad, of an autocollimator
        channel: counter/distance       # with scale and offset, as a reading of a joint
        standard_uncertainty: {value: 2.0e-8, unit: m}      # of the reading itself: noise and resolution
        interferometer:                 # optional
          wavelength: {value: 632.991e-9, sigma: 1.0e-14, unit: m}
          assumed_index: 1.00027
          index_uncertainty: 2.0e-8
          air:
            temperature: {channel: weather/air, sigma: {value: 0.1, unit: K}}
            pressure: {value: 101325.0, sigma: 30.0, unit: Pa}
            relative_humidity: {value: 0.5, sigma: 0.05, unit: '1'}
            co2_fraction: {value: 450.0e-6, sigma: 50.0e-6, unit: '1'}
          air_at_zero: {...}            # with dead_path: four quantities; sigma is that of the change since
          dead_path: {value: 0.05, sigma: 0.001, unit: m}
          misalignment: [{value: 0.0, sigma: 3.0e-4, unit: rad}, {value: 0.0, sigma: 3.0e-4, unit: rad}]
          abbe_offsets: [{offset: {...}, angle: {...}}]
          expansions: [{length: {...}, coefficient: {...}, temperature_change: {...}}]
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.quantity import Quantity, measured
from posor.uncertainty.interferometer import AbbeOffset, AirQuantities, Expansion, Input, Interferometer
from pydantic import AfterValidator, Field, model_validator

from posor_drivers.quantity_limits import NOT_NEGATIVE, POSITIVE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

Metres = Annotated[Quantity, measured("m")]
Radians = Annotated[Quantity, measured("rad")]
AIR_UNITS = {"temperature": "K", "pressure": "Pa", "relative_humidity": "1", "co2_fraction": "1"}


def _check_channel(channel: str) -> str:
    if not re.fullmatch("[^/]+/[^/]+", channel):
        raise EntryError(f"channel '{channel}'", expected="DEVICE/CHANNEL")
    return channel


class ChannelEntry(FrozenModel):
    """What a channel measures: ``scale`` times the channel plus ``offset``."""

    channel: Annotated[str, AfterValidator(_check_channel)]
    scale: Quantity | None = None
    offset: Quantity | None = None

    @property
    def device(self) -> str:
        """Name of the channel's device."""
        return self.channel.partition("/")[0]

    @property
    def factor(self) -> float:
        """Amount of the quantity in one unit of the channel."""
        return 1.0 if self.scale is None else self.scale.number

    @property
    def shift(self) -> float:
        """The quantity at zero of the channel."""
        return 0.0 if self.offset is None else self.offset.number

    def value(self, channels: Mapping[str, float]) -> float:
        """Return the quantity by the values of the channels."""
        return self.factor * channels[self.channel] + self.shift


class MeasuredQuantity(ChannelEntry):
    """A quantity that a channel measures, with its standard uncertainty."""

    sigma: Annotated[Quantity, NOT_NEGATIVE]


AirQuantity = MeasuredQuantity | Quantity


class AirEntry(FrozenModel):
    """Air along the beam; each quantity is a number or a channel."""

    temperature: AirQuantity
    pressure: AirQuantity
    relative_humidity: AirQuantity
    co2_fraction: AirQuantity

    def at(self, channels: Mapping[str, float]) -> AirQuantities:
        """Return the air by the values of the channels."""
        return AirQuantities(*(_input(getattr(self, name), channels) for name in AIR_UNITS))

    @property
    def channels(self) -> Iterator[tuple[str, MeasuredQuantity]]:
        """Yield name and entry of each quantity that is measured."""
        for name in AIR_UNITS:
            if isinstance(entry := getattr(self, name), MeasuredQuantity):
                yield name, entry

    @model_validator(mode="after")
    def _check_units(self) -> Self:
        for name, unit in AIR_UNITS.items():
            entry = getattr(self, name)
            stated = entry.sigma.unit if isinstance(entry, MeasuredQuantity) else entry.unit
            if stated != unit:
                raise EntryError(f"{name} in {stated}", key=(name,), expected=unit)
        return self


class AbbeEntry(FrozenModel):
    """Distance between beam and point of interest, and turn of the carriage."""

    offset: Metres
    angle: Radians


class ExpansionEntry(FrozenModel):
    """Part of the machine between the optics."""

    length: Metres
    coefficient: Annotated[Quantity, measured("1/K")]
    temperature_change: Annotated[Quantity, measured("K")]


class InterferometerEntry(FrozenModel):
    """Set-up of an interferometer, see ``uncertainty.interferometer``."""

    wavelength: Annotated[Quantity, measured("m"), POSITIVE]
    assumed_index: Annotated[float, Field(strict=True, ge=1.0, le=1.001)]
    index_uncertainty: Annotated[float, Field(strict=True, ge=0.0)]
    air: AirEntry
    air_at_zero: AirEntry | None = None
    """Air when the interferometer was set to zero, without channels; its uncertainty is that of the change since."""
    dead_path: Metres | None = None
    misalignment: tuple[Radians, Radians] | None = None
    abbe_offsets: tuple[AbbeEntry, ...] = ()
    expansions: tuple[ExpansionEntry, ...] = ()

    @model_validator(mode="after")
    def _check_zero(self) -> Self:
        if (self.dead_path is None) != (self.air_at_zero is None):
            raise EntryError("only one of dead_path and air_at_zero", expected="both or neither")
        for name, entry in self.air_at_zero.channels if self.air_at_zero else ():
            raise EntryError(f"channel '{entry.channel}'", key=("air_at_zero", name), expected="a quantity")
        return self

    def setup(self, channels: Mapping[str, float]) -> Interferometer:
        """Return the set-up by the values of the channels.

        Raises:
            ParameterError: A quantity is not finite, or out of range.

        """
        air, optional = self.air.at(channels), dict[str, Any]()
        if self.air_at_zero is not None and self.dead_path is not None:
            pairs = zip(air.each, self.air_at_zero.at({}).each, strict=True)
            change = [Input(now.value - then.value, then.uncertainty) for now, then in pairs]
            optional |= {"air_change": AirQuantities(*change), "dead_path": _quantity(self.dead_path)}
        if self.misalignment is not None:
            optional["misalignment"] = tuple(map(_quantity, self.misalignment))
        return Interferometer(
            wavelength=_quantity(self.wavelength),
            assumed_index=self.assumed_index,
            air=air,
            index_uncertainty=self.index_uncertainty,
            **optional,
            abbe_offsets=tuple(AbbeOffset(_quantity(each.offset), _quantity(each.angle)) for each in self.abbe_offsets),
            expansions=tuple(
                Expansion(_quantity(each.length), _quantity(each.coefficient), _quantity(each.temperature_change))
                for each in self.expansions
            ),
        )


class ReferenceEntry(ChannelEntry):
    """A reference of a calibration: a channel and what is known of it."""

    joint: str
    frame_id: Annotated[str, Field(min_length=1)]
    unit: Literal["m", "rad"]
    standard_uncertainty: Annotated[Quantity, NOT_NEGATIVE]
    interferometer: InterferometerEntry | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.standard_uncertainty.unit != self.unit:
            what = f"standard uncertainty in {self.standard_uncertainty.unit}"
            raise EntryError(what, key=("standard_uncertainty", "unit"), expected=self.unit)
        if self.interferometer is not None and self.unit != "m":
            raise EntryError("an interferometer with a unit of rad", key=("unit",), expected="m")
        return self

    @property
    def measured(self) -> Iterator[tuple[tuple[str, ...], str, ChannelEntry]]:
        """Yield location in the entry, unit and entry of everything that a channel measures."""
        yield (), self.unit, self
        if self.interferometer is not None:
            for name, entry in self.interferometer.air.channels:
                yield ("interferometer", "air", name), AIR_UNITS[name], entry


def _quantity(quantity: Quantity) -> Input:
    return Input(quantity.number, float(quantity.sigmas))


def _input(entry: AirQuantity, channels: Mapping[str, float]) -> Input:
    return Input(entry.value(channels), entry.sigma.number) if isinstance(entry, MeasuredQuantity) else _quantity(entry)
