# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Scans of a joint from the numbers of its columns."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.calibration.quantity import Quantity
from posor.errors import DataFileError
from posor.model.scan import DARK_SUBTRACTED, HOME_BUMP, NO_SOURCE, Scans
from posor.sensors.base import READING_KINDS
from posor.tables.table_map import FLAGS, READINGS, ColumnEntry

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from posor.numerics.array_types import FloatArray, IntArray
    from posor.tables.table_map import Flag, JointMap

_SCALARS = {
    "supply_voltage": "supply_voltages",
    "temperature": "temperatures",
    "reference_voltage": "reference_voltages",
}
"""Fields of ``Scans`` by the reading of the map."""


@dataclass(frozen=True)
class JointColumns:
    """The columns of a joint."""

    joint: JointMap
    numbers: Mapping[int, FloatArray]  # by the identity of their entries, (n,)
    texts: Mapping[Flag, NDArray[Any]]  # of the flags, (n,)
    sources: int  # number of light sources
    place: Callable[..., str]  # of an entry of the joint in the map

    def scans(self, stamps_ns: IntArray, numbers: IntArray) -> Scans:
        """Return the scans. Raises DataFileError: a light source or a ratio is impossible."""
        joint = self.joint
        arrays: dict[str, Any] = {"stamps_ns": stamps_ns, "numbers": numbers}
        for reading in READING_KINDS:
            if part := getattr(joint, reading):
                arrays[reading] = np.column_stack([self._values(entry, READINGS[reading]) for entry in part])
        if joint.diode_ratios:
            arrays["diode_currents"] = np.hstack([self._currents(n) for n in range(joint.diodes)])
        for reading, attribute in _SCALARS.items():
            if (entry := getattr(joint, reading)) is not None:
                arrays[attribute] = self._values(entry, READINGS[reading])
        if joint.lit_sources:
            arrays["lit_sources"] = self._lit_sources(len(stamps_ns))
        if joint.home_mark is not None:
            arrays["at_home"] = (self._values(joint.home_mark, "1") != 0.0).astype(np.int64)
        return Scans.from_fields(**arrays, statuses=self._statuses(len(stamps_ns), arrays.get("at_home")))

    def _values(self, entry: ColumnEntry, si: str) -> FloatArray:
        return entry.reading(self.numbers[id(entry)], si)

    def _statuses(self, count: int, at_home: IntArray | None) -> IntArray:
        statuses = np.full(count, DARK_SUBTRACTED if self.joint.demodulated else 0, dtype=np.int64)
        if at_home is not None:
            statuses |= np.where(at_home != 0, HOME_BUMP, 0)
        for flag, texts in self.texts.items():
            pattern = self.joint.flags[flag].pattern
            matches = [re.search(pattern, str(text)) is not None for text in texts]
            statuses |= np.where(matches, FLAGS[flag], 0)
        return statuses

    def _currents(self, diode: int) -> FloatArray:
        """Return the contact currents A, B, C, D (n, 4) [A] by ratios; half of the total falls on either axis."""
        entry = self.joint.diode_ratios[diode]
        dx, dy = ratios = [self._values(each, "1") for each in (entry.x, entry.y)]
        for key, each, column in zip("xy", ratios, (entry.x.column, entry.y.column), strict=True):
            if (np.abs(each) > 1.0).any():
                what = f"column '{column}' holds {each[np.abs(each) > 1.0][0]:g}, which is no ratio of currents"
                raise DataFileError(what, where=self.place("diode_ratios", diode, key), expected="-1 to 1")
        of_total = entry.total
        total: Any = of_total.number if isinstance(of_total, Quantity) else self._values(of_total, "A")
        return np.asarray((total / 4.0 * np.stack([1.0 + dx, 1.0 + dy, 1.0 - dx, 1.0 - dy])).T)

    def _lit_sources(self, count: int) -> IntArray:
        entries = self.joint.lit_sources
        lit = np.column_stack(
            [np.full(count, float(each)) if isinstance(each, int) else self._values(each, "1") for each in entries]
        )
        bad = ~(((lit >= 0) & (lit < self.sources)) | (lit == NO_SOURCE)) | (lit != np.floor(lit))
        if bad.any():
            expected = f"whole numbers from 0 to {self.sources - 1}, or {NO_SOURCE} for none"
            raise DataFileError(f"light source {lit[bad][0]:g}", where=self.place("lit_sources"), expected=expected)
        if self.joint.light is not None:
            lit[self._values(self.joint.light, "1") == 0.0] = NO_SOURCE
        return lit.astype(np.int64)
