"""Raw readings of one exposure: the fields of ``posor_msgs/RawScan`` without ROS, one scan or many."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.errors import ShapeError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

NO_SOURCE = 255
CONTACTS = 4
"""Contact currents A, B, C, D of a diode."""

PROBES_ESTIMATED, DIODES_ESTIMATED, SATURATED, SIMULATED, HOME_BUMP = 1, 2, 16, 64, 128
"""Flags of ``posor_msgs/RawScan.status``: readings filled in, a channel at the end of its range, a simulated scan, the
home mark seen."""
STATED_HOME = 2
"""``at_home`` where an operator states that the joint is within half a period of the home mark."""

MAX_GAP_PROBES, MAX_RING_PROBES, MAX_DIODES = 8, 8, 4
"""Bounds of the sequences of ``posor_msgs/RawScan``."""

SCAN = np.dtype(
    [
        ("number", "u8"),
        ("stamp_ns", "i8"),
        ("gap_voltages", "f8", (MAX_GAP_PROBES,)),
        ("ring_voltages", "f8", (MAX_RING_PROBES,)),
        ("diode_currents", "f8", (MAX_DIODES * CONTACTS,)),
        ("lit_sources", "i8", (MAX_DIODES,)),
        ("supply_voltage", "f8"),
        ("temperature", "f8"),
        ("at_home", "i8"),
        ("status", "i8"),
        ("gap_count", "i8"),
        ("ring_count", "i8"),
        ("current_count", "i8"),
        ("lit_count", "i8"),
    ],
    align=True,
)
"""One scan as the kernels read it; the counts are the valid entries of each sequence. SI units, as ``Scan``."""

_COUNTS = {
    "gap_voltages": "gap_count",
    "ring_voltages": "ring_count",
    "diode_currents": "current_count",
    "lit_sources": "lit_count",
}
_SCALARS = {
    "numbers": "number",
    "stamps_ns": "stamp_ns",
    "supply_voltages": "supply_voltage",
    "temperatures": "temperature",
    "at_home": "at_home",
    "statuses": "status",
}


SCAN_FIELDS = (*_SCALARS, *_COUNTS)
"""Attributes of ``Scans``."""


def _empty() -> FloatArray:
    return np.empty(0)


def split_by_diode(currents: FloatArray) -> FloatArray:
    """Return contact currents (..., k) as (..., k / 4, 4), or as (..., k, 1) where they are not four for each diode."""
    width = CONTACTS if currents.shape[-1] % CONTACTS == 0 else 1
    return currents.reshape(*currents.shape[:-1], currents.shape[-1] // width, width)


@dataclass(frozen=True)
class Scan:
    """Raw readings of one exposure.

    Attributes:
        number: Scan number.
        stamp_ns: Middle of the exposure [ns].
        gap_voltages: Gap probe outputs [V], shape (probes,), at most 8.
        ring_voltages: Ring probe outputs [V], shape (probes,), at most 8.
        diode_currents: Contact currents A, B, C, D of each diode [A], shape (diodes, 4), at most 4 diodes.
        lit_sources: Index of the light source lit for each diode, NO_SOURCE for none.
        supply_voltage: Supply of the probe electronics [V], NaN when not measured.
        temperature: Temperature of the receiving plate [K], NaN when not measured.
        at_home: Whether the home mark of the ring was seen: 0, 1, or STATED_HOME.
        status: Flags of the driver, ``posor_msgs/RawScan.status``.

    """

    number: int = 0
    stamp_ns: int = 0
    gap_voltages: FloatArray = field(default_factory=_empty)
    ring_voltages: FloatArray = field(default_factory=_empty)
    diode_currents: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    lit_sources: tuple[int, ...] = ()
    supply_voltage: float = float("nan")
    temperature: float = float("nan")
    at_home: int = 0
    status: int = 0


class Scans:
    """Raw readings of n scans of one POSOR: the attributes of ``Scan``, each with a leading axis of length n.

    Attributes:
        records: The scans as the kernels read them, shape (n,), dtype ``SCAN``; the attributes below are views of it.
        numbers: Scan numbers, shape (n,).
        stamps_ns: Middle of each exposure [ns], shape (n,).
        gap_voltages: Gap probe outputs [V], shape (n, probes).
        ring_voltages: Ring probe outputs [V], shape (n, probes).
        diode_currents: Contact currents [A], shape (n, diodes, 4); (n, currents, 1) where they are not four a diode.
        lit_sources: Index of the light source lit for each diode, shape (n, diodes).
        supply_voltages: Supply of the probe electronics [V], shape (n,), NaN when not measured.
        temperatures: Temperature of the receiving plate [K], shape (n,), NaN when not measured.
        at_home: Whether the home mark of the ring was seen, shape (n,): 0, 1, or STATED_HOME.
        statuses: Flags of the driver, shape (n,).

    """

    def __init__(self, records: NDArray[np.void]) -> None:
        """Take scan records, shape (n,), which all have the same numbers of readings."""
        self.records = records

    @staticmethod
    def from_fields(**arrays: NDArray[Any]) -> Scans:
        """Return scans with the given attributes; see the class. ``stamps_ns`` is required.

        An attribute that is left out is 0, or NaN for supply voltage and temperature, or has no readings.

        Raises:
            ShapeError: An array has the wrong shape; names the attribute, the expected and the received shape.

        """
        count = len(arrays["stamps_ns"])
        records = np.zeros(count, dtype=SCAN)
        records["supply_voltage"] = records["temperature"] = np.nan
        scans = Scans(records)
        scans._write(arrays)
        return scans

    def _write(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        count = len(self.records)
        for name, array in arrays.items():
            if name in _SCALARS:
                if np.shape(array) != (count,):
                    raise ShapeError(name, received=np.shape(array), expected=f"({count},)")
                self.records[_SCALARS[name]] = array
                continue
            most = self.records.dtype[name].shape[0]
            size = int(np.prod(np.shape(array)[1:]))
            if np.ndim(array) < 2 or len(array) != count or size > most:  # noqa: PLR2004  scans, readings
                raise ShapeError(
                    name, received=np.shape(array), expected=f"({count}, ...) with at most {most} readings"
                )
            self.records[name][:, :size] = np.reshape(array, (count, size))
            self.records[_COUNTS[name]] = size

    @staticmethod
    def of(scans: Sequence[Scan]) -> Scans:
        """Return scans, which all have the same numbers of readings, as one object."""
        return Scans.from_fields(
            numbers=np.array([scan.number for scan in scans], dtype=np.uint64),
            stamps_ns=np.array([scan.stamp_ns for scan in scans], dtype=np.int64),
            gap_voltages=np.array([scan.gap_voltages for scan in scans], dtype=float),
            ring_voltages=np.array([scan.ring_voltages for scan in scans], dtype=float),
            diode_currents=np.array([scan.diode_currents for scan in scans], dtype=float),
            lit_sources=np.array([scan.lit_sources for scan in scans], dtype=np.int64).reshape(len(scans), -1),
            supply_voltages=np.array([scan.supply_voltage for scan in scans], dtype=float),
            temperatures=np.array([scan.temperature for scan in scans], dtype=float),
            at_home=np.array([scan.at_home for scan in scans], dtype=np.int64),
            statuses=np.array([scan.status for scan in scans], dtype=np.int64),
        )

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.records)

    def _sequence(self, name: str) -> NDArray[Any]:
        count = int(self.records[_COUNTS[name]][0]) if len(self.records) else 0
        return self.records[name][:, :count]

    @property
    def numbers(self) -> NDArray[np.uint64]:
        """See the class."""
        return self.records["number"]

    @property
    def stamps_ns(self) -> IntArray:
        """See the class."""
        return self.records["stamp_ns"]

    @property
    def gap_voltages(self) -> FloatArray:
        """See the class."""
        return self._sequence("gap_voltages")

    @property
    def ring_voltages(self) -> FloatArray:
        """See the class."""
        return self._sequence("ring_voltages")

    @property
    def diode_currents(self) -> FloatArray:
        """See the class."""
        return split_by_diode(self._sequence("diode_currents"))

    @property
    def lit_sources(self) -> IntArray:
        """See the class."""
        return self._sequence("lit_sources")

    @property
    def supply_voltages(self) -> FloatArray:
        """See the class."""
        return self.records["supply_voltage"]

    @property
    def temperatures(self) -> FloatArray:
        """See the class."""
        return self.records["temperature"]

    @property
    def at_home(self) -> IntArray:
        """See the class."""
        return self.records["at_home"]

    @property
    def statuses(self) -> IntArray:
        """See the class."""
        return self.records["status"]

    def __getitem__(self, index: int) -> Scan:
        """Return one scan."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}; expected {-len(self)} to {len(self) - 1}")
        index %= len(self)
        one = Scans(self.records[index : index + 1])
        return Scan(
            number=int(one.numbers[0]),
            stamp_ns=int(one.stamps_ns[0]),
            gap_voltages=one.gap_voltages[0],
            ring_voltages=one.ring_voltages[0],
            diode_currents=one.diode_currents[0],
            lit_sources=tuple(one.lit_sources[0].tolist()),
            supply_voltage=float(one.supply_voltages[0]),
            temperature=float(one.temperatures[0]),
            at_home=int(one.at_home[0]),
            status=int(one.statuses[0]),
        )

    def part(self, begin: int, end: int) -> Scans:
        """Return scans ``begin`` to ``end``, without copying."""
        return Scans(self.records[begin:end])

    def select(self, which: BoolArray | IntArray) -> Scans:
        """Return the scans selected by truth values (n,) or indices."""
        return Scans(self.records[which])

    def with_fields(self, arrays: Mapping[str, NDArray[Any]]) -> Scans:
        """Return the same scans with some attributes replaced.

        Raises:
            ShapeError: See ``from_fields``.

        """
        scans = Scans(self.records.copy())
        scans._write(arrays)
        return scans


class ScanBuffer:
    """Memory for one scan record, filled again and again without allocating.

    Attributes:
        records: Shape (1,), dtype SCAN.

    """

    def __init__(self) -> None:
        """Allocate."""
        self.records = np.zeros(1, dtype=SCAN)
        self._sequences = [(name, self.records[name][0], self.records[count]) for name, count in _COUNTS.items()]
        names = ("number", "stamp_ns", "supply_voltage", "temperature", "at_home", "status")
        self._scalars = [(name, self.records[name]) for name in names]

    def write(self, scan: Scan) -> None:
        """Write a scan.

        Raises:
            ShapeError: A sequence of readings is longer than its bound; names it, the expected and the received shape.

        """
        for name, memory, count in self._sequences:
            readings = np.asarray(getattr(scan, name)).reshape(-1)
            size = readings.size
            if size > memory.size:
                received = np.shape(getattr(scan, name))
                raise ShapeError(name, received=received, expected=f"at most {memory.size} readings")
            memory[:size] = readings
            count[0] = size
        for name, memory in self._scalars:
            memory[0] = getattr(scan, name)
