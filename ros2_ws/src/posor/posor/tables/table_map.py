# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The map of a table: which of its columns are the readings of each joint, and how the file is read.

::

    format: posor_table_map
    version: 1
    name: rig                           # topics of the bag are /rig/<joint>/raw
    file: {separator: ";", decimal: ","}
    time: {column: "Time (s)", unit: s, start: 2026-11-25T10:00:00Z}
    joints:
      elbow:
        calibration: calibrations/elbow.yaml
        gap_voltages:
        - {column: "AI0 (mV)", unit: mV}

A reading is ``scale`` times the column plus ``offset``, as in an instruments file. Without ``scale``, ``unit`` is a
unit of the reading, and the value is converted to SI.
"""

from __future__ import annotations

import datetime as dt
import re
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, StrictInt, StrictStr, model_validator

from posor.calibration.file_model import EntryError, Expression, FrozenModel, Name, format_value
from posor.calibration.quantity import Quantity, measured
from posor.calibration.yaml_document import FileLocations, load_document
from posor.errors import similar_name
from posor.model.scan import DIODES_ESTIMATED, PROBES_ESTIMATED, SATURATED
from posor.tables.table_units import UNITS, Unit, find_unit, units_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from posor.numerics.array_types import FloatArray

KEYS = "format, version, name, time, joints"
VERSION = 1
FLAGS: dict[str, int] = {
    "probes_estimated": PROBES_ESTIMATED,
    "diodes_estimated": DIODES_ESTIMATED,
    "saturated": SATURATED,
}
"""Flags of ``posor_msgs/RawScan.status`` that a column may set."""
Flag = Literal["probes_estimated", "diodes_estimated", "saturated"]
LeftOut = Literal["missing_cells", "invalid_cells", "incomplete_rows", "time_back"]
Key = tuple[str | int, ...]


def _checked_unit(name: str) -> str:
    if find_unit(name) is None:
        known = [each for each in UNITS if each.isascii()]
        raise EntryError(f"unit '{name}' is unknown", expected=similar_name(name, known, f"one of {', '.join(known)}"))
    return name


ColumnName = Annotated[StrictStr, Field(min_length=1)] | Annotated[StrictInt, Field(ge=1)]
"""Name of a column, or its number from 1."""
TopicName = Annotated[str, Field(pattern=r"^(/[A-Za-z][A-Za-z0-9_]*)+$")]
UnitName = Annotated[StrictStr, AfterValidator(_checked_unit)]


class ColumnEntry(FrozenModel):
    """A column and what its numbers mean: ``scale`` times the number plus ``offset``."""

    column: ColumnName
    unit: UnitName
    scale: Quantity | None = None
    offset: Quantity | None = None
    header_unit: Literal["ignored"] | None = None
    """``ignored``: the unit in the header of the file is wrong."""

    @property
    def column_unit(self) -> Unit:
        """Unit of the column."""
        unit = find_unit(self.unit)
        assert unit is not None  # noqa: S101  validated
        return unit

    def conversion(self, si: str) -> tuple[float, float]:
        """Return factor and shift from the column's numbers to a reading in an SI unit.

        Raises:
            EntryError: The units do not fit.

        """
        unit = self.column_unit
        if self.scale is None:
            if unit.si != si:
                expected = (
                    f"one of {', '.join(units_of(si))}, or a scale such as {{value: 1.0, unit: {si}/{self.unit}}}"
                )
                raise EntryError(f"column '{self.column}' is in {self.unit}", key=("unit",), expected=expected)
            factor, shift = float(unit.factor), float(unit.shift)
        else:
            numerator, _, denominator = self.scale.unit.partition("/")
            of_scale = find_unit(numerator)
            if of_scale is None or of_scale.si != si or of_scale.shift or denominator != self.unit:
                expected = f"one number in {si}/{self.unit}"
                raise EntryError(f"scale in {self.scale.unit}", key=("scale", "unit"), expected=expected)
            factor, shift = self.scale.number * float(of_scale.factor), 0.0
        if self.offset is not None:
            of_offset = find_unit(self.offset.unit)
            if of_offset is None or of_offset.si != si or of_offset.shift:
                raise EntryError(
                    f"offset in {self.offset.unit}", key=("offset", "unit"), expected=f"one number in {si}"
                )
            shift += self.offset.number * float(of_offset.factor)
        return factor, shift

    def reading(self, numbers: FloatArray, si: str) -> FloatArray:
        """Return the reading [``si``] by the numbers of the column."""
        factor, shift = self.conversion(si)
        return numbers * factor + shift if shift else numbers * factor


class FlagEntry(FrozenModel):
    """A flag that is set where the text of a column contains a regular expression."""

    column: ColumnName
    pattern: Annotated[Expression, Field(min_length=1)]


class RatioEntry(FrozenModel):
    """A diode whose electronics give ratios: x = (A - C) / (A + C), y = (B - D) / (B + D), and A + B + C + D."""

    x: ColumnEntry
    y: ColumnEntry
    total: ColumnEntry | Annotated[Quantity, measured("A")]


LitSource = Annotated[int, Field(strict=True, ge=0, le=254)] | ColumnEntry
READINGS = {  # readings of a joint, and their SI units
    "gap_voltages": "V",
    "ring_voltages": "V",
    "diode_currents": "A",
    "lit_sources": "1",
    "home_mark": "1",
    "light": "1",
    "supply_voltage": "V",
    "temperature": "K",
    "reference_voltage": "V",
}


_STATES = {"lit_sources", "home_mark", "light"}  # of a scan
_ENVIRONMENT = {"supply_voltage", "temperature", "reference_voltage"}


def may_share_column(one: Key, other: Key) -> bool:
    """Return whether one column may be two entries of a map, by their locations.

    It may be several states, the same quantity of the environment of several joints, or of several references.
    """
    if {one[0], other[0]} == {"references"}:
        return one[1] != other[1]
    if {one[0], other[0]} != {"joints"}:
        return False
    readings = {one[2], other[2]}
    return readings <= _STATES or (len(readings) == 1 and readings <= _ENVIRONMENT)


class JointMap(FrozenModel):
    """Readings of a joint, in the order of its calibration file."""

    calibration: Annotated[str, Field(min_length=1)] | None = None
    """Path from the folder of the map; the readings are compared with it."""
    frame_id: Annotated[str, Field(min_length=1)] | None = None
    topic: TopicName | None = None
    gap_voltages: Annotated[tuple[ColumnEntry, ...], Field(max_length=8)] = ()
    ring_voltages: Annotated[tuple[ColumnEntry, ...], Field(max_length=8)] = ()
    diode_currents: Annotated[tuple[ColumnEntry, ...], Field(max_length=16)] = ()
    diode_ratios: Annotated[tuple[RatioEntry, ...], Field(max_length=4)] = ()
    lit_sources: Annotated[tuple[LitSource, ...], Field(max_length=4)] = ()
    home_mark: ColumnEntry | None = None
    light: ColumnEntry | None = None
    demodulated: bool = Field(default=False, strict=True)
    supply_voltage: ColumnEntry | None = None
    temperature: ColumnEntry | None = None
    reference_voltage: ColumnEntry | None = None
    flags: dict[Flag, FlagEntry] = Field(default_factory=dict)

    def entries(self) -> Iterator[tuple[Key, str, ColumnEntry]]:
        """Yield location in the joint, SI unit and entry of every column of numbers."""
        for name, si in READINGS.items():
            part: tuple[LitSource, ...] | ColumnEntry | None = getattr(self, name)
            if isinstance(part, ColumnEntry):
                yield (name,), si, part
            else:
                yield from (
                    ((name, n), si, entry) for n, entry in enumerate(part or ()) if isinstance(entry, ColumnEntry)
                )
        for n, diode in enumerate(self.diode_ratios):
            yield ("diode_ratios", n, "x"), "1", diode.x
            yield ("diode_ratios", n, "y"), "1", diode.y
            if isinstance(diode.total, ColumnEntry):
                yield ("diode_ratios", n, "total"), "A", diode.total

    @property
    def diodes(self) -> int:
        """Number of diodes."""
        return len(self.diode_ratios) or len(self.diode_currents) // 4

    @model_validator(mode="after")
    def _check_readings(self) -> Self:
        if self.calibration is None and self.frame_id is None:
            raise EntryError("neither calibration nor frame_id", expected="calibration, a path from the map's folder")
        if self.diode_currents and self.diode_ratios:
            raise EntryError("diode_currents and diode_ratios", key=("diode_ratios",), expected="one of them")
        if not (self.gap_voltages or self.ring_voltages or self.diodes):
            raise EntryError("no reading", expected=f"at least one of {', '.join(READINGS)}, diode_ratios")
        if len(self.diode_currents) % 4 or len(self.lit_sources) != self.diodes:
            diodes = (
                f"{len(self.diode_ratios)} diode ratios"
                if self.diode_ratios
                else f"{len(self.diode_currents)} diode currents"
            )
            what = f"{diodes} and {len(self.lit_sources)} lit sources"
            raise EntryError(what, key=("lit_sources",), expected="one source for the four currents of each diode")
        for name in ("light", "demodulated"):
            if getattr(self, name) and not self.diodes:
                raise EntryError(f"{name} without diode currents", key=(name,), expected="diode_currents")
        for key, si, entry in self.entries():
            _check_conversion(entry, si, key)
        return self


class ReferenceMap(FrozenModel):
    """A reference of a calibration: one number with its uncertainty, a point, or a pose."""

    joint: str | None = None
    """Whose driver publishes it; by default the first joint."""
    frame_id: Annotated[str, Field(min_length=1)]
    child_frame_id: Annotated[str, Field(min_length=1)] | None = None
    topic: TopicName | None = None
    reading: ColumnEntry | None = None
    standard_uncertainty: Quantity | None = None
    position: tuple[ColumnEntry, ColumnEntry, ColumnEntry] | None = None
    quaternion: tuple[ColumnEntry, ColumnEntry, ColumnEntry, ColumnEntry] | None = None
    """x, y, z, w."""
    angles: tuple[ColumnEntry, ColumnEntry, ColumnEntry] | None = None
    order: Annotated[str, Field(pattern=r"^([xyz]{3}|[XYZ]{3})$")] | None = None
    """Axes of the angles in the order of their turns: ``xyz`` fixed axes, ``ZYX`` axes that turn along."""
    missing: Literal["allowed"] | None = None
    """``allowed``: a row without a number has no reading of this reference."""

    @property
    def unit(self) -> str:
        """SI unit of the reading."""
        return "m" if self.standard_uncertainty is None else self.standard_uncertainty.unit

    def entries(self) -> Iterator[tuple[Key, str, ColumnEntry]]:
        """Yield location in the reference, SI unit and entry of every column."""
        if self.reading is not None:
            yield ("reading",), self.unit, self.reading
        for name, si in (("position", "m"), ("quaternion", "1"), ("angles", "rad")):
            yield from (((name, n), si, entry) for n, entry in enumerate(getattr(self, name) or ()))

    @model_validator(mode="after")
    def _check(self) -> Self:
        turned = [part for part in (self.quaternion, self.angles) if part is not None]
        if (self.reading is None) == (self.position is None) or len(turned) > (self.position is not None):
            expected = "reading, position, or position with quaternion or angles"
            raise EntryError("an unknown kind of reference", expected=expected)
        if (self.angles is None) != (self.order is None) or (
            self.order and any(a == b for a, b in pairwise(self.order))
        ):
            expected = "both, as order: xyz, in which no axis follows itself"
            raise EntryError("angles and order do not fit", key=("order",), expected=expected)
        if (self.reading is None) != (self.standard_uncertainty is None) or self.unit not in ("m", "rad"):
            expected = "reading with standard_uncertainty, in m or rad"
            raise EntryError("reading and standard_uncertainty do not fit", expected=expected)
        if bool(turned) != (self.child_frame_id is not None):
            what = f"{'angles' if self.angles else 'quaternion'} and child_frame_id do not fit"
            raise EntryError(what, expected="both, for a pose, or neither")
        for key, si, entry in self.entries():
            _check_conversion(entry, si, key)
        return self


def _check_conversion(entry: ColumnEntry, si: str, key: Key) -> None:
    try:
        entry.conversion(si)
    except EntryError as error:
        raise EntryError(error.what, key=(*key, *error.key), expected=error.expected) from None


class FileLayout(FrozenModel):
    """How a text file is read; other formats state this themselves."""

    separator: Literal[",", ";", "\t", "|", "tab", "space"] = ","
    decimal: Literal[".", ","] = "."
    encoding: str = "utf-8"
    """A byte order mark has precedence."""
    comment: str = "#"
    """Lines that begin with this text are left out; empty: none."""
    header_line: Annotated[int, Field(ge=0, strict=True)] | None = None
    """Line of the names of the columns; default: the first one that is no comment; 0: the columns have numbers only."""
    data_line: Annotated[int, Field(ge=1, strict=True)] | None = None
    """First line of data; default: the one after the header. Lines between may hold the units."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.data_line is not None and self.data_line <= (self.header_line or 0):
            raise EntryError(f"data_line {self.data_line}", key=("data_line",), expected="a line after header_line")
        try:
            "".encode(self.encoding)
        except LookupError:
            raise EntryError(f"encoding '{self.encoding}'", key=("encoding",), expected="such as cp1252") from None
        return self


def _as_text(value: object) -> object:
    """Return a time that YAML read as a date, as text."""
    return value.isoformat() if isinstance(value, dt.date) else value


_FORMATS = (  # a directive that strptime reads and ignores, the one that it needs, and what is right
    ("p", "I", "%I %p, hours from 1 to 12, or %H without %p"),
    ("I", "p", "%I %p, hours from 1 to 12, or %H"),
    ("Z", "", "%z for offsets such as +0100, or time_zone in the map and the name of the zone in place of %Z"),
)


class TimeMap(FrozenModel):
    """When each row was measured: a column of numbers or texts, or a rate."""

    column: ColumnName | Annotated[tuple[ColumnName, ...], Field(min_length=2)] | None = None
    """Several columns, such as date and time of day, are joined by a blank."""
    unit: UnitName | None = None
    format: Annotated[str, Field(min_length=1)] | None = None
    """``iso``, or a format of Python's ``strptime``, for a column of texts."""
    time_zone: Annotated[str, Field(min_length=1)] | None = None
    """Of texts without one: ``UTC``, ``+01:00`` or ``Europe/Berlin``."""
    header_unit: Literal["ignored"] | None = None
    """``ignored``: the unit in the header of the file is wrong."""
    start: Annotated[str, BeforeValidator(_as_text), Field(min_length=1)] | None = None
    """Time at zero of a column of numbers, or of the first row at a rate."""
    rate: Annotated[Quantity, measured("Hz")] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        ways = [self.rate is not None, self.unit is not None, self.format is not None]
        if sum(ways) != 1 or (self.column is None) != (self.rate is not None):
            expected = "rate, or column with unit (numbers), or column with format (texts)"
            raise EntryError("the time of a row does not follow", expected=expected)
        if self.unit is not None and (self.column_unit is None or self.column_unit.si != "s"):
            raise EntryError(f"unit '{self.unit}'", key=("unit",), expected=f"one of {', '.join(units_of('s'))}")
        if self.unit is not None and isinstance(self.column, tuple):
            raise EntryError("several columns of numbers", key=("column",), expected="one column")
        directives = set(re.findall(r"%(.)", self.format or ""))
        for wrong, needed, instead in _FORMATS:
            if wrong in directives and needed not in directives:
                what = f"format '{self.format}' has %{wrong}" + (f" without %{needed}" if needed else "")
                raise EntryError(what, key=("format",), expected=instead)
        if self.rate is not None and not self.rate.number > 0.0:
            raise EntryError(format_value(self.rate.value), key=("rate",), expected="more than 0 Hz")
        if (self.format is None) != (self.start is not None):
            what = "start is missing" if self.start is None else "start beside texts"
            raise EntryError(what, key=("start",), expected="the time of zero, such as 2026-11-25T10:00:00Z")
        return self

    @property
    def column_unit(self) -> Unit | None:
        """Unit of a column of numbers."""
        return None if self.unit is None else find_unit(self.unit)

    @property
    def columns(self) -> tuple[ColumnName, ...]:
        """The columns of the time."""
        if self.column is None:
            return ()
        return self.column if isinstance(self.column, tuple) else (self.column,)


class TableMap(FrozenModel):
    """A map."""

    format: Literal["posor_table_map"]
    version: Literal[1]
    name: Name
    file: FileLayout = FileLayout()
    time: TimeMap
    number: ColumnName | None = None
    """Column of the scan numbers; default: the number of the row, from 1."""
    leave_out: tuple[LeftOut, ...] = ()
    """Kinds of rows that are left out and counted; the file is refused for all others."""
    joints: dict[Name, JointMap] = Field(default_factory=dict)
    references: dict[Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")], ReferenceMap] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not (self.joints or self.references):
            raise EntryError("no joint", key=("joints",), expected="readings of a joint, or references")
        for name, reference in self.references.items():
            if reference.joint is not None and reference.joint not in self.joints:
                expected = f"one of {', '.join(self.joints)}"
                raise EntryError(f"joint '{reference.joint}'", key=("references", name, "joint"), expected=expected)
        return self

    def entries(self) -> Iterator[tuple[Key, str, ColumnEntry]]:
        """Yield location in the file, SI unit and entry of every column of numbers but time and number."""
        for part in ("joints", "references"):
            named: dict[str, JointMap | ReferenceMap] = getattr(self, part)
            for name, each in named.items():
                yield from (((part, name, *key), si, entry) for key, si, entry in each.entries())


@dataclass(frozen=True)
class LoadedMap:
    """A map with the places of its entries."""

    map: TableMap
    path: Path
    locations: FileLocations


def load_table_map(path: Path) -> LoadedMap:
    """Read and validate the map of a table (YAML).

    Raises:
        CalibrationError: The file cannot be read, is not YAML, or holds an invalid entry.

    """
    table_map, locations = load_document(path, "table map", KEYS, VERSION, TableMap.model_validate)
    return LoadedMap(table_map, path, locations)
