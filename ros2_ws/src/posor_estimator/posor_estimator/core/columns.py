"""Where messages with raw readings have what, and messages with poses: what ``core.records`` works by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.kernels import records as kernel

if TYPE_CHECKING:
    from posor_estimator.core.types import IntArray


@dataclass(frozen=True)
class Columns:
    """Where the rows of readings have what, and the rows of poses: offsets in bytes, and how many numbers there are.

    What there is none of has the offset zero.

    Attributes:
        seconds: Of the stamp; nanoseconds follow, each of four bytes.
        number: Of the scan, eight bytes.
        status: Flags, four bytes; ``home`` says which of its bits is set where the home mark was seen.
        gaps: Gap voltages [V], and how many; numbers of eight bytes, as those that follow.
        rings: Ring voltages [V], and how many.
        currents: Contact currents [A], and how many.
        supply: [V].
        temperature: [K].
        lit: Sources lit, one byte each, and how many.
        home: See ``status``.
        to_stamp: Where the stamp is written.
        to_number: Where the scan's number is written.
        to_status: Where the scan's status is written.
        to_redundancy: Where the redundancy is written, and the state behind it, one byte each.
        to_faults: Where the faults are written, four bytes.
        to_pose: Where x, y, z [m] and the quaternion x, y, z, w are written.
        to_native: Where the six native coordinates are written.
        to_residual: Where the chi-square is written.
        to_covariance: Where the covariance is written, row by row.
        kind: Which covariance: 0 random, 1 systematic, 2 their sum.

    """

    seconds: int
    number: int
    status: int
    gaps: tuple[int, int]
    rings: tuple[int, int]
    currents: tuple[int, int]
    supply: int
    temperature: int
    lit: tuple[int, int]
    home: int
    to_stamp: int
    to_number: int
    to_status: int
    to_redundancy: int
    to_faults: int
    to_pose: int
    to_native: int
    to_residual: int
    to_covariance: int
    kind: int

    def record(self, redundancy: int) -> IntArray:
        """Return what ``kernels.records`` works by, for a POSOR of so many redundant readings.

        Raises:
            ValueError: A number does not lie at a multiple of its size.

        """
        words = {
            kernel.SECONDS: self.seconds,
            kernel.NANOSECONDS: self.seconds + 4,
            kernel.NUMBER: self.number,
            kernel.STATUS: self.status,
            kernel.TO_STAMP: self.to_stamp,
            kernel.TO_NUMBER: self.to_number,
            kernel.TO_VERDICT: self.to_redundancy,
            kernel.TO_FAULTS: self.to_faults,
            kernel.TO_STATUS: self.to_status,
        }
        longs = {
            kernel.GAPS: self.gaps[0],
            kernel.RINGS: self.rings[0],
            kernel.CURRENTS: self.currents[0],
            kernel.SUPPLY: self.supply,
            kernel.TEMPERATURE: self.temperature,
            kernel.TO_POSE: self.to_pose,
            kernel.TO_NATIVE: self.to_native,
            kernel.TO_RESIDUAL: self.to_residual,
            kernel.TO_COVARIANCE: self.to_covariance,
        }
        if any(offset % 4 for offset in words.values()) or any(offset % 8 for offset in (self.number, *longs.values())):
            message = "a number does not lie at a multiple of its size"
            raise ValueError(message)
        record: IntArray = np.zeros(kernel.RECORD + self.lit[1], dtype=np.int64)
        record[kernel.SAID_STATE] = -1  # there was no scan yet: whatever the first one is like is news
        for which, offset in words.items():
            record[which] = offset // 4
        for which, offset in longs.items():
            record[which] = offset // 8
        record[kernel.GAPS + 1], record[kernel.RINGS + 1] = self.gaps[1], self.rings[1]
        record[kernel.CURRENTS + 1] = self.currents[1]
        record[kernel.LIT : kernel.LIT + 2] = self.lit
        record[kernel.HOME], record[kernel.KIND], record[kernel.REDUNDANCY] = self.home, self.kind, redundancy
        return record
