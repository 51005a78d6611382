"""Scans of several POSORs of one design at once: as many as the processor computes with together (``kernels.eight``).

The poses are those that each POSOR finds alone, to the last bit. A scan that is not ordinary (``kernels.abreast``), and
those of the other POSORs that have their turn with it, are located one by one. So are twice as many more with every
further one that comes soon, so that stretches in which many are take hardly longer than without all this.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from posor_estimator.core.compiled import COMPILING, EIGHT
from posor_estimator.core.kernels import tables as layout
from posor_estimator.core.kernels.abreast import FOUND, locate_abreast
from posor_estimator.core.kernels.abreast_read import VOLTAGES
from posor_estimator.core.kernels.abreast_solve import OF_A_ROW, OF_ALL
from posor_estimator.core.kernels.diode import CONTACTS
from posor_estimator.core.kernels.effects import COLUMNS, TOGETHER
from posor_estimator.core.kernels.eight import ALIGNED
from posor_estimator.core.kernels.memory import BUMP, GIVEN, KNOWN, LAGGING
from posor_estimator.core.kernels.readout import GAP_VOLTAGES, SPOTS
from posor_estimator.core.kernels.spot_map import CURVES
from posor_estimator.core.kernels.taking_turns import give_out, take_in

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.records import Records
    from posor_estimator.core.types import ByteArray, FloatArray

    Design: TypeAlias = tuple[bytes, ...]

LEAST = 3
"""POSORs that are worth it: two take as long alone."""
WORTH = 16
"""Scans of each that are worth it: where fewer stand between two that are not ordinary, these go alone as well."""
AT_ONCE = 256
"""Scans of each that are on their way together: what is read and found of them stays in the processor's cache."""
LONGEST_ALONE = 64
"""Scans of each that are located one by one at most before the next try."""


def design_of(records: Records) -> Design | None:
    """Return what POSORs must have in common for their scans to be located abreast; None where one cannot be."""
    tables, columns = records.tables, records.columns
    readouts, maps = tables.of_ints(layout.READOUTS), tables.of_ints(layout.MAPS)
    settings = tables.of_floats(layout.SETTINGS)[0]
    if not (COMPILING and records.compiled and records.fit):
        return None
    # Gap probes and diodes, once each, as many as the scans have readings of.
    wanted = [[GAP_VOLTAGES, columns.gaps[1]], [SPOTS, columns.currents[1] // CONTACTS]]
    if sorted(readouts[:, [0, 3]].tolist()) != wanted or columns.lit[1] != wanted[1][1]:
        return None
    if settings[BUMP] > 0.0 or settings[LAGGING] > 0.0 or CURVES in maps[:, 0]:
        return None
    places = tables.places[list(layout.COMMON)]
    return places.tobytes(), readouts[:, :4].tobytes(), maps.tobytes(), bytes([columns.kind])


class Abreast:
    """Locates the scans of three to eight POSORs of one design (``design_of``).

    Of the last scan each POSOR keeps the pose, from which the next one starts, but not the covariances.
    """

    def __init__(self, records: Sequence[Records]) -> None:
        """Make room for them; ``records`` is each POSOR's way from rows of readings to rows of poses."""
        common = [records[0].tables.place(which).stop for which in layout.COMMON]
        width = records[0].columns.gaps[1] + records[0].columns.currents[1] + VOLTAGES
        m = records[0].tables.of_ints(layout.HERE).size
        self._numbers, self._trial = _room(max(common)), _room(OF_A_ROW * m + OF_ALL)
        self._readings, self._found = _room(AT_ONCE * width).ravel(), _room(AT_ONCE * FOUND).ravel()
        self._width, self._kind = width, records[0].columns.kind
        self._lanes = [_Lane(each, turn, len(records), self._numbers) for turn, each in enumerate(records)]

    def locate(self, raw: Sequence[ByteArray], out: Sequence[ByteArray]) -> None:
        """Locate scans from the last poses on.

        Args:
            raw: Rows of readings of each POSOR, as many of each, (n, w).
            out: Rows of poses to write, (n, k).

        """
        for lane, readings, poses in zip(self._lanes, raw, out, strict=True):
            lane.work_on(readings, poses)
        try:
            self._locate(len(raw[0]))
        finally:
            for lane in self._lanes:
                lane.rest()

    def _locate(self, count: int) -> None:
        done, alone = 0, 1
        while done < count:
            tried, located = self._step(done, min(done + AT_ONCE, count))
            done += located
            if located == tried and located >= WORTH:
                alone = 1
                continue
            end = min(done + alone, count)
            for lane in self._lanes:
                lane.locate_alone(done, end)
            done, alone = end, min(2 * alone, LONGEST_ALONE)

    def _step(self, begin: int, end: int) -> tuple[int, int]:
        """Try to locate scans of each, up to the first that is not ordinary; return how many were tried, and located.

        None are tried where the first ones are not ordinary, as far as the readings tell.
        """
        first = self._lanes[0]
        if not all(lane.is_known() for lane in self._lanes):
            return 0, 0
        for lane in self._lanes:
            end = lane.take_in(self._readings, begin, end)
        if end == begin or any(lane.pattern != first.pattern for lane in self._lanes):
            return 0, 0
        places, ints, tried = first.tables.places, first.tables.ints, end - begin
        numbers, trial = self._numbers.ravel(), self._trial.ravel()
        of_scans = self._readings, self._found, self._width, self._kind, tried
        located = locate_abreast(places, ints, numbers, trial, *of_scans)
        for lane in self._lanes:
            lane.give_out(self._found, begin, begin + located)
        return tried, located


class _Lane:
    """One POSOR whose numbers take turns with those of others.

    Its own tables hold the pose before while it is located alone, the common numbers while it is not.
    """

    def __init__(self, records: Records, turn: int, turns: int, numbers: FloatArray) -> None:
        self.tables = records.tables
        self.pattern: tuple[bytes, ...] = ()
        self._records, self._turn = records, turn
        # The first stands in for those that are missing.
        self._spare = turns if turn == 0 else EIGHT
        self._turns = [turn, *range(self._spare, EIGHT)]
        self._numbers = numbers
        self._memory = self.tables.place(layout.MEMORY)
        self._of_posor = *self.tables.arrays, records.record
        self._taken = self.tables.of_ints(layout.TAKEN)[0]
        self._taken_here = -1
        self._abreast = False

    def work_on(self, raw: ByteArray, out: ByteArray) -> None:
        """Take the next rows of readings, and room for rows of poses."""
        self._raw, self._out, self._views = raw, out, self._records.views(raw, out)

    def is_known(self) -> bool:
        """Return whether there is a pose to go on from that is not a mere start."""
        if self._abreast:
            return True
        memory = self.tables.floats[self._memory]
        return bool(memory[KNOWN] == 1.0 and memory[GIVEN] == 0.0)

    def take_in(self, readings: FloatArray, begin: int, end: int) -> int:
        """Write scans to where they are read; return the row after the last that can be tried."""
        raw, words, *_ = self._views
        end = take_in(*self._of_posor, raw, words, readings, self._turn, self._spare, begin, end)
        if self._taken[0] != self._taken_here:
            self.remember()
            self._taken_here = int(self._taken[0])
            self.pattern = self._pattern()
        if not self._abreast:
            self._numbers[:, self._turns] = self.tables.floats[: len(self._numbers), None]
            self._abreast = True
        return end

    def give_out(self, found: FloatArray, begin: int, end: int) -> None:
        """Write rows of poses."""
        _, words, template, out, out_words = self._views
        give_out(*self._of_posor, words, template, out, out_words, found, self._turn, begin, end)

    def remember(self) -> None:
        """Keep the last pose with the POSOR itself."""
        if self._abreast:
            self.tables.floats[self._memory] = self._numbers[self._memory, self._turn]
            self._abreast = False

    def rest(self) -> None:
        """Keep the last pose with the POSOR itself, and nothing of the rows."""
        self.remember()
        del self._raw, self._out, self._views

    def locate_alone(self, begin: int, end: int) -> None:
        """Locate scans one by one."""
        self.remember()
        self._records.locate(self._raw[begin:end], self._out[begin:end])

    def _pattern(self) -> tuple[bytes, ...]:
        """Return what is to be done for its scans, whose numbers may differ."""
        tables = self.tables
        tally = tables.of_ints(layout.TALLY)[0]
        shares = tables.of_ints(layout.SHARES)[: tally[TOGETHER]]
        blocks = tables.of_ints(layout.BLOCKS)[: tally[COLUMNS]]
        kinds = tables.of_ints(layout.KINDS)[0, : tables.of_ints(layout.HERE).size]
        return tuple(each.tobytes() for each in (kinds, tally, shares, blocks, tables.of_ints(layout.REACH)))


def _room(count: int) -> FloatArray:
    """Return room for eights (count, 8), where the processor wants it."""
    room = np.zeros(EIGHT * count + ALIGNED // 8)
    begin = -room.ctypes.data % ALIGNED // 8
    return room[begin : begin + EIGHT * count].reshape(count, EIGHT)
