# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Raw readings of one exposure: the fields of ``posor_msgs/RawScan`` without ROS, one scan or many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from operator import index as whole_number
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.errors import ParameterError, ShapeError, check_type, similar_name
from posor.numerics.array_types import refuse_masked
from posor.numerics.stamps import span_text

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

NO_SOURCE = 255
CONTACTS = 4  # contact currents A, B, C, D of a diode

PROBES_ESTIMATED, DIODES_ESTIMATED, DARK_SUBTRACTED, SATURATED, SIMULATED, HOME_BUMP = 1, 2, 8, 16, 64, 128
"""Flags of ``posor_msgs/RawScan.status``: readings substituted by the driver, diode currents without the ambient light,
a saturated channel, a simulated scan, the home mark seen."""
STATED_HOME = 2  # ``at_home`` where an operator states that the joint is within half a period of the home mark

MAX_GAP_PROBES, MAX_RING_PROBES, MAX_DIODES = 8, 8, 4  # bounds of the sequences of ``posor_msgs/RawScan``
MAX_TERMS = 8  # bound of the shared terms of ``posor_msgs/JointTransform``
MAX_CHANNELS = MAX_GAP_PROBES + MAX_RING_PROBES + CONTACTS * MAX_DIODES

SCAN = np.dtype(
    [
        ("number", "u8"),
        ("stamp_ns", "i8"),
        ("gap_voltages", "f8", (MAX_GAP_PROBES,)),
        ("ring_voltages", "f8", (MAX_RING_PROBES,)),
        ("diode_currents", "f8", (MAX_DIODES * CONTACTS,)),
        ("lit_sources", "i8", (MAX_DIODES,)),
        ("exposure_offsets", "f8", (MAX_CHANNELS,)),
        ("exposure_span", "f8"),
        ("stamp_uncertainty", "f8"),
        ("stamp_limit", "f8"),
        ("supply_voltage", "f8"),
        ("temperature", "f8"),
        ("reference_voltage", "f8"),
        ("at_home", "i8"),
        ("status", "i8"),
        ("gap_count", "i8"),
        ("ring_count", "i8"),
        ("current_count", "i8"),
        ("lit_count", "i8"),
        ("offset_count", "i8"),
    ],
    align=True,
)
"""One scan as the kernels read it; the counts are the valid entries of each sequence. SI units, as ``Scan``."""

_COUNTS = {
    "gap_voltages": "gap_count",
    "ring_voltages": "ring_count",
    "diode_currents": "current_count",
    "lit_sources": "lit_count",
    "exposure_offsets": "offset_count",
}
_SCALARS = {
    "numbers": "number",
    "stamps_ns": "stamp_ns",
    "supply_voltages": "supply_voltage",
    "temperatures": "temperature",
    "reference_voltages": "reference_voltage",
    "stamp_uncertainties": "stamp_uncertainty",
    "stamp_limits": "stamp_limit",
    "exposure_spans": "exposure_span",
    "at_home": "at_home",
    "statuses": "status",
}


SCAN_FIELDS = (*_SCALARS, *_COUNTS)  # attributes of ``Scans``


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
        stamp_ns: Middle between the first and the last exposure [ns].
        gap_voltages: Gap probe outputs [V], shape (probes,), at most 8.
        ring_voltages: Ring probe outputs [V], shape (probes,), at most 8.
        diode_currents: Contact currents A, B, C, D of each diode [A], shape (diodes, 4), at most 4 diodes.
        lit_sources: Index of the light source lit for each diode, NO_SOURCE for none; all NO_SOURCE: a dark scan.
        supply_voltage: Supply of the probe electronics [V], NaN when not measured.
        temperature: Temperature of the receiving plate [K], NaN when not measured.
        reference_voltage: Reading of the known voltage of the probes' converter [V], NaN when not measured.
        exposure_offsets: Middle of each channel's exposure minus the stamp [s], in the order gap probes, ring probes,
            contact currents, shape (channels,); empty: all at one time; NaN: unknown.
        exposure_span: Time from the first to the last exposure [s]; 0: not stated.
        stamp_uncertainty: Standard uncertainty of the stamp [s]; 0: not stated.
        stamp_limit: Largest error of the stamp [s]; 0: not stated.
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
    reference_voltage: float = float("nan")
    exposure_offsets: FloatArray = field(default_factory=_empty)
    exposure_span: float = 0.0
    stamp_uncertainty: float = 0.0
    stamp_limit: float = 0.0
    at_home: int = 0
    status: int = 0

    def __repr__(self) -> str:
        """Return number, stamp and numbers of readings."""
        readings = {name: len(getattr(self, name)) for name in _COUNTS}
        described = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in readings.items() if count)
        return f"<Scan {self.number} at {self.stamp_ns} ns: {described or 'no readings'}>"


class Scans:
    """Raw readings of n scans of one POSOR: the attributes of ``Scan``, each with a leading axis of length n.

    The arrays are read-only; ``with_fields`` and ``editable`` return scans with other readings.

    Attributes:
        numbers: Scan numbers, shape (n,).
        stamps_ns: Middle between the first and the last exposure of each scan [ns], shape (n,).
        gap_voltages: Gap probe outputs [V], shape (n, probes).
        ring_voltages: Ring probe outputs [V], shape (n, probes).
        diode_currents: Contact currents [A], shape (n, diodes, 4); (n, currents, 1) where they are not four a diode.
        lit_sources: Index of the light source lit for each diode, shape (n, diodes).
        supply_voltages: Supply of the probe electronics [V], shape (n,), NaN when not measured.
        temperatures: Temperature of the receiving plate [K], shape (n,), NaN when not measured.
        reference_voltages: Readings of the known voltage of the probes' converter [V], shape (n,), NaN when not
            measured.
        exposure_offsets: Middle of each channel's exposure minus the stamp [s], see ``Scan``, shape (n, channels).
        exposure_spans: Time from the first to the last exposure [s], shape (n,); 0: not stated.
        stamp_uncertainties: Standard uncertainty of each stamp [s], shape (n,); 0: not stated.
        stamp_limits: Largest error of each stamp [s], shape (n,); 0: not stated.
        at_home: Whether the home mark of the ring was seen, shape (n,): 0, 1, or STATED_HOME.
        statuses: Flags of the driver, shape (n,).

    """

    numbers: NDArray[np.uint64]
    stamps_ns: IntArray
    gap_voltages: FloatArray
    ring_voltages: FloatArray
    diode_currents: FloatArray
    lit_sources: IntArray
    supply_voltages: FloatArray
    temperatures: FloatArray
    reference_voltages: FloatArray
    exposure_offsets: FloatArray
    exposure_spans: FloatArray
    stamp_uncertainties: FloatArray
    stamp_limits: FloatArray
    at_home: IntArray
    statuses: IntArray

    def __init__(self, records: NDArray[np.void], *, editable: bool = False) -> None:
        """Take scan records, shape (n,), dtype SCAN, which all have the same numbers of readings."""
        self._records = records
        self._editable = editable

    @staticmethod
    def from_fields(**arrays: NDArray[Any]) -> Scans:
        """Return scans with the given attributes; see the class. ``stamps_ns`` is required.

        An attribute that is left out is 0, or NaN for supply voltage, temperature and reference voltage, or has no
        readings.

        Raises ParameterError: an attribute is unknown, ``stamps_ns`` is missing, or an array holds other than real
        numbers, or whole numbers where the attribute has them, or has masked entries: a missing reading is NaN.
        Raises ShapeError: an array has the wrong shape; names the attribute, the expected and the received shape.
        """
        if "stamps_ns" not in arrays:
            raise ParameterError("stamps_ns is missing", where="Scans", expected="the middle of each exposure [ns]")
        try:
            count = np.size(arrays["stamps_ns"])
        except ValueError:
            count = 0  # sequences of different lengths: refused below
        records = np.zeros(count, dtype=SCAN)
        records["supply_voltage"] = records["temperature"] = records["reference_voltage"] = np.nan
        scans = Scans(records)
        scans._write(arrays)
        return scans

    def _write(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        count = len(self._records)
        for name, array in arrays.items():
            if name not in SCAN_FIELDS:
                expected = similar_name(str(name), SCAN_FIELDS, f"one of {', '.join(SCAN_FIELDS)}")
                raise ParameterError(f"'{name}' is unknown", where="Scans", expected=expected)
            refuse_masked(array, name, "Scans")
            try:
                values = np.asarray(array)
                shape = values.shape
                whole = SCAN[_SCALARS.get(name, name)].base.kind in "iu"
                kinds = ("iub" if name == "at_home" else "iu") if whole else "iuf"
                if values.size and values.dtype.kind not in kinds:
                    expected = "an array of whole numbers" if whole else "an array of real numbers"
                    raise ParameterError(f"{name} holds {values.dtype}", where="Scans", expected=expected)
                if name in _SCALARS:
                    if shape != (count,):
                        raise ShapeError(name, received=shape, expected=f"({count},)", where="Scans")
                    self._records[_SCALARS[name]] = values
                    continue
                most = self._records.dtype[name].shape[0]
                size = int(np.prod(shape[1:]))
                if len(shape) < 2 or shape[0] != count or size > most:  # noqa: PLR2004  scans, readings
                    expected = f"({count}, ...) with at most {most} readings"
                    raise ShapeError(name, received=shape, expected=expected, where="Scans")
                self._records[name][:, :size] = values.reshape(count, size)
                self._records[_COUNTS[name]] = size
            except (TypeError, ValueError, OverflowError) as error:
                if isinstance(error, ShapeError):
                    raise
                what = f"{name} is of type {type(array).__name__}"
                raise ParameterError(what, where="Scans", expected="an array of numbers") from None

    @staticmethod
    def of(scans: Sequence[Scan]) -> Scans:
        """Return scans, which all have the same numbers of readings, as one object.

        Raises ParameterError: an entry is no Scan, or has masked readings, or the scans have different numbers of
        readings.
        """
        given: Any = scans
        if not isinstance(given, Sequence | Scans) or not all(isinstance(scan, Scan) for scan in scans):
            raise ParameterError(
                "the argument is no sequence or an entry is no Scan", where="Scans.of", expected="a sequence of Scan"
            )
        if len(scans) == 0:
            return Scans(np.zeros(0, dtype=SCAN))
        attributes = {**_SCALARS, **{name: name for name in _COUNTS}}
        for name in _COUNTS:
            refuse_masked([getattr(scan, name) for scan in scans], name, "Scans.of")
        try:
            arrays = {
                name: np.array([getattr(scan, attribute) for scan in scans], dtype=SCAN[attribute].base)
                for name, attribute in attributes.items()
            }
        except ValueError:
            expected = "as many readings in each scan"
            raise ParameterError("the numbers of readings differ", where="Scans.of", expected=expected) from None
        return Scans.from_fields(**arrays | {"lit_sources": arrays["lit_sources"].reshape(len(scans), -1)})

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self._records)

    def __repr__(self) -> str:
        """Return count, readings and time span."""
        readings = {name: getattr(self, name).shape[1] for name in _COUNTS}
        described = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in readings.items() if count)
        return f"<{len(self)} Scans: {described or 'no readings'}{span_text(self.stamps_ns)}>"

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Return an attribute's array, a view of the records."""
        if name in _SCALARS:
            view = self._records[_SCALARS[name]]
        elif name in _COUNTS:
            count = int(self._records[_COUNTS[name]][0]) if len(self._records) else 0
            view = self._records[name][:, :count]
            view = split_by_diode(view) if name == "diode_currents" else view
        else:
            raise AttributeError(f"'Scans' has no attribute '{name}'", name=name, obj=self)
        view.flags.writeable = self._editable and view.flags.writeable
        return view

    @property
    def dark(self) -> BoolArray:
        """Which scans are dark, with diodes and no light source lit, shape (n,)."""
        lit = self.lit_sources
        dark = np.asarray((lit.shape[1] > 0) & (lit == NO_SOURCE).all(axis=1))
        dark.flags.writeable = False
        return dark

    def __dir__(self) -> list[str]:
        """Return the names of attributes and methods."""
        return sorted({*super().__dir__(), *SCAN_FIELDS})

    def __getitem__(self, index: int) -> Scan:
        """Return one scan."""
        try:
            index = whole_number(index)
        except TypeError:
            expected = "an integer; a range: .part(begin, end)"
            raise ParameterError(f"{index!r} is no index", where="Scans", expected=expected) from None
        if not -len(self) <= index < len(self):
            raise IndexError(f"scan {index} of {len(self)}; expected {-len(self)} to {len(self) - 1}")
        index %= len(self)
        one = Scans(self._records[index : index + 1])
        values = {name: getattr(one, attribute)[0].item() for attribute, name in _SCALARS.items()}
        sequences = {name: getattr(one, name)[0] for name in _COUNTS if name != "lit_sources"}
        return Scan(**values, **sequences, lit_sources=tuple(one.lit_sources[0].tolist()))

    def part(self, begin: int, end: int) -> Scans:
        """Return scans ``begin`` to ``end``, without copying."""
        return Scans(self._records[begin:end])

    def select(self, which: BoolArray | IntArray | slice) -> Scans:
        """Return the scans selected by truth values (n,), indices or a slice."""
        return Scans(self._records[which])

    @staticmethod
    def concatenate(parts: Sequence[Scans]) -> Scans:
        """Return the scans of several parts, one after the other; at least one part."""
        return Scans(np.concatenate([part._records for part in parts]))

    def editable(self) -> Scans:
        """Return a copy whose arrays may be written."""
        return Scans(self._records.copy(), editable=True)

    def with_fields(self, arrays: Mapping[str, NDArray[Any]]) -> Scans:
        """Return the same scans with some attributes replaced. Raises the errors of ``from_fields``."""
        check_type(arrays, Mapping, "Scans.with_fields")
        scans = Scans(self._records.copy(), editable=self._editable)
        scans._write(arrays)
        return scans


class ScanBuffer:
    """Memory for one scan record, filled again and again without allocating."""

    def __init__(self) -> None:
        """Allocate."""
        self.records = np.zeros(1, dtype=SCAN)  # shape (1,), dtype SCAN
        self._sequences = [(name, self.records[name][0], self.records[count]) for name, count in _COUNTS.items()]
        self._scalars = [(name, self.records[name]) for name in _SCALARS.values()]

    def write(self, scan: Scan) -> None:
        """Write a scan.

        Raises ShapeError: a sequence of readings is longer than its bound; names it, the expected and the received
        shape. Raises ParameterError: a reading is masked.
        """
        for name, memory, count in self._sequences:
            given = getattr(scan, name)
            if len(given) == 0:
                count[0] = 0
                continue
            array = np.asarray(given)
            if array is not given and isinstance(given, np.ma.MaskedArray):
                refuse_masked(given, name, "Scan")
            readings = array.reshape(-1)
            size = readings.size
            if size > memory.size:
                received = np.shape(getattr(scan, name))
                raise ShapeError(name, received=received, expected=f"at most {memory.size} readings")
            memory[:size] = readings
            count[0] = size
        for name, memory in self._scalars:
            memory[0] = getattr(scan, name)
