"""A POSOR's numbers and its room for work, laid out for the compiled loop over scans (``kernels.tables``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.kernels import tables as layout
from posor_estimator.core.kernels.gap import PREPARED
from posor_estimator.core.kernels.locate import FIGURES
from posor_estimator.core.kernels.memory import MEMORY, SETTINGS
from posor_estimator.core.kernels.readout import SPOTS
from posor_estimator.core.kernels.reshaped import viewed
from posor_estimator.core.kernels.voltage import COLUMNS, EXTRA_PARAMETERS
from posor_estimator.core.sensors.base import RowSensor

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from numpy.typing import NDArray

    from posor_estimator.core.root import Root
    from posor_estimator.core.sensors.base import Readout
    from posor_estimator.core.stack import Stack
    from posor_estimator.core.types import FloatArray, IntArray

    Made = dict[int, NDArray[Any]]


class Tables:
    """The tables of one POSOR.

    Attributes:
        places: Where each table stands, shape (tables, 3).
        ints: Those of whole numbers, end to end.
        floats: Those of floats, end to end.
        root: What the parameters are made of, shape (p, deviates); none where the compiled loop needs no help.
        complete: Whether the compiled loop can go all the way: every sensor of the stack has a readout.

    """

    def __init__(self, stack: Stack, root: Root) -> None:
        """Lay out the tables of a stack whose parameters are made of ``root``."""
        readouts = [sensor.readout() if isinstance(sensor, RowSensor) else None for sensor in stack.sensors]
        self.complete = None not in readouts
        self.root = np.zeros((0, 0)) if self.complete else root.dense()
        made: Made = {
            layout.POOL: stack.pool.rows,
            layout.ROOT: root.factors,
            layout.POOL_KINDS: stack.pool.kinds,
            layout.POOL_IDS: stack.pool.ids,
            layout.PARTS: root.parts,
            **_of_readouts(stack, readouts),
        }
        width, length = stack.pool.rows.shape[1], made[layout.READOUT_IDS].shape[1]
        factors = _most_factors(made, stack.readings)
        made |= _rooms(stack.readings, width, length, root.deviates, factors, len(stack.sensors))
        made[layout.HERE][:] = -1
        made = {which: made[which] for which in (*layout.COMMON, *made)}
        self.places = np.zeros((layout.TABLES, 3), dtype=np.int64)
        self.ints: IntArray = self._laid(made, np.int64)
        self.floats: FloatArray = self._laid(made, np.float64)

    def _laid(self, made: Made, numbers: type[Any]) -> NDArray[Any]:
        """Return all tables of one type end to end, their places written down."""
        pieces, end = [np.zeros(0, dtype=numbers)], 0
        for which, table in made.items():
            if table.dtype == numbers:
                self.places[which] = end, *np.atleast_2d(table).shape
                pieces.append(table.ravel())
                end += table.size
        return np.concatenate(pieces)

    @property
    def arrays(self) -> tuple[IntArray, IntArray, FloatArray]:
        """What kernels are called with: places, whole numbers, floats."""
        return self.places, self.ints, self.floats

    def place(self, which: int) -> slice:
        """Return where in its array a table stands."""
        start, rows, columns = self.places[which].tolist()
        return slice(start, start + rows * columns)

    def of_ints(self, which: int) -> IntArray:
        """Return a table of whole numbers, to be written to as well."""
        return viewed(self.ints, *self.places[which])

    def of_floats(self, which: int) -> FloatArray:
        """Return a table of floats, to be written to as well."""
        return viewed(self.floats, *self.places[which])


def _most_factors(made: Made, m: int) -> int:
    """Return how many factors of ROOT the parameters of m readings have at most."""
    counts = np.append(made[layout.PARTS][:, 1], 0)  # the last one for no parameter, -1
    of_rows, of_readouts = (counts[made[which]].sum(axis=1) for which in (layout.POOL_IDS, layout.READOUT_IDS))
    return m * int(of_rows.max(initial=0)) + int(of_readouts.sum())


def _rooms(m: int, width: int, length: int, deviates: int, factors: int, sensors: int) -> Made:
    """Return the room for work; sizes as in ``kernels.tables``."""
    room, redundant = m + 6, max(m - 6, 0)
    floats = {
        layout.SETTINGS: (1, SETTINGS),
        layout.MEMORY: (1, MEMORY),
        layout.ROWS: (room, width),
        layout.PREPARED: (room, PREPARED),
        layout.LINES: (4, room),
        layout.JACOBIAN: (room, 6),
        layout.MOVED: (1, 6),
        layout.SPREAD: (redundant, redundant),
        layout.START: (4, 3),
        layout.BY_ROW: (m, width),
        layout.BY_READOUT: (m, length),
        layout.EFFECTS: (m, min(deviates, factors)),
        layout.TAKEN_ROOT: (1, factors),
        layout.READINGS: (m, m),
        layout.BLIND: (redundant, m + 1),
        layout.GAIN: (m, 6),
        layout.SPOT: (4, 2),
        layout.BASIS: (4, length),
        layout.FACTORS: (7, 3),
        layout.ROTATION: (3, 3),
        layout.TRANSLATION: (1, 3),
        layout.RANDOM: (6, 6),
        layout.SYSTEMATIC: (6, 6),
        layout.FIGURES: (1, FIGURES),
    }
    ints = {
        layout.KINDS: (1, room),
        layout.HERE: (1, m),
        layout.SHARES: (m * (width + length), 3),
        layout.BLOCKS: (deviates, 4),
        layout.TALLY: (1, 3),
        layout.DEVIATES: (deviates, 3),
        layout.CHOSEN: (1, m),
        layout.EPOCH: (1, 2),
        layout.REACH: (m, 2),
        layout.TAKEN: (1, 1),
        layout.OUTCOME: (1, 2 + sensors),
    }
    return {which: np.zeros(shape) for which, shape in floats.items()} | {
        which: np.zeros(shape, dtype=np.int64) for which, shape in ints.items()
    }


def _of_readouts(stack: Stack, readouts: Sequence[Readout | None]) -> Made:
    """Return the tables for linearising: what is told of each sensor, its channels or diodes, its parameters."""
    present = [readout for readout in readouts if readout is not None]
    spots = [readout for readout in present if readout.source == SPOTS]
    probes = [readout for readout in present if readout.source != SPOTS]
    order = max([1, *(readout.numbers.shape[1] - COLUMNS for readout in probes)])
    length = max([order + EXTRA_PARAMETERS, *(readout.ids.shape[1] for readout in spots)])
    ids = np.full((stack.readings, length), -1, dtype=np.int64)
    told = np.zeros((len(readouts), 6), dtype=np.int64)
    begins = {True: 0, False: 0}
    for s, readout in enumerate(readouts):
        if readout is None:
            continue
        is_spots, first, count = readout.source == SPOTS, stack.first_rows[s], len(readout.numbers)
        told[s] = readout.source, first, begins[is_spots], count, stack.first_pool_rows[s], readout.sources
        begins[is_spots] += count
        own = readout.ids if is_spots else _of_order(readout.ids, order, EXTRA_PARAMETERS, -1)
        own = np.where(own >= 0, own + stack.first_parameters[s], -1)
        ids[first : first + len(own), : own.shape[1]] = own
    longest = max([0, *(readout.numbers.shape[1] for readout in spots)])
    return {
        layout.READOUTS: told,
        layout.READOUT_IDS: ids,
        layout.CHANNELS: np.concatenate(
            [np.zeros((0, order + COLUMNS)), *(_of_order(r.numbers, order, COLUMNS, 0) for r in probes)]
        ),
        layout.DIODES: np.concatenate(
            [np.zeros((0, longest)), *(np.pad(r.numbers, ((0, 0), (0, longest - r.numbers.shape[1]))) for r in spots)]
        ),
        layout.MAPS: np.concatenate([np.zeros((0, 3), dtype=np.int64), *(readout.maps for readout in spots)]),
    }


def _of_order(numbers: NDArray[Any], order: int, behind: int, fill: int) -> NDArray[Any]:
    """Return channels whose coefficients are filled up to an order; ``behind`` columns stand behind them."""
    own = numbers.shape[1] - behind
    filled = np.full((len(numbers), order - own), fill, dtype=numbers.dtype)
    return np.concatenate([numbers[:, :own], filled, numbers[:, own:]], axis=1)
