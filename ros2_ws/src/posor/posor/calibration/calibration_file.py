# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The calibration file of one POSOR, version 3.

Versions of the format:

1. First version: ``sensors`` by type, ``sessions``, ``tilt_angle``, ``motion``. Still read.
2. ``fits``: recording, method, residuals and covariances of fitted values.
3. ``environment``: valid ranges of supply and temperature; ``converter``: its steps; ``shared``: errors that several
    quantities share, also of other files; ``acceleration`` and ``travel`` of ``motion``; ``causes``: causes of faults
    and their bounds.
"""

from __future__ import annotations

import hashlib
import json
from enum import StrEnum
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeVar, Union

from pydantic import Field, PrivateAttr, SerializeAsAny, create_model, field_validator, model_validator

from posor.calibration.causes import Cause, check_causes
from posor.calibration.file_model import EntryError, FrozenModel, select_model_by_key
from posor.calibration.fit_record import FitRecord
from posor.calibration.parameter_entries import parameter_entries
from posor.calibration.plausible_range import ANY_FINITE, TEMPERATURE, PlausibleRange
from posor.calibration.quantity import Quantity, check_positive, measured
from posor.calibration.session import Session
from posor.calibration.shared_terms import SharedQuantity, SharedTerm, check_shared_terms
from posor.calibration.yaml_document import parse_document, read_text
from posor.errors import CalibrationError, FitError, checked_path
from posor.sensors.base import SensorCalibration
from posor.sensors.registry import sensor_types

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

FILE_KIND = "calibration file"
VERSION = 3
FORMER_VERSIONS = (1, 2)

SensorKind = TypeVar("SensorKind", bound=SensorCalibration)


class Provenance(FrozenModel):
    """Origin of the numbers."""

    source: str
    method: str
    date: str
    notes: tuple[str, ...] = ()


class Frames(FrozenModel):
    """Names of the two frames: ``parent`` is the receiving plate R, ``child`` the target plate T."""

    parent: str
    child: str

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        for name, frame in (("parent", self.parent), ("child", self.child)):
            if not frame.strip():
                raise EntryError(f"{name} is empty", key=(name,), expected="the name of a frame")
            if frame.startswith("/"):
                expected = f"'{frame.lstrip('/')}': tf2 refuses frames that begin with '/'"
                raise EntryError(f"{name} '{frame}'", key=(name,), expected=expected)
        if self.child == self.parent:
            raise EntryError(f"child '{self.child}' is also the parent", key=("child",), expected="two frames")
        return self


class Acceleration(FrozenModel):
    """Largest acceleration of the target relative to the receiving plate, as ``Motion``.

    Bounds the error of a pose whose stamp may be wrong (``estimation.time_errors``). The motion is not checked against
    the acceleration.
    """

    translation: Annotated[Quantity, measured("m/s^2")]
    lean: Annotated[Quantity, measured("rad/s^2")]
    theta: Annotated[Quantity, measured("rad/s^2")]


WIDEST_GAP, LARGEST_LEAN = 0.01, 0.05
"""Travel that no bearing of a joint has [m], [rad]: mm taken for m, or mrad for rad."""


class Travel(FrozenModel):
    """Poses of the target that the bearing of the joint permits; one beyond them is wrong, even if all readings agree.

    ``gap`` is the lowest and the highest translation along Z of the receiving plate, ``lean`` the largest inclination
    of the target's Z axis from that Z, in any direction.
    """

    gap: Annotated[Quantity, measured("m", 2)]
    lean: Annotated[Quantity, measured("rad")]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        low, high = self.gap.array
        if not 0.0 < high - low < WIDEST_GAP:
            expected = f"[lowest, highest], in m, less than {WIDEST_GAP:g} m from each other"
            raise EntryError(f"gap {self.gap.value}", key=("gap",), expected=expected)
        check_positive("lean", self.lean, below=LARGEST_LEAN)
        return self


class Motion(FrozenModel):
    """Limits of motion and travel of the target relative to the receiving plate.

    A pose further from the last one than the velocity allows, or beyond the ``travel``, is a fault. In directions that
    the readings do not determine, the last pose is used with an uncertainty that grows at this rate. ``translation``
    applies to X, Y and Z, ``lean`` to rotations about X and Y, ``theta`` to rotation about the target's Z.
    """

    translation: Annotated[Quantity, measured("m/s")]
    lean: Annotated[Quantity, measured("rad/s")]
    theta: Annotated[Quantity, measured("rad/s")]
    acceleration: Acceleration | None = None
    travel: Travel | None = None


class EnvironmentRange(FrozenModel):
    """What the probes' electronics or the receiving plate may have while the calibration is valid.

    ``range`` is the lowest and the highest value; ``spread`` the standard uncertainty of the value, about each probe's
    reference, in scans that do not measure it.
    """

    range: Quantity
    spread: Quantity

    @model_validator(mode="after")
    def _check_range(self) -> Self:
        low, high = self.range.array
        if not 0.0 <= low < high:
            raise EntryError(f"range {self.range.value}", key=("range",), expected="[lowest, highest], not negative")
        if self.spread.number < 0.0:
            raise EntryError(f"spread {self.spread.value}", key=("spread",), expected="zero or more")
        if self.spread.number > high - low:
            expected = f"at most the width of the range, {high - low:g} {self.spread.unit}"
            raise EntryError(f"spread {self.spread.value}", key=("spread",), expected=expected)
        return self


class SupplyRange(EnvironmentRange):
    """Supply voltage of the probe electronics."""

    range: Annotated[Quantity, measured("V", 2)]
    spread: Annotated[Quantity, measured("V")]


class TemperatureRange(EnvironmentRange):
    """Temperature of the receiving plate."""

    range: Annotated[Quantity, measured("K", 2)]
    spread: Annotated[Quantity, measured("K")]

    @model_validator(mode="after")
    def _check_unit(self) -> Self:
        TEMPERATURE.check("range", self.range)
        return self


class Environment(FrozenModel):
    """Valid ranges of what the probes' electronics are sensitive to; outside of them there is no pose."""

    supply: SupplyRange | None = None
    temperature: TemperatureRange | None = None


class Converter(FrozenModel):
    """Smallest difference between two readings of a channel that differ; zero: readings are not rounded.

    Readings with noise then rarely repeat, and repeated readings are a fault (``estimation.frozen``).
    """

    voltage: Annotated[Quantity, measured("V")]
    current: Annotated[Quantity, measured("A")]

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, step in (("voltage", self.voltage), ("current", self.current)):
            if step.number < 0.0:
                raise EntryError(f"{name} {step.value}", key=(name,), expected="zero or more")
        return self


class TiltAngle(StrEnum):
    """The theta by which directions fixed in the target (plane normal, rays) are turned.

    ``THIS_SCAN`` is exact. ``PREVIOUS_SCAN`` reproduces the tables printed in 1985: the program of thesis appendix 8A
    evaluated the tilt terms of each step at the theta of the step before.
    """

    THIS_SCAN = "this_scan"
    PREVIOUS_SCAN = "previous_scan"


class Calibration(FrozenModel):
    """Calibration of one POSOR."""

    format: Literal["posor_calibration"]
    version: Literal[1, 2, 3]
    name: str
    provenance: Provenance
    frames: Frames
    tilt_angle: TiltAngle = TiltAngle.THIS_SCAN
    motion: Motion | None = None
    environment: Environment | None = None
    converter: Converter | None = None
    shared: dict[str, SharedTerm] = Field(default_factory=dict)
    sensors: list[SerializeAsAny[SensorCalibration]]
    sessions: dict[str, Session] = Field(default_factory=dict)
    fits: list[FitRecord] = Field(default_factory=list)
    causes: list[Cause] = Field(default_factory=list)
    _session: str = PrivateAttr(default="")

    @field_validator("sessions")
    @classmethod
    def _check_session_names(cls, sessions: dict[str, Session]) -> dict[str, Session]:
        if "" in sessions:
            raise EntryError("a session has an empty name", expected="a name")
        return sessions

    @model_validator(mode="after")
    def _check_version(self) -> Self:
        if self.fits and self.version == 1:
            raise EntryError("fits in a file of version 1", key=("fits",), expected="version 2")
        for key in ("environment", "converter", "shared", "causes"):
            if getattr(self, key) and self.version < VERSION:
                what = f"{key} in a file of version {self.version}"
                raise EntryError(what, key=(key,), expected=f"version {VERSION}")
        check_causes(self.causes)
        for key in ("acceleration", "travel"):
            if getattr(self.motion, key, None) is not None and self.version < VERSION:
                what = f"{key} in a file of version {self.version}"
                raise EntryError(what, key=("motion", key), expected=f"version {VERSION}")
        return self

    @model_validator(mode="after")
    def _check_dark_scans(self) -> Self:
        for i, sensor in enumerate(self.sensors):
            if getattr(sensor, "ambient", None) is not None and self.motion is None:
                expected = "the key motion, which bounds the pose of a dark scan"
                raise EntryError("ambient without motion", key=("sensors", i, "ambient"), expected=expected)
        return self

    @model_validator(mode="after")
    def _check_references(self) -> Self:
        """Refuse a probe that was linearised outside of the range in which its calibration is valid."""
        probes = [
            (i, j, each) for i, own in enumerate(self.sensors) for j, each in enumerate(getattr(own, "probes", ()))
        ]
        for i, j, probe in probes:
            for name in ("supply", "temperature"):
                stated, valid = getattr(probe, name, None), getattr(self.environment, name, None)
                if stated is None or valid is None:
                    continue
                (low, high), value = valid.range.array, stated.reference.number
                if not low <= value <= high:
                    key = ("sensors", i, "probes", j, name, "reference")
                    expected = f"{low:g} to {high:g}, the range of 'environment'"
                    raise EntryError(f"reference {value:g} {stated.reference.unit}", key=key, expected=expected)
        return self

    @model_validator(mode="after")
    def _check_shared(self) -> Self:
        if self.shared:
            known: dict[str, SharedQuantity] = {}
            for entry in (each for name in ("", *self.sessions) for each in parameter_entries(self, name) if each):
                unit = entry.quantity.unit
                known[entry.key] = SharedQuantity(unit, entry.quantity.array.shape)
                known[entry.name] = known.get(entry.name, SharedQuantity(unit, ()))
            check_shared_terms(self.shared, known, known)
        return self

    def __repr__(self) -> str:
        """Return name, frames, sensors and session."""
        kinds = ", ".join(sensor.type for sensor in self.sensors)  # type: ignore[attr-defined]
        session = f", session '{self.session}'" if self.session else ""
        return f"<Calibration '{self.name}' from {self.frames.parent} to {self.frames.child}: {kinds}{session}>"

    __str__ = __repr__

    @property
    def content_hash(self) -> str:
        """SHA-256 of the content without layout and comments, 64 hexadecimal digits.

        A file keeps the hash that it had before later versions added keys.
        """
        content = self.model_dump(mode="json")
        for key in ("fits", "environment", "converter", "shared", "causes"):
            if not content[key]:
                del content[key]
        later = ((sensor, key) for sensor in content["sensors"] for key in ("ambient", "reference"))
        motion = content["motion"] or {}
        ambient_entries = [(sensor.get("ambient") or {}, "source_light") for sensor in content["sensors"]]
        for part, key in (*later, (motion, "acceleration"), (motion, "travel"), *ambient_entries):
            if key in part and part[key] is None:
                del part[key]
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    def plausible_environment(self) -> tuple[PlausibleRange, PlausibleRange]:
        """Return the supplies [V] and the temperatures [K] beyond which a scan has them in another unit.

        A supply is known by ``environment`` and the references of probes; without them it is not limited.
        """
        stated = None if self.environment is None else self.environment.supply
        volts = [] if stated is None else stated.range.array.tolist()
        probes = [probe for sensor in self.sensors for probe in getattr(sensor, "probes", ())]
        volts += [probe.supply.reference.number for probe in probes if getattr(probe, "supply", None) is not None]
        limits = [factor * each for each in volts for factor in (0.5, 2.0)] or ANY_FINITE
        return PlausibleRange(min(limits), max(limits), {"in mV": 1e-3}), TEMPERATURE

    @property
    def session(self) -> str:
        """Name of the applied session; empty: none."""
        return self._session

    def for_session(self, name: str) -> Self:
        """Return the calibration with the replacements of a session; an empty name returns it unchanged.

        Raises CalibrationError: the session is unknown, or does not fit the sensors.
        """
        if not name:
            return self
        if name not in self.sessions:
            known = ", ".join(self.sessions) or "an empty name; the file has no sessions"
            raise CalibrationError(f"session '{name}' is unknown", where=f"calibration '{self.name}'", expected=known)
        session = self.sessions[name]
        sensors = [sensor.for_session(session) for sensor in self.sensors]
        applied = self.model_copy(update={"sensors": sensors, "sessions": {name: session}})
        applied._session = name  # noqa: SLF001  a copy of the same class
        return applied


def load_calibration(path: Path | str) -> Calibration:
    """Read and validate a calibration file (YAML, SI).

    Raises:
        ParameterError: The argument is not a path.
        CalibrationError: The file cannot be read, is not YAML, or has invalid content.

    """
    file = checked_path(path, "load_calibration", "the path of a calibration file")
    return parse_calibration(read_text(file, FILE_KIND), str(file))


def parse_calibration(text: str, source: str) -> Calibration:
    """Validate the text of a calibration file as ``load_calibration`` does; ``source`` is its name in errors."""
    keys = "format, version, name, provenance, frames, sensors"
    return parse_document(text, source, keys, (*FORMER_VERSIONS, VERSION), calibration_from)[0]


def calibration_from(content: Mapping[str, Any]) -> Calibration:
    """Validate the content of a calibration file against all installed sensor types.

    Raises pydantic.ValidationError: the content is invalid; ``load_calibration`` turns this into one sentence.
    """
    return _calibration_with(tuple(sensor_types().items())).model_validate(content)


@lru_cache(maxsize=1)  # making a model takes a third of the time of a validation
def _calibration_with(named_types: tuple[tuple[str, type[SensorCalibration]], ...]) -> type[Calibration]:
    """Return the model of a calibration with sensors of these types."""
    types = dict(named_types)
    union: Any = Annotated[Union[tuple(types.values())], select_model_by_key("type", types)]  # noqa: UP007
    sensors: Any = (Annotated[list[union], Field(min_length=1)], ...)
    return create_model("Calibration", __base__=Calibration, sensors=sensors)


def find_sensor(calibration: Calibration, kind: type[SensorKind], what: str) -> tuple[int, SensorKind]:
    """Return the only sensor of a kind and its index among the calibration's sensors; ``what`` needs it.

    Raises FitError: there is none, or there are several.
    """
    found = [(i, sensor) for i, sensor in enumerate(calibration.sensors) if isinstance(sensor, kind)]
    if len(found) != 1:
        count, name = str(len(found) or "no"), kind.model_fields["type"].annotation.__args__[0]  # type: ignore[union-attr]
        message = f"calibration '{calibration.name}' has {count} sensors of the type {name}"
        raise FitError(message, where=what, expected="one")
    return found[0]
