# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Source ``table``: a table of another program, by its map (``posor.tables``)."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from posor.errors import DataFileError
from posor.messages.message_definitions import installed_schema
from posor.messages.message_table import TableLayout
from posor.numerics.stamps import NS
from posor.parameter_model import ParameterGroup
from posor.ros_names import POINT_STAMPED, RAW_SCAN, RAW_TOPIC, REFERENCE_READING, TRANSFORM_STAMPED
from posor.tables.table_readings import load_readings, only_joint
from pydantic import Field

from posor_drivers.message_builder import header, point_stamped, raw_scan, scan_fields, transform_stamped
from posor_drivers.sources.source import RecordedSource, SourceMessage, Topic

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor.messages.message_definitions import MessageTypes
    from posor.tables.table_readings import ReferenceReadings, TableReadings

POINT = 3  # numbers of a point
POLL_S = 0.1  # pause between two looks at the size of a table that grows
SHARE = 2.0  # pause after reading it, in times of reading


class TableParameters(ParameterGroup):
    """Parameters of the source ``table``."""

    path: Annotated[str, Field(min_length=1)] = Field(description="table: CSV, Parquet, TDMS or MATLAB")
    map: Annotated[str, Field(min_length=1)] = Field(description="map of its columns (YAML)")
    joint: str = Field(default="", description="joint of the map; empty: the only one")
    follow: Annotated[float, Field(ge=0.0, allow_inf_nan=True)] = Field(
        default=0.0,
        description="wait for rows that another program adds, and end after this time without a new row [s]; "
        "0: end after the last row; .inf: never end",
    )


class TableSource(RecordedSource[TableParameters]):
    """Turns each row into a scan, and into the readings of the references with the same stamp."""

    Parameters = TableParameters

    _messages: TableMessages

    @property
    def record(self) -> str:
        """The file."""
        return self.parameters.path

    @property
    def has_own_pace(self) -> bool:
        """Whether rows are awaited."""
        return self.parameters.follow > 0.0

    def open(self) -> Sequence[Topic]:
        """Read the whole table."""
        self._messages = self._load()
        return self._messages.topics

    def _load(self) -> TableMessages:
        parameters = self.parameters
        readings = load_readings(Path(parameters.path), Path(parameters.map), growing=self.has_own_pace)
        return TableMessages(readings, only_joint(readings, parameters.joint, parameters.map), self.types)

    def read_messages(self) -> Iterator[SourceMessage]:
        """Yield scan and references of each row, with ``follow`` also of rows that are added."""
        yield from self._messages.read()
        if self.has_own_pace:
            yield from self._follow()

    def _follow(self) -> Iterator[SourceMessage]:
        """Yield the messages of rows that another program adds.

        The table is read anew whenever it has grown, so that all checks are those of the whole table; the pauses take
        two thirds of the time at least.
        """
        path, known = Path(self.parameters.path), self._messages
        size, pause_s, last_row_s = 0, POLL_S, time.monotonic()
        while not self.stopping() and time.monotonic() - last_row_s < self.parameters.follow:
            time.sleep(pause_s)
            new_size = path.stat().st_size if path.is_file() else -1
            if new_size == size:
                continue
            begin, size = time.monotonic(), new_size
            messages = self._load()
            if messages.stamps[: len(known.stamps)] != known.stamps:
                what = f"no longer begins with the {len(known.stamps)} rows that were read"
                raise DataFileError(what, where=str(path), expected="a table to which rows are only added")
            pause_s = max(POLL_S, SHARE * (time.monotonic() - begin))
            if len(messages.stamps) > len(known.stamps):
                yield from messages.read(len(known.stamps))
                known, last_row_s = messages, time.monotonic()


class TableMessages:
    """The messages of one joint of a table.

    Attributes:
        topics: Of the messages; ``raw`` comes first.
        stamps: Of the rows [ns].

    """

    def __init__(self, readings: TableReadings, joint: str, types: MessageTypes) -> None:
        """Write the scans; the references of the joint are written when they are read."""
        self._types = types
        self._references = [each for each in readings.references.values() if each.joint == joint]
        self.topics = [Topic(RAW_TOPIC, RAW_SCAN), *(Topic(each.topic, _type_of(each)) for each in self._references)]
        scans = readings.joints[joint].scans
        example = raw_scan(types, 0, readings.joints[joint].frame_id, status=0, **scan_fields(scans[0]))
        layout = TableLayout.of(types.serialize(example, RAW_SCAN), installed_schema(RAW_SCAN))
        self.stamps: list[int] = scans.stamps_ns.tolist()
        self._scans = table = layout.copies(len(scans))
        table["header.stamp.sec"], table["header.stamp.nanosec"] = np.divmod(scans.stamps_ns, NS)
        table["scan"], table["status"] = scans.numbers, scans.statuses
        table["supply_voltage"], table["temperature"] = scans.supply_voltages, scans.temperatures
        table["reference_voltage"] = scans.reference_voltages
        rows = table.rows.view(layout.dtype)
        for name in ("gap_voltages", "ring_voltages", "diode_currents", "lit_sources"):
            array = getattr(scans, name).reshape(len(scans), -1)
            if array.size:
                rows[name][:, 0] = array

    def read(self, first: int = 0) -> Iterator[SourceMessage]:
        """Yield the messages in the order of their times, from a row on."""
        for n, stamp_ns in enumerate(self.stamps[first:], first):
            yield SourceMessage(RAW_TOPIC, stamp_ns, self._scans.messages[n].tobytes())
            for reference in self._references:
                values = reference.values[n]
                if not np.isnan(values).all():
                    yield self._reference(reference, stamp_ns, values.tolist())

    def _reference(self, reference: ReferenceReadings, stamp_ns: int, values: list[float]) -> SourceMessage:
        types, entry, kind = self._types, reference.entry, _type_of(reference)
        if kind == REFERENCE_READING:
            uncertainty = 0.0 if entry.standard_uncertainty is None else entry.standard_uncertainty.number
            message = types.new(
                REFERENCE_READING,
                header=header(types, stamp_ns, entry.frame_id),
                unit=entry.unit,
                value=values[0],
                standard_uncertainty=uncertainty,
                reading=values[0],
            )
        elif kind == POINT_STAMPED:
            message = point_stamped(types, stamp_ns, entry.frame_id, values)
        else:
            message = transform_stamped(types, stamp_ns, (entry.frame_id, str(entry.child_frame_id)), values)
        return SourceMessage(reference.topic, stamp_ns, types.serialize(message, kind))


def _type_of(reference: ReferenceReadings) -> str:
    if reference.entry.reading is not None:
        return REFERENCE_READING
    return POINT_STAMPED if reference.values.shape[1] == POINT else TRANSFORM_STAMPED
