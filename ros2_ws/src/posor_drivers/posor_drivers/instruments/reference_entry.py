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

from typing import TYPE_CHECKING, Annotated, Literal, Self

from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.quantity import Quantity, measured
from posor.uncertainty.interferometer import AbbeOffset, AirQuantities, Expansion, Input, Interferometer
from pydantic import Field, model_validator

from posor_drivers.quantity_limits import NOT_NEGATIVE, POSITIVE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

ChannelName = Annotated[str, Field(pattern=r"^[^/]+/[^/]+$")]
Metres = Annotated[Quantity, measured("m")]
Radians = Annotated[Quantity, measured("rad")]
AIR_UNITS = {"temperature": "K", "pressure": "Pa", "relative_humidity": "1", "co2_fraction": "1"}


class MeasuredQuantity(FrozenModel):
    """A quantity that a channel measures: ``scale`` times the channel plus ``offset``, and its standard uncertainty."""

    channel: ChannelName
    scale: Quantity | None = None
    offset: Quantity | None = None
    sigma: Annotated[Quantity, NOT_NEGATIVE]

    def at(self, channels: Mapping[str, float]) -> Input:
        """Return the quantity by the values of the channels."""
        factor = 1.0 if self.scale is None else self.scale.number
        shift = 0.0 if self.offset is None else self.offset.number
        return Input(factor * channels[self.channel] + shift, self.sigma.number)


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


class FixedAir(FrozenModel):
    """Air when the interferometer was set to zero, with the uncertainty of the change since."""

    temperature: Annotated[Quantity, measured("K")]
    pressure: Annotated[Quantity, measured("Pa")]
    relative_humidity: Annotated[Quantity, measured("1")]
    co2_fraction: Annotated[Quantity, measured("1")]


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
    assumed_index: Annotated[float, Field(ge=1.0, le=1.001)]
    index_uncertainty: Annotated[float, Field(ge=0.0)]
    air: AirEntry
    air_at_zero: FixedAir | None = None
    dead_path: Metres | None = None
    misalignment: tuple[Radians, Radians] | None = None
    abbe_offsets: tuple[AbbeEntry, ...] = ()
    expansions: tuple[ExpansionEntry, ...] = ()

    @model_validator(mode="after")
    def _check_zero(self) -> Self:
        if (self.dead_path is None) != (self.air_at_zero is None):
            raise EntryError("only one of dead_path and air_at_zero", expected="both or neither")
        return self

    def setup(self, channels: Mapping[str, float]) -> Interferometer:
        """Return the set-up by the values of the channels.

        Raises:
            ParameterError: A quantity is not finite, or out of range.

        """
        air, zero = self.air.at(channels), Input(0.0)
        change = AirQuantities(zero, zero, zero, zero)
        if self.air_at_zero is not None:
            before = [_quantity(getattr(self.air_at_zero, name)) for name in AIR_UNITS]
            pairs = zip(air.each, before, strict=True)
            change = AirQuantities(*(Input(now.value - then.value, then.uncertainty) for now, then in pairs))
        angles = (zero, zero)
        if self.misalignment is not None:
            angles = (_quantity(self.misalignment[0]), _quantity(self.misalignment[1]))
        return Interferometer(
            wavelength=_quantity(self.wavelength),
            assumed_index=self.assumed_index,
            air=air,
            index_uncertainty=self.index_uncertainty,
            air_change=change,
            dead_path=zero if self.dead_path is None else _quantity(self.dead_path),
            misalignment=angles,
            abbe_offsets=tuple(AbbeOffset(_quantity(each.offset), _quantity(each.angle)) for each in self.abbe_offsets),
            expansions=tuple(
                Expansion(_quantity(each.length), _quantity(each.coefficient), _quantity(each.temperature_change))
                for each in self.expansions
            ),
        )


class ReferenceEntry(FrozenModel):
    """A reference of a calibration: a channel and what is known of it."""

    joint: str
    frame_id: Annotated[str, Field(min_length=1)]
    unit: Literal["m", "rad"]
    channel: ChannelName
    scale: Quantity | None = None
    offset: Quantity | None = None
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
    def measured(self) -> Iterator[tuple[tuple[str, ...], str, MeasuredQuantity | ReferenceEntry]]:
        """Yield location in the entry, unit and entry of everything that a channel measures."""
        yield (), self.unit, self
        if self.interferometer is not None:
            for name, entry in self.interferometer.air.channels:
                yield ("interferometer", "air", name), AIR_UNITS[name], entry


def _quantity(quantity: Quantity) -> Input:
    return Input(quantity.number, float(quantity.sigmas))


def _input(entry: AirQuantity, channels: Mapping[str, float]) -> Input:
    return entry.at(channels) if isinstance(entry, MeasuredQuantity) else _quantity(entry)
