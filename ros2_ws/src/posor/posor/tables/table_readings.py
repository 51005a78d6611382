# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The readings of a table by its map: scans of each joint, and references."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from posor.calibration.calibration_file import load_calibration
from posor.errors import CalibrationError, DataFileError, ParameterError, checked_path
from posor.model.scan import NO_SOURCE
from posor.sensors.base import READING_KINDS
from posor.tables.channel_ranges import channels_of, compared_values, light_sources, likely_unit
from posor.tables.joint_scans import JointColumns
from posor.tables.row_selection import RowSelection
from posor.tables.table_file import open_table
from posor.tables.table_map import FLAGS, READINGS, ColumnEntry, load_table_map, may_share_column
from posor.tables.table_time import parse_zone, start_ns, times_at_rate, times_of_numbers, times_of_texts
from posor.tables.table_units import find_unit, unknown_unit_in_name

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray
    from posor.tables.channel_ranges import Channel
    from posor.tables.raw_table import Cells, RawTable
    from posor.tables.table_map import Flag, FlagEntry, JointMap, Key, LoadedMap, ReferenceMap, TableMap

_MOST_RATE_ERROR = 1e-3
"""Largest relative difference between the rate of a map and that of the file."""
_MOST_TEXTS = 5  # of a column that a note quotes
ROUNDING = 1e-3  # of angles of a whole turn [rad]


@dataclass(frozen=True)
class JointReadings:
    """The scans of a joint."""

    scans: Scans
    frame_id: str
    topic: str
    flagged: dict[Flag, int]  # number of scans with each flag of the map


@dataclass(frozen=True)
class ReferenceReadings:
    """The values of a reference at the times of the scans: the number, a point, or a pose x, y, z, qx, qy, qz, qw."""

    values: FloatArray  # SI, (n, k); NaN where missing
    angles: FloatArray | None  # of a pose whose map has angles, (n, 3) [rad]
    entry: ReferenceMap
    topic: str
    joint: str


@dataclass(frozen=True)
class TableReadings:
    """All that was read of a table, and what was not."""

    joints: dict[str, JointReadings]
    references: dict[str, ReferenceReadings]
    stamps_ns: IntArray  # of the rows, (n,)
    unused: tuple[str, ...]  # columns without use in the map
    left_out: dict[str, int]  # rows by kind
    notes: tuple[str, ...]  # sentences on what is suspicious but possible


def read_table(path: Path | str, table_map: Path | str, joint: str = "") -> Scans:
    """Return the scans of one joint from a table of another program: CSV, Parquet, TDMS or MATLAB.

    Args:
        path: The table.
        table_map: The map (YAML) that says which column is which reading.
        joint: Of the map; empty: the only one.

    Raises:
        CalibrationError: The map, or a calibration that it names, is invalid.
        DataFileError: The table cannot be read, or does not fit the map or the calibration.
        ParameterError: The map has no such joint, or the library of the format is not installed.

    """
    file = checked_path(path, "read_table", "the path of a table")
    readings = load_readings(file, checked_path(table_map, "read_table", "the path of a table map"))
    return readings.joints[only_joint(readings, joint, str(table_map))].scans


def only_joint(readings: TableReadings, joint: str, where: str) -> str:
    """Return the name of a joint, or of the only one. Raises ParameterError: it is missing, or there are several."""
    if not joint and len(readings.joints) == 1:
        return next(iter(readings.joints))
    if joint not in readings.joints:
        what = f"joint '{joint}' is not in the map" if joint else "the map has several joints"
        raise ParameterError(what, where=where, expected=f"one of {', '.join(readings.joints)}")
    return joint


def load_readings(path: Path, map_path: Path, *, growing: bool = False, needs_joints: bool = True) -> TableReadings:
    """Return the readings of a table by a map.

    ``growing``: see ``open_table``. ``needs_joints``: a map without joints is refused. Raises the errors of
    ``read_table``.
    """
    loaded = load_table_map(map_path)
    if needs_joints and not loaded.map.joints:
        raise CalibrationError("has no joints", where=str(map_path), expected="the readings of a joint")
    return _Reader(loaded, open_table(path, loaded.map.file, growing=growing)).read()


@dataclass
class _Reader:
    """A table that is being read."""

    loaded: LoadedMap
    table: RawTable
    notes: list[str] = field(default_factory=list)

    @property
    def map(self) -> TableMap:
        return self.loaded.map

    def read(self) -> TableReadings:
        table_map, table = self.map, self.table
        entries = {id(entry): self._index(entry.column, key) for key, _, entry in table_map.entries()}
        times = [self._index(column, ("time", "column")) for column in table_map.time.columns]
        number = [] if table_map.number is None else [self._index(table_map.number, ("number",))]
        flags = {
            (joint, flag): self._index(entry.column, ("joints", joint, "flags", flag, "column"))
            for joint, each in table_map.joints.items()
            for flag, entry in each.flags.items()
        }
        self._check_header_units(entries)
        calibrations = {name: self._calibration(name, joint) for name, joint in table_map.joints.items()}
        self._refuse_second_uses(entries, times, number)
        cells = table.read({*entries.values(), *number}, {*times, *flags.values()})
        if not (len(cells.places) or cells.incomplete):
            raise DataFileError("has no rows", where=str(table.path), expected="one row for each scan after the header")
        stamps = self._stamps(cells, times)
        optional = {
            id(entry)
            for reference in table_map.references.values()
            if reference.missing
            for _, _, entry in reference.entries()
        }
        required = {*number, *(column for id_, column in entries.items() if id_ not in optional)}
        selection = RowSelection(table, table_map, cells, stamps, times)
        keep = selection.select(required, {*entries.values(), *number})
        numbers = {id_: cells.numbers[column][keep] for id_, column in entries.items()}
        scan_numbers = self._scan_numbers(cells, keep, number)
        joints = {}
        for name, joint in table_map.joints.items():
            calibration = calibrations[name]
            columns = JointColumns(
                joint,
                numbers,
                {flag: cells.values[flags[name, flag]][keep] for flag in joint.flags},
                light_sources(calibration) if calibration else NO_SOURCE,
                partial(self._place, "joints", name),
            )
            joints[name] = self._joint(name, columns, stamps[keep], scan_numbers, calibration)
        first = next(iter(joints), "")
        references = {
            name: ReferenceReadings(
                *self._reference(name, each, numbers, cells.places[keep]),
                each,
                each.topic or f"/reference/{name}",
                each.joint or first,
            )
            for name, each in table_map.references.items()
        }
        used = {*entries.values(), *times, *number, *flags.values()}
        unused = tuple(column.name for n, column in enumerate(table.columns) if n not in used)
        return TableReadings(joints, references, stamps[keep], unused, dict(selection.left_out), tuple(self.notes))

    def _reference(
        self, name: str, entry: ReferenceMap, numbers: dict[int, FloatArray], places: IntArray
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return the values of a reference, and its angles [rad] if its orientation is stated by angles."""
        values = np.column_stack([each.reading(numbers[id(each)], si) for _, si, each in entry.entries()])
        if entry.angles is None or entry.order is None:
            return values, None
        angles = values[:, 3:]
        for row, column in np.argwhere(np.abs(angles) > 2.0 * math.pi + ROUNDING):
            what = f"angle {angles[row, column]:g} rad"
            index = self._index(entry.angles[column].column, ("references", name, "angles", int(column)))
            where = self.table.place(int(places[row]), index)
            raise DataFileError(what, where=where, expected="at most 2 pi rad (angles in degrees?)")
        whole = np.isfinite(angles).all(axis=1)
        quaternions = np.full((len(angles), 4), np.nan)
        if whole.any():
            quaternions[whole] = Rotation.from_euler(entry.order, angles[whole]).as_quat()
        return np.hstack([values[:, :3], quaternions]), angles

    def _place(self, *key: str | int) -> str:
        return self.loaded.locations.describe(*key)

    def _index(self, column: str | int, key: tuple[str | int, ...]) -> int:
        return self.table.index(column, self._place(*key))

    def _refuse_second_uses(self, entries: dict[int, int], times: list[int], number: list[int]) -> None:
        """Refuse a column that the map takes for two quantities, by whichever of its names."""
        users: dict[int, list[Key]] = {n: [("number",)] for n in number}
        users.update({n: [("time", "column")] for n in times})
        for key, _, entry in self.map.entries():
            column = entries[id(entry)]
            others = users.setdefault(column, [])
            if other := next((each for each in others if not may_share_column(key, each)), None):
                name, use = self.table.columns[column].name, self.loaded.locations.find(*other)[1]
                what = f"column '{name}' is used twice, also as {use}"
                where = self._place(*key, "column")
                raise CalibrationError(what, where=where, expected="a column of its own for each reading")
            others.append(key)

    def _check_header_units(self, entries: dict[int, int]) -> None:
        """Refuse a unit that contradicts the file's, and a rate that contradicts that of a channel."""
        time = self.map.time
        stated = [
            (key, entry.unit, entries[id(entry)]) for key, _, entry in self.map.entries() if not entry.header_unit
        ]
        if time.unit is not None and not time.header_unit:
            stated.append((("time",), time.unit, self._index(time.columns[0], ("time", "column"))))
        for key, name, index in stated:
            column = self.table.columns[index]
            unit = column.unit.name if column.unit else ""
            if (unit and not _same_unit(unit, name)) or column.unknown_unit:
                what = f"column '{column.name}' is in {unit or column.unknown_unit} by the file, in {name} by the map"
                expected = f"unit: {unit}" if unit else "a known unit in the file"
                expected += ", or header_unit: ignored if the file is wrong"
                raise DataFileError(what, where=self._place(*key, "unit"), expected=expected)
            if text := unknown_unit_in_name(column.name):
                note = f"'{text}' in the name of column '{column.name}' is not a known unit: the map says {name}"
                self.notes += [note] if note not in self.notes else []
            if time.rate is not None and column.interval_s is not None:
                rate = 1.0 / column.interval_s
                if abs(rate / time.rate.number - 1.0) > _MOST_RATE_ERROR:
                    what = f"rate {time.rate.number:g} Hz, but column '{column.name}' has {rate:g} Hz"
                    raise DataFileError(what, where=self._place("time", "rate"), expected=f"{rate:g} Hz")

    def _calibration(self, name: str, joint: JointMap) -> Calibration | None:
        """Return the calibration of a joint, whose channels the map has all."""
        if joint.calibration is None:
            self.notes.append(f"joint {name} is not compared with a calibration; add calibration: FILE.yaml to the map")
            return None
        calibration = load_calibration(self.loaded.path.parent / joint.calibration)
        where = self._place("joints", name, "calibration")
        if joint.frame_id not in (None, calibration.frames.parent):
            raise CalibrationError(
                f"frame_id '{joint.frame_id}'", where=where, expected=f"'{calibration.frames.parent}'"
            )
        channels = channels_of(calibration)
        for reading in READING_KINDS:
            names = [channel.name for channel in channels if channel.reading == reading]
            mapped = 4 * joint.diodes if reading == "diode_currents" else len(getattr(joint, reading))
            if mapped < len(names):
                what = f"{reading} of {', '.join(names[mapped:])} are missing"
                raise CalibrationError(
                    what, where=where, expected=f"{len(names)} columns, in the order of the calibration"
                )
            if mapped > len(names):
                expected = f"{len(names)}, those of the calibration"
                raise CalibrationError(f"there are {mapped} {reading}", where=where, expected=expected)
        for channel in channels:
            if not channel.required and getattr(joint, channel.reading) is None:
                self.notes.append(f"{channel.reading} of joint {name} is not mapped: its effect is not corrected")
        sources = light_sources(calibration)
        for n, lit in enumerate(joint.lit_sources):
            if isinstance(lit, int) and lit >= sources:
                where = self._place("joints", name, "lit_sources", n)
                raise CalibrationError(f"light source {lit}", where=where, expected=f"0 to {sources - 1}")
        return calibration

    def _stamps(self, cells: Cells, columns: list[int]) -> IntArray:
        """Return the time of each row [ns], MISSING_NS or INVALID_NS."""
        time = self.map.time
        first_ns = start_ns(time, self._place("time", "start")) if time.start else 0
        if time.rate is not None:
            return times_at_rate(time, cells.positions, first_ns)
        parts = [cells.values[n] for n in columns]
        if time.unit is not None:
            return times_of_numbers(parts[0], time, first_ns, self.map.file.decimal)
        zone = parse_zone(time.time_zone, self._place("time", "time_zone")) if time.time_zone else None
        joined = [" ".join(map(str, row)).strip() for row in zip(*parts, strict=True)]
        try:
            return times_of_texts(np.array(joined, dtype=object), time, zone)
        except LookupError as error:
            where = self.table.place(int(cells.places[int(error.args[0])]), columns[-1])
            text, expected = joined[int(error.args[0])], "time_zone of the map, such as UTC"
            what = f"'{text}' has no time zone"
            if zone is not None:
                what = f"summer time begins or ends in {time.time_zone} at '{text}', which is no time or two times"
                expected = "time_zone of the map as +01:00 or +02:00"
            raise DataFileError(what, where=where, expected=expected) from None

    def _scan_numbers(self, cells: Cells, keep: BoolArray, columns: list[int]) -> IntArray:
        """Return the number of each scan: that of its row, or of a column; both ascend."""
        if not columns:
            return cells.positions[keep] + 1
        values = cells.numbers[columns[0]][keep]
        bad = (values < 0) | (values != np.floor(values)) | (values > 2.0**53)
        bad[1:] |= values[1:] <= values[:-1]
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            where = self.table.place(int(cells.places[keep][row]), columns[0])
            before = f" after {values[row - 1]:g}" if row else ""
            raise DataFileError(f"scan number {values[row]:g}{before}", where=where, expected="ascending whole numbers")
        return values.astype(np.int64)

    def _joint(
        self, name: str, columns: JointColumns, stamps: IntArray, numbers: IntArray, calibration: Calibration | None
    ) -> JointReadings:
        joint, scans = columns.joint, columns.scans(stamps, numbers)
        for channel in channels_of(calibration) if calibration else ():
            if channel.required or getattr(joint, channel.reading) is not None:
                self._check_range(name, channel, scans)
        flagged = {flag: int(np.count_nonzero(scans.statuses & FLAGS[flag])) for flag in joint.flags}
        for flag in (flag for flag, count in flagged.items() if not count):
            self.notes.append(_unused_pattern(name, flag, joint.flags[flag], columns.texts[flag].tolist()))
        frame = joint.frame_id or (calibration.frames.parent if calibration else "")
        return JointReadings(scans, frame, joint.topic or f"/{self.map.name}/{name}/raw", flagged)

    def _check_range(self, name: str, channel: Channel, scans: Scans) -> None:
        """Refuse a channel whose values are all beyond the calibration, and name the likely unit."""
        values = compared_values(channel, scans)
        if not len(values):
            return
        beyond = (values < channel.lowest) | (values > channel.highest)
        kind = "sum of opposite currents" if channel.reading == "diode_currents" else "value"
        si = READINGS[channel.reading]
        text = f"{channel.lowest:g} to {channel.highest:g} {si}"
        if beyond.all():
            joint = self.map.joints[name]
            likely = _likely_unit(joint, channel, float(np.median(values)))
            what = f"every {kind} of {channel.name} is beyond its calibration, the first {values[0]:g} {si}"
            key = "diode_ratios" if joint.diode_ratios and channel.reading == "diode_currents" else channel.reading
            where = self._place("joints", name, key, channel.number)
            raise DataFileError(what, where=where, expected=f"{text}{likely}")
        if beyond.any():
            self.notes.append(
                f"{int(beyond.sum())} of {len(values)} {kind}s of {channel.name} are beyond its calibration, {text}"
            )


def _unused_pattern(joint: str, flag: Flag, entry: FlagEntry, cells: Sequence[object]) -> str:
    """Return a sentence on a flag whose pattern matches no cell, with the texts that there are."""
    texts = list(dict.fromkeys(repr(str(cell)) for cell in cells))
    more = f" and {len(texts) - _MOST_TEXTS} more" if len(texts) > _MOST_TEXTS else ""
    return (
        f"{flag} of joint {joint} is set in no scan: pattern '{entry.pattern}' is in no cell of column "
        f"'{entry.column}', which holds {', '.join(texts[:_MOST_TEXTS])}{more}"
    )


def _same_unit(one: str, other: str) -> bool:
    first, second = find_unit(one), find_unit(other)
    return one == other or (first is not None and second is not None and first[1:] == second[1:])


def _likely_unit(joint: JointMap, channel: Channel, value: float) -> str:
    """Return the unit in which a value would be within the range of a channel, as a question."""
    part: Any = getattr(joint, channel.reading)
    entry = part[channel.number] if isinstance(part, tuple) and part else part
    if not isinstance(entry, ColumnEntry) or entry.scale is not None:
        return ""
    unit = likely_unit((value - float(entry.column_unit.shift)) / float(entry.column_unit.factor), channel)
    return f"; unit: {unit}?" if unit else ""
