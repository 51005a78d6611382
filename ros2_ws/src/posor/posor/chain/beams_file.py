# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The beams file, version 4: uncertainty, sag, temperature and vibration of an arm's beams.

The transforms of the beams are in the URDF.

Versions of the format:

1. First version: ``gravity`` and ``beams``, each with ``uncertainty`` and, where it sags, ``sag``. Still read.
2. ``temperature`` of a beam: coefficient of expansion, and largest deviation from the temperature of the URDF;
   ``shared``: errors that several beams share, also with calibrations. Still read.
3. ``spread``, ``gradient`` and ``thermometer`` in the ``temperature`` of a beam; ``plates``: thermometers of plates.
   Still read.
4. ``vibration`` of a beam: its first natural frequency, and its accelerometers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from posor.calibration.calibration_file import Provenance
from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.quantity import Quantity, measured
from posor.calibration.shared_terms import SharedQuantity, SharedTerm, check_shared_terms
from posor.calibration.yaml_document import parse_document, read_text
from posor.chain.beam_entries import GRAVITY, STANDARD_GRAVITY, BeamFile, PlateThermometerFile, ThermometerFile

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

FILE_KIND = "beams file"
VERSION = 4
FORMER_VERSIONS = (1, 2, 3)
SHARED_VERSION = 2  # the first with ``shared`` and ``temperature``
THERMOMETER_VERSION = 3  # the first with ``spread``, ``gradient`` and ``thermometer``


class BeamsFile(FrozenModel):
    """Content of a beams file. ``gravity`` is in the base frame of the URDF; default: along -Z."""

    format: Literal["posor_beams"]
    version: Literal[1, 2, 3, 4]
    name: str
    provenance: Provenance
    gravity: Annotated[Quantity, measured("m/s^2", 3)] = Quantity(value=[0.0, 0.0, -STANDARD_GRAVITY], unit="m/s^2")
    beams: Annotated[list[BeamFile], Field(min_length=1)]
    shared: dict[str, SharedTerm] = Field(default_factory=dict)
    plates: tuple[PlateThermometerFile, ...] = ()

    @model_validator(mode="after")
    def _check_gravity(self) -> Self:
        amount = Quantity(value=float(np.linalg.norm(self.gravity.array)), unit=self.gravity.unit)
        GRAVITY.check("gravity", amount)
        return self

    @model_validator(mode="after")
    def _check_version(self) -> Self:
        found: list[tuple[int, tuple[str | int, ...]]] = [(SHARED_VERSION, ("shared",))] if self.shared else []
        found += [(THERMOMETER_VERSION, ("plates",))] if self.plates else []
        for index, beam in enumerate(self.beams):
            if beam.temperature is not None:
                at = ("beams", index, "temperature")
                newer = [key for key in ("spread", "gradient", "thermometer") if getattr(beam.temperature, key)]
                found += [(SHARED_VERSION, at), *((THERMOMETER_VERSION, (*at, key)) for key in newer)]
            if beam.vibration is not None:
                found.append((VERSION, ("beams", index, "vibration")))
        for version, key in found:
            if self.version < version:
                what = f"{key[-1]} in a file of version {self.version}"
                raise EntryError(what, key=key, expected=f"version {version}")
        return self

    @model_validator(mode="after")
    def _check_thermometers(self) -> Self:
        """Check that no two thermometers have one name, and that each neighbour is another one."""
        found: list[tuple[tuple[str | int, ...], ThermometerFile]] = [
            (("beams", n, "temperature", "thermometer"), beam.thermometer)
            for n, beam in enumerate(self.beams)
            if beam.thermometer is not None
        ]
        found += [(("plates", n, "thermometer"), plate.thermometer) for n, plate in enumerate(self.plates)]
        names = [thermometer.name for _, thermometer in found]
        for key, thermometer in found:
            neighbour = thermometer.neighbour
            if names.count(thermometer.name) > 1:
                what = f"two thermometers have the name '{thermometer.name}'"
                raise EntryError(what, key=(*key, "name"), expected="a name, and a topic, for each")
            others = [name for name in names if name != thermometer.name]
            if neighbour is not None and neighbour.name not in others:
                expected = f"another thermometer: {', '.join(others) or 'there is none'}"
                raise EntryError(f"'{neighbour.name}'", key=(*key, "neighbour", "name"), expected=expected)
        return self

    @model_validator(mode="after")
    def _check_accelerometers(self) -> Self:
        """Check that no two accelerometers have one name."""
        seen: set[str] = set()
        for index, beam in enumerate(self.beams):
            for place, name in enumerate(() if beam.vibration is None else beam.vibration.accelerometers.names):
                if name in seen:
                    key = ("beams", index, "vibration", "accelerometers", "names", place)
                    what = f"two accelerometers have the name '{name}'"
                    raise EntryError(what, key=key, expected="a name, and a topic, for each")
                seen.add(name)
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
        """Check the terms: they may change ``position``, ``orientation`` and ``sag`` of a beam, after its name.

        They may also change ``coefficient`` and ``temperature`` of a beam with them, and readings of its
        ``thermometer``.
        """

        def of(key: str, unit: str, shape: tuple[int, ...], beams: Iterable[BeamFile]) -> dict[str, SharedQuantity]:
            return {f"{beam.joint}.{key}": SharedQuantity(unit, shape) for beam in beams}

        warm = [beam for beam in self.beams if beam.temperature is not None]
        measured_ones = [beam for beam in self.beams if beam.thermometer is not None]
        positions = of("position", "m", (3,), self.beams)
        sags = of("sag", "1", (), [beam for beam in self.beams if beam.sag is not None])
        orientations = of("orientation", "rad", (3,), self.beams)
        kelvins = of("temperature", "K", (), warm) | of("thermometer", "K", (), measured_ones)
        relative = positions | sags | of("coefficient", "1/K", (), measured_ones)
        check_shared_terms(self.shared, relative, positions | orientations | kelvins)
        return self


def load_beams(path: Path) -> BeamsFile:
    """Read and validate a beams file (YAML, SI).

    Raises CalibrationError: the file cannot be read, is not YAML, or has invalid content.
    """
    keys = "format, version, name, provenance, beams"
    text, versions = read_text(path, FILE_KIND), (*FORMER_VERSIONS, VERSION)
    return parse_document(text, str(path), keys, versions, BeamsFile.model_validate)[0]
