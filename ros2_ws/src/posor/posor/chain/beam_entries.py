# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Entries of a beams file: what is stated of one beam, or of a thermometer, with plausible amounts of each quantity."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.plausible_range import TEMPERATURE, PlausibleRange
from posor.calibration.quantity import Quantity, measured
from posor.ros_names import ROS_NAME_RULE, is_ros_name

STANDARD_GRAVITY = 9.80665  # [m/s^2] (ISO 80000-3)
PERIOD_S, DELAY_S = 1.0, 0.5
"""At each whole ``PERIOD_S`` of the stamps, readings enter that are at least ``DELAY_S`` old and so have arrived."""
LEAST_AGE_S = 2.0 * PERIOD_S + DELAY_S  # that a reading may reach: delay, wait for the next reading, use of this one


_DIAMETER = PlausibleRange(1e-3, 1.0, {"in mm": 1e-3, "in inches": 0.0254})
_MODULUS = PlausibleRange(
    1e8, 1.5e12, {"in GPa": 1e9, "in MPa": 1e6, "in psi": 6894.76}
)  # of plastics to that of diamond
_DENSITY = PlausibleRange(10.0, 23e3, {"in g/cm^3": 1e3})  # of foams to that of osmium
_MASS = PlausibleRange(0.0, 200.0, {"in g": 1e-3})
_EXPANSION = PlausibleRange(1e-10, 1e-3, {"in um/m/K": 1e-6}, or_zero=True)
_DEVIATION = PlausibleRange(0.0, 150.0, {"the temperature itself": 0.1})
_KELVINS = PlausibleRange(1e-4, 50.0, {"in mK": 1e-3}, or_zero=True)
_RATE = PlausibleRange(1e-6, 10.0, {"in K/min": 1.0 / 60.0, "in K/h": 1.0 / 3600.0})
_AGE = PlausibleRange(LEAST_AGE_S, 3600.0, {"in ms": 1e-3})
_POSITION = PlausibleRange(0.0, 0.1, {"in um": 1e-6, "in mm": 1e-3})
_ORIENTATION = PlausibleRange(0.0, 0.2, {"in urad": 1e-6, "in arcseconds": 4.848e-6, "in degrees": 0.01745})
_SHARE = PlausibleRange(0.0, 1.0, {"in percent": 0.01})
_FREQUENCY = PlausibleRange(1.0, 1e5, {"in kHz": 1e3, "in rad/s": 0.159155})
_DAMPING = PlausibleRange(1e-5, 0.3, {"in percent": 0.01})
_ACCELERATION = PlausibleRange(1e-4, 1e3, {"in mm/s^2": 1e-3, "in standard gravities": STANDARD_GRAVITY})
_LARGEST_ACCELERATION = PlausibleRange(15.0, 1e5, {"in standard gravities": STANDARD_GRAVITY})
_SAMPLE_AGE = PlausibleRange(1e-4, 0.1, {"in ms": 1e-3})
_DELAY = PlausibleRange(1e-7, 0.02, {"in ms": 1e-3, "in us": 1e-6})
_LIMIT = PlausibleRange(0.05, 0.9, {"in percent": 0.01})
GRAVITY = PlausibleRange(1.5, 25.0, {"in mm/s^2": 1e-3, "in standard gravities": STANDARD_GRAVITY}, or_zero=True)


class TubeFile(FrozenModel):
    """A round tube."""

    outer_diameter: Annotated[Quantity, measured("m")]
    inner_diameter: Annotated[Quantity, measured("m")]
    modulus: Annotated[Quantity, measured("Pa")]
    density: Annotated[Quantity, measured("kg/m^3")]

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        inner, outer = self.inner_diameter.number, self.outer_diameter.number
        if not 0.0 <= inner < outer:
            expected = f"0 to less than {outer:g} m, the outer"
            raise EntryError(f"inner_diameter {inner:g} m", key=("inner_diameter",), expected=expected)
        _DIAMETER.check("outer_diameter", self.outer_diameter)
        _MODULUS.check("modulus", self.modulus)
        _DENSITY.check("density", self.density)
        return self


class PlateFile(FrozenModel):
    """A plate of a POSOR on the beam: its mass and its distance from the beam's start."""

    name: str
    at: Annotated[Quantity, measured("m")]
    mass: Annotated[Quantity, measured("kg")]

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        _MASS.check("mass", self.mass)
        return self


class SagFile(FrozenModel):
    """Causes of the sag: tube, plates and gimbals of the beam.

    ``uncertainty`` is the relative standard uncertainty of the sag computed from them.
    """

    tube: TubeFile
    gimbals: Annotated[Quantity, measured("m", 2)]
    plates: tuple[PlateFile, ...] = ()
    uncertainty: Annotated[Quantity, measured("1")]

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        near, far = self.gimbals.array
        if not near < far:
            raise EntryError(
                f"gimbals {self.gimbals.value} m", key=("gimbals",), expected="two distances, the nearer one first"
            )
        _SHARE.check("uncertainty", self.uncertainty)
        return self


class PlacementFile(FrozenModel):
    """Standard uncertainties of the beam's end relative to its start, axes of the start; the values are in the URDF."""

    position: Annotated[Quantity, measured("m", 3)]
    orientation: Annotated[Quantity, measured("rad", 3)]

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        _POSITION.check("position", self.position)
        _ORIENTATION.check("orientation", self.orientation)
        return self


class GradientFile(FrozenModel):
    """Standard uncertainties of differences of the temperature within a beam.

    ``along``: between the mean of the beam and its thermometer; it stretches the beam. ``across``: between opposite
    sides, ``width`` apart, in each of two directions across the beam; it bends the beam.
    """

    along: Annotated[Quantity, measured("K")] = Quantity(value=0.0, unit="K")
    across: Annotated[Quantity, measured("K")] = Quantity(value=0.0, unit="K")
    width: Annotated[Quantity, measured("m")] | None = None  # default: outer diameter of the tube in ``sag``

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        _KELVINS.check("along", self.along)
        _KELVINS.check("across", self.across)
        if self.width is not None:
            _DIAMETER.check("width", self.width)
        return self


class NeighbourFile(FrozenModel):
    """Another thermometer, whose readings differ by at most ``difference`` while both are sound."""

    name: str
    difference: Annotated[Quantity, measured("K")]

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        _KELVINS.check("difference", self.difference)
        return self


class ThermometerFile(FrozenModel):
    """A thermometer of a beam or a plate; ``name`` is the last part of its topic."""

    name: str
    uncertainty: Annotated[Quantity, measured("K")]  # standard uncertainty of a reading, common to all readings
    range: Annotated[Quantity, measured("K", 2)]  # of plausible readings
    rate: Annotated[Quantity, measured("K/s")]  # largest rate of change
    age: Annotated[Quantity, measured("s")]  # largest age of a reading in use
    neighbour: NeighbourFile | None = None

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        if not is_ros_name(self.name):
            raise EntryError(f"name '{self.name}'", key=("name",), expected=ROS_NAME_RULE)
        for name, limits in (("range", TEMPERATURE), ("rate", _RATE), ("age", _AGE), ("uncertainty", _KELVINS)):
            limits.check(name, getattr(self, name))
        least, most = self.range.array
        if not least < most:
            what, expected = f"range {self.range.value} K", "two temperatures, the lower first"
            raise EntryError(what, key=("range",), expected=expected)
        return self


class BeamThermometerFile(ThermometerFile):
    """The thermometer of a beam."""

    reference: Annotated[Quantity, measured("K")]  # temperature at which the URDF holds

    @model_validator(mode="after")
    def _check_reference(self) -> Self:
        TEMPERATURE.check("reference", self.reference)
        least, most = self.range.array
        if not least < self.reference.number < most:
            what, expected = f"range {self.range.value} K", "two temperatures, the reference between them"
            raise EntryError(what, key=("range",), expected=expected)
        return self


class TemperatureFile(FrozenModel):
    """Linear expansion of the beam, and what is known of the beam's temperature.

    ``coefficient``: its amount, with its standard uncertainty ``sigma``, which a thermometer needs; ``deviation``:
    largest deviation from the temperature of the URDF; ``spread``: standard uncertainty of the temperature while no
    thermometer can be used, beside shared terms.
    """

    coefficient: Annotated[Quantity, measured("1/K")]
    deviation: Annotated[Quantity, measured("K")]
    spread: Annotated[Quantity, measured("K")] | None = None
    gradient: GradientFile | None = None
    thermometer: BeamThermometerFile | None = None

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        _EXPANSION.check("coefficient", self.coefficient)
        _DEVIATION.check("deviation", self.deviation)
        if self.spread is not None:
            _KELVINS.check("spread", self.spread)
        elif self.thermometer is not None:
            expected = "'spread', with which the beam is measured while its thermometer cannot be used"
            raise EntryError("a thermometer without 'spread'", key=("thermometer",), expected=expected)
        return self


class AccelerometersFile(FrozenModel):
    """Two accelerometers on the link, one at each gimbal of its beam, in the axes of the beam's start.

    ``names`` are the last parts of their topics, that of the nearer gimbal first.
    """

    names: Annotated[tuple[str, ...], Field(min_length=2, max_length=2)]
    uncertainty: Annotated[Quantity, measured("m/s^2")]  # standard uncertainty of a reading, bias and noise
    delay: Annotated[Quantity, measured("s")]  # standard uncertainty of the time of a reading, the sensor's filter too
    range: Annotated[Quantity, measured("m/s^2")]  # largest plausible amount along an axis
    age: Annotated[Quantity, measured("s")]  # largest age of a reading in use, and time between two readings

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        for index, name in enumerate(self.names):
            if not is_ros_name(name):
                raise EntryError(f"name '{name}'", key=("names", index), expected=ROS_NAME_RULE)
        _ACCELERATION.check("uncertainty", self.uncertainty)
        _DELAY.check("delay", self.delay)
        _LARGEST_ACCELERATION.check("range", self.range)
        _SAMPLE_AGE.check("age", self.age)
        return self


class VibrationFile(FrozenModel):
    """How the beam follows the vibration of its link: as an oscillator with its first natural frequency.

    ``frequency``: on its gimbals, with its standard uncertainty ``sigma``; ``damping``: share of the critical one;
    ``uncertainty``: relative standard uncertainty of what the oscillator adds to the sag under the acceleration of the
    moment; ``limit``: largest share of the natural frequency at which the oscillator is used; ``spread``: standard
    uncertainty of the acceleration while the accelerometers cannot be used.
    """

    frequency: Annotated[Quantity, measured("Hz")]
    damping: Annotated[Quantity, measured("1")]
    uncertainty: Annotated[Quantity, measured("1")]
    limit: Annotated[Quantity, measured("1")] = Quantity(value=0.45, unit="1")
    spread: Annotated[Quantity, measured("m/s^2")]
    accelerometers: AccelerometersFile

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        _FREQUENCY.check("frequency", self.frequency)
        if not 0.0 < float(self.frequency.sigmas) <= 0.2 * self.frequency.number:
            expected = f"more than 0 to {0.2 * self.frequency.number:g} Hz, its standard uncertainty"
            raise EntryError(
                f"sigma {float(self.frequency.sigmas):g} Hz", key=("frequency", "sigma"), expected=expected
            )
        _DAMPING.check("damping", self.damping)
        _SHARE.check("uncertainty", self.uncertainty)
        _LIMIT.check("limit", self.limit)
        _ACCELERATION.check("spread", self.spread)
        age, fastest = self.accelerometers.age.number, self.limit.number * self.frequency.number
        if age > 0.5 / fastest:
            shown = f"a vibration of {fastest:.4g} Hz, at 'limit'"
            expected = f"at most {0.5 / fastest:.3g} s: slower readings do not show {shown}"
            raise EntryError(f"age {age:g} s", key=("accelerometers", "age"), expected=expected)
        return self


class BeamFile(FrozenModel):
    """One beam; the origin of the fixed URDF joint ``joint`` is its transform at the temperature of the URDF.

    Without ``temperature`` the beam keeps its length; without ``vibration`` its sag is that of a beam that follows at
    once.
    """

    joint: str
    uncertainty: PlacementFile
    sag: SagFile | None = None
    temperature: TemperatureFile | None = None
    vibration: VibrationFile | None = None

    @model_validator(mode="after")
    def _check_vibration(self) -> Self:
        if self.vibration is not None and self.sag is None:
            raise EntryError("'vibration' without 'sag'", key=("vibration",), expected="'sag', which vibration changes")
        return self

    @model_validator(mode="after")
    def _check_width(self) -> Self:
        gradient = None if self.temperature is None else self.temperature.gradient
        if gradient is not None and gradient.across.number and self.width is None:
            key = ("temperature", "gradient")
            raise EntryError("'across' without 'width'", key=key, expected="'width', as the beam has no tube in 'sag'")
        return self

    @property
    def width(self) -> Quantity | None:
        """Distance [m] of opposite sides between which the temperature differs; None: it is not stated."""
        stated = self.temperature and self.temperature.gradient and self.temperature.gradient.width
        return stated or (None if self.sag is None else self.sag.tube.outer_diameter)

    @property
    def thermometer(self) -> BeamThermometerFile | None:
        """The thermometer; None: the beam has no thermometer."""
        return None if self.temperature is None else self.temperature.thermometer


class PlateThermometerFile(FrozenModel):
    """The thermometer of the receiving plate of the POSOR ``joint``: ``temperature`` of its scans."""

    joint: str
    thermometer: ThermometerFile
