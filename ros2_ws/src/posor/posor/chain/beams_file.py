"""The beams file, version 2: uncertainty, sag and temperature of an arm's beams, whose transforms are in the URDF.

Versions of the format:

1. First version: ``gravity`` and ``beams``, each with ``uncertainty`` and, where it sags, ``sag``. Still read.
2. ``temperature`` of a beam: coefficient of expansion, and largest deviation from the temperature of the URDF;
   ``shared``: errors that several beams share, also with calibrations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from posor.calibration.calibration_file import Provenance
from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.quantity import Quantity, measured
from posor.calibration.shared_terms import SharedQuantity, SharedTerm, check_shared_terms
from posor.calibration.yaml_document import parse_document, read_text

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

FILE_KIND = "beams file"
VERSION = 2
FORMER_VERSIONS = (1,)
STANDARD_GRAVITY = 9.80665  # [m/s^2] (ISO 80000-3)


@dataclass(frozen=True)
class _Range:
    """Plausible amounts of a quantity in its SI unit: a value beyond is usually one of another unit."""

    least: float
    most: float
    causes: Mapping[str, float]  # likely causes of a value beyond, and by what each multiplies the value to correct it
    or_zero: bool = False

    def check(self, name: str, quantity: Quantity) -> None:
        """Raise EntryError if a number of a quantity, whose key is its name, is out of range."""
        for value in np.ravel(quantity.array):
            if not (self.least <= value <= self.most or (self.or_zero and value == 0.0)):
                fitting = [cause for cause, factor in self.causes.items() if self.least < value * factor <= self.most]
                question = f" ({' or '.join(fitting)}?)" if fitting else ""
                expected = f"{'0 or ' if self.or_zero else ''}{self.least:g} to {self.most:g} {quantity.unit}{question}"
                raise EntryError(f"{name} {value:g} {quantity.unit}", key=(name,), expected=expected)


_DIAMETER = _Range(1e-3, 1.0, {"in mm": 1e-3, "in inches": 0.0254})
_MODULUS = _Range(1e8, 1.5e12, {"in GPa": 1e9, "in MPa": 1e6, "in psi": 6894.76})  # of plastics to that of diamond
_DENSITY = _Range(10.0, 23e3, {"in g/cm^3": 1e3})  # of foams to that of osmium
_MASS = _Range(0.0, 200.0, {"in g": 1e-3})
_EXPANSION = _Range(1e-10, 1e-3, {"in um/m/K": 1e-6}, or_zero=True)
_DEVIATION = _Range(0.0, 150.0, {"the temperature itself": 0.1})
_POSITION = _Range(0.0, 0.1, {"in um": 1e-6, "in mm": 1e-3})
_ORIENTATION = _Range(0.0, 0.2, {"in urad": 1e-6, "in arcseconds": 4.848e-6, "in degrees": 0.01745})
_SHARE = _Range(0.0, 1.0, {"in percent": 0.01})
_GRAVITY = _Range(1.5, 25.0, {"in mm/s^2": 1e-3, "in standard gravities": STANDARD_GRAVITY}, or_zero=True)


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


class TemperatureFile(FrozenModel):
    """Amounts of the linear expansion of the beam, and of the largest deviation from the temperature of the URDF."""

    coefficient: Annotated[Quantity, measured("1/K")]
    deviation: Annotated[Quantity, measured("K")]

    @model_validator(mode="after")
    def _check_values(self) -> Self:
        _EXPANSION.check("coefficient", self.coefficient)
        _DEVIATION.check("deviation", self.deviation)
        return self


class BeamFile(FrozenModel):
    """One beam; the origin of the fixed URDF joint ``joint`` is its transform at the temperature of the URDF.

    Without ``temperature`` the beam keeps its length.
    """

    joint: str
    uncertainty: PlacementFile
    sag: SagFile | None = None
    temperature: TemperatureFile | None = None


class BeamsFile(FrozenModel):
    """Content of a beams file. ``gravity`` is in the base frame of the URDF; default: along -Z."""

    format: Literal["posor_beams"]
    version: Literal[1, 2]
    name: str
    provenance: Provenance
    gravity: Annotated[Quantity, measured("m/s^2", 3)] = Quantity(value=[0.0, 0.0, -STANDARD_GRAVITY], unit="m/s^2")
    beams: Annotated[list[BeamFile], Field(min_length=1)]
    shared: dict[str, SharedTerm] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check_gravity(self) -> Self:
        amount = Quantity(value=float(np.linalg.norm(self.gravity.array)), unit=self.gravity.unit)
        _GRAVITY.check("gravity", amount)
        return self

    @model_validator(mode="after")
    def _check_version(self) -> Self:
        if self.shared and self.version < VERSION:
            what = f"shared in a file of version {self.version}"
            raise EntryError(what, key=("shared",), expected=f"version {VERSION}")
        for index, beam in enumerate(self.beams):
            if beam.temperature is not None and self.version < VERSION:
                what, key = f"temperature in a file of version {self.version}", ("beams", index, "temperature")
                raise EntryError(what, key=key, expected=f"version {VERSION}")
        return self

    @model_validator(mode="after")
    def _check_duplicates(self) -> Self:
        seen: set[str] = set()
        for index, beam in enumerate(self.beams):
            if beam.joint in seen:
                raise EntryError(f"duplicate beam '{beam.joint}'", key=("beams", index), expected="each beam once")
            seen.add(beam.joint)
        return self

    @model_validator(mode="after")
    def _check_shared(self) -> Self:
        """Check the terms: they may change ``position``, ``orientation`` and ``sag`` of a beam, after its name."""
        positions = {f"{beam.joint}.position": SharedQuantity("m", (3,)) for beam in self.beams}
        orientations = {f"{beam.joint}.orientation": SharedQuantity("rad", (3,)) for beam in self.beams}
        sags = {f"{beam.joint}.sag": SharedQuantity("1", ()) for beam in self.beams if beam.sag is not None}
        check_shared_terms(self.shared, positions | sags, positions | orientations)
        return self


def load_beams(path: Path) -> BeamsFile:
    """Read and validate a beams file (YAML, SI).

    Raises CalibrationError: the file cannot be read, is not YAML, or has invalid content.
    """
    keys = "format, version, name, provenance, beams"
    text, versions = read_text(path, FILE_KIND), (*FORMER_VERSIONS, VERSION)
    return parse_document(text, str(path), keys, versions, BeamsFile.model_validate)[0]
