"""From messages with raw readings to messages with poses, without taking them apart; what they are is not known here.

A message is a row of bytes whose numbers lie at multiples of their size; ``core.columns`` says what stands where.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from posor_estimator.core.compiled import code_for
from posor_estimator.core.estimate import Estimates
from posor_estimator.core.kernels import records as kernel
from posor_estimator.core.kernels.locate import LOST
from posor_estimator.core.kernels.readout import CODES, FAULTS, STATE
from posor_estimator.core.kernels.scan import RETRY, START, UNFIT
from posor_estimator.core.kernels.stamps import times_ns
from posor_estimator.core.kernels.tables import (
    FIGURES,
    OUTCOME,
    RANDOM,
    ROTATION,
    SYSTEMATIC,
    TRANSLATION,
)
from posor_estimator.core.scan import Scans, by_diode

if TYPE_CHECKING:
    from posor_estimator.core.columns import Columns
    from posor_estimator.core.posor import Posor
    from posor_estimator.core.types import ByteArray, FloatArray, IntArray, WordArray

    Views: TypeAlias = tuple[FloatArray, WordArray, FloatArray, FloatArray, WordArray]

STOPPED = {START: 0, RETRY: -1, UNFIT: 1}
"""Where a loop over one scan would have stopped, by what is left to do for it."""
SAID_STAMP, SAID_STATE, SAID_FAULTS, SAID_TAKEN, SAID_NEWS = (
    column - kernel.STAMP_NS
    for column in (kernel.STAMP_NS, kernel.SAID_STATE, kernel.SAID_FAULTS, kernel.SAID_TAKEN, kernel.SAID_NEWS)
)
"""Where ``Records.said`` has what."""
NOTHING_LIKE: WordArray = np.zeros((2, 0), dtype=np.int32)
"""For rows that are known to be of the right kind."""


class Verdict(NamedTuple):
    """How a scan went.

    Attributes:
        outcome: State, faults and codes, see ``kernels.tables``.
        chi_square: Of the redundant readings; NaN where there is none.
        degrees: Of freedom of a chi-square.

    """

    outcome: IntArray
    chi_square: float
    degrees: int

    @property
    def residual(self) -> float:
        """Chi-square of the redundant readings; NaN where the scan is LOST."""
        return math.nan if self.outcome[STATE] == LOST else self.chi_square

    @property
    def redundancy(self) -> int:
        """Degrees of freedom of the residual; zero of a LOST scan."""
        return 0 if self.outcome[STATE] == LOST else self.degrees


class Records:
    """A POSOR's way from rows of readings to rows of poses; what the estimate of the last of them is, stays to be read.

    Attributes:
        columns: Where the rows have what.
        record: The same and more for the kernels, see ``kernels.records``.
        tables: The POSOR's numbers.
        outcome: State, faults and codes of the last scan, shape (2 + sensors,).
        said: Its stamp [ns], state and faults, how often, up to it, a scan has read other rows than the one before,
            as where another source is lit, and whether one of the latter three is news, shape (5,), see ``SAID_STAMP``.

    """

    def __init__(self, posor: Posor, columns: Columns, template: ByteArray, *, fit: bool = True) -> None:
        """Prepare.

        Args:
            posor: The estimator.
            columns: Where the rows have what.
            template: A row of a pose, for what is the same in all, shape (k,).
            fit: Whether the readings may be used; else every scan is LOST, its readings bad.

        Raises:
            ValueError: A number does not lie at a multiple of its size.

        """
        self._posor = posor
        self._loop = posor.loop
        self.columns = columns
        self._template = template.view(np.float64)
        self.record = columns.record(posor.redundancy)
        self.record[kernel.FIT] = fit
        self.tables = tables = posor.loop.tables
        self._arrays = tables.arrays
        self.outcome = tables.of_ints(OUTCOME)[0]
        self.said = self.record[kernel.STAMP_NS : kernel.SAID_NEWS + 1]
        self._room = Estimates(
            scans=np.zeros(1, dtype=np.uint64),
            outcomes=tables.of_ints(OUTCOME),
            rotations=tables.of_floats(ROTATION)[None],
            translations=tables.of_floats(TRANSLATION),
            covariances_random=tables.of_floats(RANDOM)[None],
            covariances_systematic=tables.of_floats(SYSTEMATIC)[None],
            figures=tables.of_floats(FIGURES),
            redundancy=posor.redundancy,
        )

    @property
    def compiled(self) -> bool:
        """Whether the compiled loop can do all; else scans are located in Python, one by one."""
        return self._loop.compiled

    @property
    def fit(self) -> bool:
        """Whether readings may be used; else every scan is LOST."""
        return bool(self.record[kernel.FIT])

    def count_from_next(self) -> None:
        """Take the next scan for one that has seen the home mark."""
        self.record[kernel.AT_HOME] = 1

    @property
    def counts_from_next(self) -> bool:
        """Whether that scan has yet to come."""
        return bool(self.record[kernel.AT_HOME])

    def locate(self, raw: ByteArray, out: ByteArray) -> None:
        """Locate the scans in rows (n, w), from the last pose on, and write rows of poses (n, k)."""
        views, count, done = self.views(raw, out), len(raw), 0
        while done < count:
            if self.compiled:
                done = kernel.locate_many_records(*self._arrays, self.record, NOTHING_LIKE, *views, done, count)
            if done < count:
                self._finish(raw, views, done)
                done += 1

    def lane(self, raw: ByteArray, out: ByteArray, like: ByteArray) -> RecordLane:
        """Return the way for one scan at a time, always in the same two rows, (1, w) and (1, k).

        Args:
            raw: Row of readings, to be filled in place.
            out: Row of its pose, written in place.
            like: What every row of readings must be like: one, and which of its bits must be equal, shape (2, w).

        """
        return RecordLane(self, raw, out, like)

    def arguments(self, raw: ByteArray, out: ByteArray, like: ByteArray) -> tuple[object, ...]:
        """Return what ``kernels.records.locate_records`` is called with for one row."""
        return *self._arrays, self.record, like.view(np.int32), *self.views(raw, out), 0, 1

    def finish(self, raw: ByteArray, out: ByteArray, like: ByteArray) -> bool:
        """Do what was left to do for the only row; return whether it is one of readings of this kind."""
        views = self.views(raw, out)
        if self.compiled:
            of_this_kind = self.record[kernel.LEFT] != kernel.OTHER
        else:
            of_this_kind = kernel.is_like(views[1][0], like.view(np.int32))
        if of_this_kind:
            self._finish(raw, views, 0)
        return bool(of_this_kind)

    def verdict(self) -> Verdict:
        """Return how the last scan went."""
        return Verdict(self.outcome.copy(), float(self._room.residuals[0]), self._room.redundancy)

    def reason(self, row: ByteArray, verdict: Verdict) -> str:
        """Return the sentence on what was wrong with a scan, whose row (w,) this is; empty where nothing was."""
        outcome = verdict.outcome
        if outcome[FAULTS] == 0:
            return ""
        return self._posor.reason(self.scans(row[None])[0], outcome[CODES:], int(outcome[FAULTS]), verdict.chi_square)

    def scans(self, raw: ByteArray) -> Scans:
        """Return the scans in rows of readings (n, w)."""
        columns = self.columns
        floats, words = raw.view(np.float64), raw.view(np.int32)
        gaps, rings, currents = (
            np.ascontiguousarray(floats[:, begin // 8 : begin // 8 + length])
            for begin, length in (columns.gaps, columns.rings, columns.currents)
        )
        begin, length = columns.lit
        seconds = words[:, columns.seconds // 4].astype(np.int64)
        nanoseconds = words[:, columns.seconds // 4 + 1].astype(np.int64) & 0xFFFFFFFF
        return Scans(
            numbers=raw.view(np.uint64)[:, columns.number // 8].copy(),
            stamps_ns=times_ns(seconds, nanoseconds),
            gap_voltages=gaps,
            ring_voltages=rings,
            diode_currents=by_diode(currents),
            lit_sources=raw[:, begin : begin + length].astype(np.int64),
            supply_voltages=floats[:, columns.supply // 8].copy(),
            temperatures=floats[:, columns.temperature // 8].copy(),
            at_home=((words[:, columns.status // 4] & columns.home) != 0).astype(np.int64),
        )

    def _scan(self, row: ByteArray) -> Scans:
        """Return the scan in a row (1, w), which may count as having seen the home mark."""
        scans = self.scans(row)
        scans.at_home[0] |= self.record[kernel.AT_HOME]
        return scans

    def views(self, raw: ByteArray, out: ByteArray) -> Views:
        """Return rows of readings and of poses as the kernels take them."""
        return (
            raw.view(np.float64),
            raw.view(np.int32),
            self._template,
            out.view(np.float64),
            out.view(np.int32),
        )

    def _finish(self, raw: ByteArray, views: Views, n: int) -> None:
        """Do for the scan in row n what was left to do, and write its pose."""
        scans = self._scan(raw[n : n + 1])
        if not self.compiled:
            self.record[kernel.STAMP_NS] = scans.stamps_ns[0]
        if self.fit and scans.stamps_ns[0]:
            if self.compiled:
                self._loop.finish(scans, self._room, STOPPED[self.record.item(kernel.LEFT)])
            else:
                self._loop.run(scans, self._room)
            self.record[kernel.AT_HOME] = 0
        else:
            kernel.lose_record(*self._arrays)
        _, words, template, written, written_words = views
        kernel.write_record(*self._arrays, self.record, words[n], template, written[n], written_words[n])


class RecordLane:
    """One scan after the other in the same two rows.

    Attributes:
        row: Of readings, shape (w,).

    """

    def __init__(self, records: Records, raw: ByteArray, out: ByteArray, like: ByteArray) -> None:
        """Prepare; see ``Records.lane``."""
        self._records, self._rows = records, (raw, out, like)
        self.row = raw[0]
        self._arguments = records.arguments(raw, out, like)
        self._locate = code_for(kernel.locate_records, self._arguments) if records.compiled else None

    def run(self) -> bool:
        """Locate the scan in the row of readings; return False where it is not of this kind, and nothing was done."""
        if self._locate is not None and self._locate(*self._arguments) == 1:
            return True
        return self._records.finish(*self._rows)
