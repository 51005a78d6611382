"""What the compiled loop over scans works on: a POSOR's numbers and its room for work, in one array of each type.

``places`` (n, 3) says where each table stands: start, rows, columns. One array of floats and one of whole numbers,
since every array that a compiled function is called with costs as much as the arithmetic of a row. ``core.tables``
makes them. Sizes: m readings; M = m + 6, with room for the prior; K rows in the pool of width W; L parameters at most
in the linearisation of a reading; C standard deviates that the calibration's parameters are made of; F factors that
those of a scan's readings have at most, and S deviates that they share at most.

The tables of floats whose size the number of light sources does not change stand in front, ``COMMON``: where POSORs of
one design have them is the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from posor_estimator.core.compiled import written_out
from posor_estimator.core.kernels.reshaped import part

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from posor_estimator.core.types import IntArray

    Numbers = TypeVar("Numbers", np.float64, np.int64)

# Of the POSOR, floats.
POOL = 0  # every row that a scan can have (K, W)
ROOT = 1  # what each parameter is made of, see PARTS (1, entries)
CHANNELS = 2  # see kernels.voltage (channels, n + 8)
DIODES = 3  # see kernels.diode (diodes, 12 + p)
SETTINGS = 4  # see kernels.memory (1, 7)
# Of the POSOR, whole numbers.
POOL_KINDS = 5  # (1, K)
POOL_IDS = 6  # which parameter each entry of the pool is, negative: none (K, W)
READOUT_IDS = 7  # which parameter each derivative of a reading's linearisation belongs to (m, L)
PARTS = 8  # of each parameter: its first deviate, how many, where their factors begin in ROOT (parameters, 3)
READOUTS = 9  # see kernels.readout (readouts, 6)
# Room that keeps its contents from scan to scan.
MEMORY = 10  # floats, see kernels.memory (1, 22)
ROWS = 11  # floats: the rows of the scan, then the prior's (M, W)
PREPARED = 12  # floats: see kernels.rows (M, PREPARED)
KINDS = 13  # (1, M)
HERE = 14  # which rows of the pool stand in ROWS (1, m)
SHARES = 15  # see kernels.effects (m (W + L), 3)
BLOCKS = 16  # see kernels.effects (C, 4)
TALLY = 17  # see kernels.effects (1, 3)
DEVIATES = 18  # see kernels.effects (C, 3)
# Room for one scan.
CHOSEN = 19  # whole numbers (1, m)
LINES = 20  # floats: values, variances, weights, residuals (4, M)
JACOBIAN = 21  # floats (M, 6)
MOVED = 22  # floats: sum of the steps (1, 6)
SPREAD = 23  # floats: what the residuals spread by along the directions of BLIND (m - 6, m - 6)
START = 24  # floats: the pose from which a scan starts, rotation and translation (4, 3)
BY_ROW = 25  # floats: derivatives of prediction less reading by the rows' parameters (m, W)
BY_READOUT = 26  # floats: the same by the linearisation's parameters (m, L)
EFFECTS = 27  # floats: what each shared deviate does to each reading, its zeros kept from scan to scan (m, S)
READINGS = 28  # floats: the readings' systematic covariance (m, m)
BLIND = 29  # floats: directions of the readings that no pose explains, and the residuals along them (m - 6, m + 1)
GAIN = 30  # floats: change of the pose for one of each reading (m, 6)
MAPS = 31  # whole numbers, of the POSOR: kind and lengths of each diode's map (diodes, 3)
SPOT = 32  # floats: see kernels.diode (4, 2)
BASIS = 33  # floats: see kernels.spot_map (4, longest)
EPOCH = 34  # whole numbers that stay: 1 where it is known, from which time the memory counts [ns] (1, 2)
FACTORS = 35  # floats: those of the normal matrix at the solution, see kernels.blocks (7, 3)
REACH = 36  # whole numbers: from which to before which reading each is correlated with others (m, 2)
TAKEN = 37  # whole numbers that stay: how often other rows of the pool have been taken (1, 1)
TAKEN_ROOT = 38  # floats: factors of ROOT that the scan needs, in the order of SHARES (1, F)
# Room for one estimate.
OUTCOME = 39  # whole numbers, see kernels.readout (1, 2 + sensors)
ROTATION = 40  # floats (3, 3)
TRANSLATION = 41  # floats (1, 3)
RANDOM = 42  # floats (6, 6)
SYSTEMATIC = 43  # floats (6, 6)
FIGURES = 44  # floats, see kernels.locate (1, 14)
TABLES = 45

VALUES, VARIANCES, WEIGHTS, RESIDUALS = 0, 1, 2, 3

COMMON = (
    TAKEN_ROOT,
    CHANNELS,
    DIODES,
    SETTINGS,
    MEMORY,
    ROWS,
    PREPARED,
    LINES,
    JACOBIAN,
    MOVED,
    SPREAD,
    START,
    BY_ROW,
    BY_READOUT,
    EFFECTS,
    READINGS,
    BLIND,
    GAIN,
    SPOT,
    BASIS,
    FACTORS,
    ROTATION,
    TRANSLATION,
    RANDOM,
    SYSTEMATIC,
    FIGURES,
)


@written_out
def table(places: IntArray, numbers: NDArray[Numbers], which: int) -> NDArray[Numbers]:
    """Return a table of ``numbers``, without copying."""
    return part(numbers, places[which, 0], places[which, 1], places[which, 2])


@written_out
def line(places: IntArray, numbers: NDArray[Numbers], which: int, row: int) -> NDArray[Numbers]:
    """Return one row of a table of ``numbers``, without copying."""
    columns = places[which, 2]
    start = places[which, 0] + row * columns
    return numbers[start : start + columns]
