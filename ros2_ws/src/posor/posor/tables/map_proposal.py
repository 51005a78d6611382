# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Propose the map of a table from its header and the calibrations: a commented YAML file to be edited."""

from __future__ import annotations

import csv
import datetime as dt
import re
from collections import Counter
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.calibration.calibration_file import load_calibration
from posor.errors import DataFileError
from posor.sensors.base import READING_KINDS
from posor.sensors.diodes import CONTACT_LETTERS
from posor.tables.channel_ranges import channels_of, light_sources, likely_unit
from posor.tables.raw_table import is_number
from posor.tables.table_file import is_text, open_table, read_bytes
from posor.tables.table_map import READINGS, FileLayout
from posor.tables.table_time import parse_moment
from posor.tables.table_units import UNITS
from posor.tables.text_table import (
    are_names,
    byte_order_mark,
    lines_of,
    names_fit,
    strip_trailing_empty_cells,
    utf_16_without_mark,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from posor.numerics.array_types import FloatArray
    from posor.tables.channel_ranges import Channel
    from posor.tables.raw_table import RawTable

_SEPARATORS = (";", "\t", "|", ",")
_SAMPLE_LINES = 60
_TIME_NAME = re.compile(
    r"(?<![^\W_])(time|zeit|timestamp|elapsed|date|datum|uhrzeit|x_value|t)(?![^\W_])", re.IGNORECASE
)
_NAMES = {  # of columns by reading
    "supply_voltage": re.compile(r"supply|vcc|versorgung|excitation", re.IGNORECASE),
    "temperature": re.compile(r"temp", re.IGNORECASE),
}
_UNSURE = "?"
_DATE = re.compile(r"\d{4}-\d\d-\d\d")
_EXAMPLES = (
    "iso",
    "%d.%m.%Y %H:%M:%S",
    "%m/%d/%Y %H:%M:%S",
    "%d/%m/%Y %H:%M:%S",
    "%m/%d/%Y %I:%M:%S %p",
    "%Y/%m/%d %H:%M:%S",
)


class Proposal(NamedTuple):
    """A map as YAML text, and what in it is a guess."""

    text: str
    unsure: tuple[str, ...]


@dataclass
class _Draft:
    """A proposal that is being made."""

    table: RawTable
    numbers: dict[int, FloatArray]  # columns that hold numbers
    texts: dict[int, str]  # first cell of each column
    lines: list[str] = field(default_factory=list)
    unsure: list[str] = field(default_factory=list)
    used: set[int] = field(default_factory=set)

    def column(self, n: int) -> str:
        """Return a column as the map names it: its number where another one has its name."""
        names = [column.name for column in self.table.columns]
        return str(n + 1) if names.count(names[n]) > 1 or not names[n] else _quoted(names[n])

    def add(self, line: str, doubt: str = "") -> None:
        """Add a line; ``doubt``: why it is a guess."""
        self.lines.append(f"{line}    # unsure: {doubt}" if doubt else line)
        if doubt:
            self.unsure.append(f"{line.partition('  # ')[0].strip(' -')}: {doubt}")


def propose_map(path: Path, name: str, calibrations: dict[str, Path]) -> Proposal:
    """Return the map of a table; a guess is marked, and ``column: "?"`` stands where there is none.

    ``name``: of the arm; ``calibrations``: file of each joint. Raises DataFileError: the table cannot be read;
    CalibrationError: a calibration is invalid.
    """
    layout, doubts = guess_layout(path) if is_text(path) else (FileLayout(), dict[str, str]())
    table = open_table(path, layout)
    every = range(len(table.columns))
    cells = table.read(every, every)
    if cells.incomplete and not len(cells.places):
        place, what, expected = cells.incomplete[0]
        raise DataFileError(what, where=table.place(place), expected=expected)
    if not len(cells.places):
        raise DataFileError("has no rows", where=str(path), expected="one row for each scan after the header")
    bad = {cell.column: 0 for cell in cells.invalid}
    for cell in cells.invalid:
        bad[cell.column] += 1
    numbers = {
        n: cells.numbers[n]
        for n in every
        if 2 * (bad.get(n, 0) + int(np.isnan(cells.numbers[n]).sum())) < len(cells.places)
    }
    draft = _Draft(table, numbers, {n: str(cells.values[n][0]) for n in every})
    draft.add(f"# Map of {path.name}, proposed from its header; to be checked and completed.")
    draft.add(f"# `posor import {path} --map THIS.yaml --output BAG` makes the bag.")
    draft.add("format: posor_table_map")
    draft.add("version: 1")
    draft.add(f"name: {name}")
    stated = layout.model_dump(exclude_defaults=True)
    if stated:
        draft.add("file:")
        for key, value in stated.items():
            draft.add(f"  {key}: {_quoted(value) if isinstance(value, str) else value}", doubts.get(key, ""))
    _propose_time(draft, path)
    draft.add(
        "# leave_out: [missing_cells, invalid_cells, incomplete_rows, time_back]     # kinds of rows to be left out"
    )
    draft.add("joints:")
    for joint, calibration in calibrations.items():
        _propose_joint(draft, joint, calibration)
    left = [table.columns[n].name for n in every if n not in draft.used]
    if left:
        draft.add(f"# Columns without use: {', '.join(map(_quoted, left))}")
    return Proposal("\n".join(draft.lines) + "\n", tuple(draft.unsure))


def guess_layout(path: Path) -> tuple[FileLayout, dict[str, str]]:
    """Return how a text file is read, by its first lines, and the doubts by key."""
    data, doubts, encoding = read_bytes(path), dict[str, str](), "utf-8"
    mark = byte_order_mark(data)
    if not mark and b"\0" in data[:4096]:
        encoding = utf_16_without_mark(data[:4096]) or encoding
    elif not mark:
        try:
            data.decode("utf-8")
        except UnicodeDecodeError:
            encoding, doubts["encoding"] = "cp1252", "the file is not UTF-8; other encodings look alike"
    text = data.decode(mark or encoding, "replace")
    lines = list(islice(lines_of(text, FileLayout().comment), _SAMPLE_LINES))
    separator, decimal = max(_layouts(), key=lambda each: _score(lines, *each))
    header_line, data_line = _header_of(lines, separator, decimal)
    options: dict[str, object] = {
        "separator": "tab" if separator == "\t" else separator,
        "decimal": decimal,
        "encoding": encoding,
    }
    if header_line == 0 and (named := _names_behind_comment(text, data_line, separator)):
        header_line, doubts["header_line"] = named, "the names follow the sign of a comment"
    if header_line != (lines[0][0] if lines else 1):
        options["header_line"] = header_line
    if data_line != header_line + 1:
        options["data_line"] = data_line
    return FileLayout.model_validate(options), doubts


def _layouts() -> list[tuple[str, str]]:
    return [(separator, decimal) for separator in (*_SEPARATORS, "space") for decimal in ".,"]


def _cells(line: str, separator: str) -> list[str]:
    if separator == "space":
        return line.split()
    try:
        row = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:  # a text of 100 kB is no cell
        row = [line]
    return [cell.strip() for cell in row]


def _score(lines: Sequence[tuple[int, str]], separator: str, decimal: str) -> tuple[int, int]:
    """Return the number of numbers in rows as wide as most rows; for equal numbers, blanks come last."""
    rows = [_cells(line, separator) for _, line in lines]
    counts = [len(row) for row in rows]
    width = max(set(counts), key=counts.count) if counts else 0
    numbers = sum(is_number(cell, decimal) for row in rows if len(row) == width for cell in row) if width > 1 else 0
    return numbers, int(separator != "space")


def _header_of(lines: Sequence[tuple[int, str]], separator: str, decimal: str) -> tuple[int, int]:
    """Return the lines of the header (0: none) and of the first data."""
    rows = [(n, _cells(line, separator)) for n, line in lines]
    count = {n: sum(is_number(cell, decimal) for cell in row) for n, row in rows}
    numbers = Counter[int]()  # by width
    for n, row in rows:
        numbers[len(row)] += count[n]
    width = max(numbers, key=lambda each: (numbers[each], each), default=0)
    first = next((i for i, (n, row) in enumerate(rows) if len(row) == width and 2 * count[n] > width), None)
    if first is None:
        return 0, rows[-1][0] + 1 if rows else 1
    data = rows[first][1]
    while first and 2 * count[rows[first - 1][0]] > len(strip_trailing_empty_cells(rows[first - 1][1])):
        first -= 1  # a row of data with more or fewer cells, such as a comment or a separator at its end
    above = [(n, row) for n, row in rows[:first] if len(row) == width or names_fit(row, data)]
    if not above:
        return 0, rows[first][0]
    # names, then perhaps units: the names are the first of the rows directly above the data
    units = [n for n, row in above[1:] if sum(cell.strip("[]()") in UNITS or not cell for cell in row) * 2 > width]
    header = next((n for n, _ in reversed(above) if n not in units), above[0][0])
    return header, rows[first][0]


def _names_behind_comment(text: str, data_line: int, separator: str) -> int:
    """Return the number of the line right above the data if it is a comment that fits as names, as of numpy; else 0."""
    comment = FileLayout().comment
    rows = [(n, line) for n, line in islice(lines_of(text, ""), _SAMPLE_LINES) if n <= data_line]
    above = [(n, line) for n, line in rows[:-1] if line.startswith(comment)]
    if not above or rows[-1][0] != data_line:
        return 0
    number, line = above[-1]
    names = strip_trailing_empty_cells(_cells(line.removeprefix(comment), separator))
    return number if are_names(names) and names_fit(names, _cells(rows[-1][1], separator)) else 0


def _propose_time(draft: _Draft, path: Path) -> None:
    """Add the time: a column of texts, a column of numbers, the interval of the file, or a rate to be filled in."""
    date = _DATE.search(read_bytes(path)[:4096].decode("latin-1")) if is_text(path) else None
    moment = dt.datetime.fromtimestamp(path.stat().st_mtime, dt.UTC).replace(microsecond=0)
    start = f"{date[0]}T00:00:00Z" if date else moment.isoformat().replace("+00:00", "Z")
    doubt = (
        "the date in the file, but its time of day and zone are not known"
        if date
        else "the time at which the file was saved"
    )
    draft.add("time:")
    for n, text in draft.texts.items():
        for form in _EXAMPLES:
            try:
                parse_moment(text, form, dt.UTC)
            except ValueError:
                continue
            if n in draft.numbers and form == "iso":
                continue  # a number such as 20261125
            draft.used.add(n)
            draft.add(f"  column: {draft.column(n)}")
            ambiguous = form.startswith(("%d/", "%m/"))
            draft.add(f"  format: {_quoted(form)}", "day and month may be exchanged" if ambiguous else "")
            if not re.search(r"(Z|[+-]\d\d:\d\d)$", text):
                draft.add("  time_zone: UTC", "the texts have no time zone")
            return
    ascending = [
        n for n, column in draft.numbers.items() if len(column) > 1 and (np.diff(column[np.isfinite(column)]) > 0).all()
    ]
    names = {n: draft.table.columns[n] for n in ascending}
    found = [n for n, column in names.items() if column.unit is not None and column.unit.si == "s"]
    found += [n for n, column in names.items() if _TIME_NAME.search(column.name) and n not in found]
    if found:
        column = names[found[0]]
        draft.used.add(found[0])
        draft.add(f"  column: {draft.column(found[0])}")
        draft.add(
            f"  unit: {column.unit.name if column.unit else 's'}",
            "" if column.unit else "the header states no known unit",
        )
        first = draft.numbers[found[0]][0]
        if first > 1e8 and (column.unit is None or column.unit.name == "s"):  # noqa: PLR2004  three years
            draft.add("  start: 1970-01-01T00:00:00Z", "taken for seconds since 1970")
            return
        draft.add(f"  start: {start}", doubt)
        return
    interval = next((column.interval_s for column in draft.table.columns if column.interval_s), None)
    if interval:
        draft.add(f"  rate: {{value: {1.0 / interval:.12g}, unit: Hz}}")
    else:
        draft.add(f'  rate: {{value: "{_UNSURE}", unit: Hz}}', "no column of times: write the rate of its rows")
    draft.add(f"  start: {start}", doubt)


def _propose_joint(draft: _Draft, joint: str, path: Path) -> None:
    calibration = load_calibration(path)
    channels = channels_of(calibration)
    draft.add(f"  {joint}:")
    draft.add(f"    calibration: {_quoted(str(path.resolve()))}")
    for reading in READING_KINDS:
        of_reading = [channel for channel in channels if channel.reading == reading]
        if not of_reading:
            continue
        draft.add(f"    {reading}:")
        exact = {channel: _by_name(draft, joint, channel) for channel in of_reading}
        draft.used |= {n for n in exact.values() if n is not None}
        candidates = _candidates(draft, READINGS[reading])
        for channel in of_reading:
            n = exact[channel]
            doubt = "" if n is not None else "by the order of the columns only"
            if n is None and candidates:
                n = candidates.pop(0)
            _propose_column(draft, "    - ", channel, n, doubt)
        if reading == "diode_currents":
            diodes = len(of_reading) // len(CONTACT_LETTERS)
            sources = light_sources(calibration)
            lit = list(range(diodes)) if sources >= diodes else [0] * diodes
            doubt = "" if sources == diodes else f"which of the {sources} light sources each diode sees"
            draft.add(f"    lit_sources: {lit}", doubt)
    for reading, pattern in _NAMES.items():
        found = [n for n in draft.numbers if n not in draft.used and pattern.search(draft.table.columns[n].name)]
        known = next((each for each in channels if each.reading == reading), None)
        if found and known:
            _propose_column(draft, f"    {reading}: ", known, found[0], "by its name")
        elif known:
            draft.add(f"    # {reading}: no column found; without it, its effect is not corrected")


def _plain(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text.lower())


def _by_name(draft: _Draft, joint: str, channel: Channel) -> int | None:
    """Return the column whose name is that of a channel, with or without the joint's."""
    wanted = {_plain(channel.name), _plain(joint + channel.name)}
    for n in draft.numbers:
        name = re.sub(r"[\[({].*", "", draft.table.columns[n].name)
        if n not in draft.used and _plain(name.rpartition("/")[2]) in wanted:
            return n
    return None


def _candidates(draft: _Draft, si: str) -> list[int]:
    """Return the columns in a unit, in their order; columns without unit if there are none; no environment."""
    free = [
        n
        for n in draft.numbers
        if n not in draft.used and not any(p.search(draft.table.columns[n].name) for p in _NAMES.values())
    ]
    units = {n: draft.table.columns[n].unit for n in free}
    return [n for n in free if (unit := units[n]) and unit.si == si] or [n for n in free if units[n] is None]


def _propose_column(draft: _Draft, begin: str, channel: Channel, n: int | None, doubt: str) -> None:
    """Add the entry of a channel, with the unit of the header or one in which the values are within the range."""
    si = READINGS[channel.reading]
    if n is None:
        draft.add(f'{begin}{{column: "{_UNSURE}", unit: {si}}}  # {channel.name}', "no column found")
        return
    draft.used.add(n)
    column = draft.table.columns[n]
    doubts, unit = [doubt] if doubt else [], column.unit.name if column.unit else ""
    if not unit:
        of_sums = channel.reading == "diode_currents"  # the range is that of sums of two currents
        unit = likely_unit(float(np.nanmedian(draft.numbers[n])) * (2.0 if of_sums else 1.0), channel) or si
        doubts.append("unit by the size of the values")
    draft.add(f"{begin}{{column: {draft.column(n)}, unit: {_yaml_unit(unit)}}}  # {channel.name}", ", ".join(doubts))


def _yaml_unit(unit: str) -> str:
    return _quoted(unit) if unit in ("1", "%") or not unit.isascii() else unit


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\t", "\\t") + '"'
