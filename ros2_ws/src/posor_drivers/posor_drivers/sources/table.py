"""Source ``table``: a recorded test in the CSV layout of the 1985 records."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from posor_estimator.ros.message_types import POINT_STAMPED, RAW_SCAN
from posor_estimator.ros.parameters import ParameterGroup
from posor_estimator.ros.qos import RAW_TOPIC, TRUTH_TOPIC
from pydantic import Field

from posor_drivers.sources.base import RecordedSource, SourceMessage, Topic
from posor_drivers.sources.table_file import TableRow, read_table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

STATUS_PROBES_ESTIMATED = 1
STATUS_DIODES_ESTIMATED = 2
LIT_SOURCES = (0, 1)
"""Diode 1 sees light source 1, diode 2 light source 2; both were lit throughout."""


class TableParameters(ParameterGroup):
    """Parameters of the source ``table``."""

    path: Annotated[str, Field(min_length=1)] = Field(description="CSV file of the recorded test")
    frame_id: Annotated[str, Field(min_length=1)] = Field(
        default="posor_receiving", description="frame of the receiving plate, as in the calibration file"
    )
    nominal_total: Annotated[float, Field(gt=0.0)] = Field(
        default=200e-6,
        description="sum of the four contact currents of a diode [A]; the record holds their ratios only",
    )
    start: Annotated[float, Field(gt=0.0, lt=2**31)] = Field(
        default=486_432_000.0, description="stamp of the first step [s since 1970]; default 1985-06-01 00:00:00 UTC"
    )
    period: Annotated[float, Field(gt=0.0)] = Field(default=0.2, description="time from step to step [s]")
    truth_topic: Annotated[str, Field(min_length=1)] = Field(
        default=TRUTH_TOPIC, description="topic of the machining centre's readings"
    )


class TableSource(RecordedSource[TableParameters]):
    """Turns each row of the table into a scan and the machining centre's reading that belongs to it, same stamp.

    The contact currents are rebuilt from the recorded ratios with a nominal total: A + C = B + D = total / 2. Where the
    record has a cell filled in, the scan's status says so.
    """

    Parameters = TableParameters

    _rows: list[TableRow]

    @property
    def record(self) -> str:
        """The file."""
        return self.parameters.path

    def open(self) -> Sequence[Topic]:
        """Read the whole table."""
        self._rows = read_table(Path(self.parameters.path))
        return (Topic(RAW_TOPIC, RAW_SCAN), Topic(self.parameters.truth_topic, POINT_STAMPED))

    def messages(self) -> Iterator[SourceMessage]:
        """Yield scan and truth of each step."""
        start_ns, period_ns = (round(1e9 * seconds) for seconds in (self.parameters.start, self.parameters.period))
        for index, row in enumerate(self._rows):
            time_ns = start_ns + index * period_ns
            yield SourceMessage(RAW_TOPIC, time_ns, self._scan(row, time_ns))
            yield SourceMessage(self.parameters.truth_topic, time_ns, self._truth(row, time_ns))

    def _header(self, time_ns: int, frame_id: str) -> object:
        sec, nanosec = divmod(time_ns, 1_000_000_000)
        stamp = self.types.new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self.types.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)

    def _scan(self, row: TableRow, time_ns: int) -> bytes:
        none = np.empty(0)
        scan = self.types.new(
            RAW_SCAN,
            header=self._header(time_ns, self.parameters.frame_id),
            scan=row.step,
            samples=1,
            status=STATUS_PROBES_ESTIMATED * row.probes_estimated | STATUS_DIODES_ESTIMATED * row.diodes_estimated,
            gap_voltages=np.array(row.gap_voltages),
            gap_voltage_spreads=none,
            ring_voltages=none,
            ring_voltage_spreads=none,
            diode_currents=contact_currents(row.ratios, self.parameters.nominal_total),
            diode_current_spreads=none,
            lit_sources=np.array(LIT_SOURCES, dtype=np.uint8),
            supply_voltage=math.nan,
            temperature=math.nan,
        )
        return self.types.serialize(scan, RAW_SCAN)

    def _truth(self, row: TableRow, time_ns: int) -> bytes:
        x, y, z = row.truth
        point = self.types.new("geometry_msgs/msg/Point", x=x, y=y, z=z)
        header = self._header(time_ns, "machining_centre")
        return self.types.serialize(self.types.new(POINT_STAMPED, header=header, point=point), POINT_STAMPED)


def contact_currents(ratios: Sequence[float], total: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the currents A, B, C, D [A] of each diode in turn that have the given ratios.

    Args:
        ratios: dx = (A - C) / (A + C) and dy = (B - D) / (B + D) [-] of each diode in turn.
        total: A + B + C + D [A]; half of it falls on either axis.

    """
    dx, dy = np.asarray(ratios, dtype=np.float64).reshape(-1, 2).T
    return total / 4.0 * np.stack([1.0 + dx, 1.0 + dy, 1.0 - dx, 1.0 - dy], axis=1).ravel()
