"""Raw readings as the core sees them: the fields of ``posor_msgs/RawScan`` without ROS, one scan or many."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray  # noqa: TC002  read by dataclasses

from posor_estimator.core.kernels.diode import CONTACTS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_estimator.core.types import BoolArray, FloatArray, IntArray

NO_SOURCE = 255


def _empty() -> FloatArray:
    return np.empty(0)


def by_diode(currents: FloatArray) -> FloatArray:
    """Return the contact currents of n scans (n, k) by diode, (n, k / 4, 4); as (n, k, 1) where they are no diodes'."""
    count, size = currents.shape
    width = CONTACTS if size % CONTACTS == 0 else 1
    return currents.reshape(count, size // width, width)


@dataclass(frozen=True)
class Scan:
    """Raw readings of one exposure.

    Attributes:
        number: Scan number.
        stamp_ns: Middle of the exposure [ns].
        gap_voltages: Gap probe outputs [V], shape (probes,).
        ring_voltages: Ring probe outputs [V], shape (probes,).
        diode_currents: Contact currents A, B, C, D of each diode [A], shape (diodes, 4).
        lit_sources: Index of the source lit for each diode, NO_SOURCE for none.
        supply_voltage: Supply of the probe electronics [V], NaN when not measured.
        temperature: Of the receiving plate [K], NaN when not measured.
        at_home: Whether the ring's home mark was seen.

    """

    number: int = 0
    stamp_ns: int = 0
    gap_voltages: FloatArray = field(default_factory=_empty)
    ring_voltages: FloatArray = field(default_factory=_empty)
    diode_currents: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    lit_sources: tuple[int, ...] = ()
    supply_voltage: float = float("nan")
    temperature: float = float("nan")
    at_home: bool = False


@dataclass(frozen=True)
class Scans:
    """Raw readings of many scans of one POSOR: the attributes of ``Scan``, each with a leading axis of length n."""

    numbers: NDArray[np.uint64]
    stamps_ns: IntArray
    gap_voltages: FloatArray
    ring_voltages: FloatArray
    diode_currents: FloatArray
    lit_sources: IntArray
    supply_voltages: FloatArray
    temperatures: FloatArray
    at_home: IntArray

    @staticmethod
    def of(scans: Sequence[Scan]) -> Scans:
        """Return scans, all with the same number of readings, as one."""
        return Scans(
            numbers=np.array([scan.number for scan in scans], dtype=np.uint64),
            stamps_ns=np.array([scan.stamp_ns for scan in scans], dtype=np.int64),
            gap_voltages=np.array([scan.gap_voltages for scan in scans], dtype=float),
            ring_voltages=np.array([scan.ring_voltages for scan in scans], dtype=float),
            diode_currents=np.array([scan.diode_currents for scan in scans], dtype=float),
            lit_sources=np.array([scan.lit_sources for scan in scans], dtype=np.int64).reshape(len(scans), -1),
            supply_voltages=np.array([scan.supply_voltage for scan in scans], dtype=float),
            temperatures=np.array([scan.temperature for scan in scans], dtype=float),
            at_home=np.array([scan.at_home for scan in scans], dtype=np.int64),
        )

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.numbers)

    def __getitem__(self, index: int) -> Scan:
        """Return one scan."""
        return Scan(
            number=int(self.numbers[index]),
            stamp_ns=int(self.stamps_ns[index]),
            gap_voltages=self.gap_voltages[index],
            ring_voltages=self.ring_voltages[index],
            diode_currents=self.diode_currents[index],
            lit_sources=tuple(int(lit) for lit in self.lit_sources[index]),
            supply_voltage=float(self.supply_voltages[index]),
            temperature=float(self.temperatures[index]),
            at_home=bool(self.at_home[index]),
        )

    def part(self, begin: int, end: int) -> Scans:
        """Return scans ``begin`` to ``end``, without copying."""
        return Scans(**{f.name: getattr(self, f.name)[begin:end] for f in fields(self)})

    def chosen(self, which: BoolArray | IntArray) -> Scans:
        """Return the scans that truth values (n,) or indices choose."""
        return Scans(**{f.name: getattr(self, f.name)[which] for f in fields(self)})

    def with_fields(self, fields_by_name: Mapping[str, FloatArray] | Mapping[str, IntArray]) -> Scans:
        """Return the same scans with some fields replaced."""
        every: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        return Scans(**{**every, **fields_by_name})
