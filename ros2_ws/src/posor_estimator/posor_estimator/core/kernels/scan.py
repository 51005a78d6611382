"""One scan from its raw readings to its pose: read out, start, locate."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import in_place, inlined
from posor_estimator.core.kernels.effects import find_shares
from posor_estimator.core.kernels.locate import LOST, RESIDUAL, deserves_retry, locate_scan
from posor_estimator.core.kernels.memory import GIVEN, KNOWN, LAGGING, restart_if_back, start_from_memory
from posor_estimator.core.kernels.readout import FAULTS, STATE, read_out
from posor_estimator.core.kernels.rows import are_here, take_rows, turn_row
from posor_estimator.core.kernels.tables import (
    CHOSEN,
    EPOCH,
    HERE,
    KINDS,
    MEMORY,
    POOL,
    POOL_KINDS,
    PREPARED,
    READINGS,
    ROWS,
    SETTINGS,
    TAKEN,
    line,
    table,
)

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

DONE, START, RETRY, UNFIT = 0, 1, 2, 3
"""What is left to do for a scan: nothing; to start it, since no pose is known; to start it afresh, since it failed from
the last pose; to say what its codes mean."""


@inlined
def locate_one(
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    stamp_ns: int,
    gap_voltages: FloatArray,
    ring_voltages: FloatArray,
    currents: FloatArray,
    lit: IntArray,
    supply: float,
    temperature: float,
    at_home: bool,  # noqa: FBT001  kernels take no keywords
    outcome: IntArray,
    rotation: FloatArray,
    translation: FloatArray,
    random: FloatArray,
    systematic: FloatArray,
    figures: FloatArray,
) -> int:
    """Locate one scan, from the last pose on.

    Args:
        places: See ``kernels.tables``, as ``ints`` and ``floats``.
        ints: The POSOR's whole numbers.
        floats: The POSOR's numbers, its memory among them.
        stamp_ns: Middle of the exposure [ns].
        gap_voltages: See ``read_out``, as those that follow.
        ring_voltages: (probes,) [V].
        currents: (4 diodes,) [A].
        lit: (diodes,).
        supply: [V].
        temperature: [K].
        at_home: Whether the scan saw the home mark.
        outcome: State, faults and codes to write, shape (2 + sensors,).
        rotation: R_R_T to write, shape (3, 3).
        translation: Origin of T in R [m] to write, shape (3,).
        random: Random covariance to write, shape (6, 6).
        systematic: Systematic covariance to write, shape (6, 6).
        figures: What else is known of the scan to write, see FIGURES, shape (14,).

    Returns:
        DONE, or what is left to do; where that is START nothing but codes has been written.

    """
    settings, memory = line(places, floats, SETTINGS, 0), line(places, floats, MEMORY, 0)
    epoch = line(places, ints, EPOCH, 0)
    if epoch[0] == 0:
        epoch[0], epoch[1] = 1, stamp_ns
    if not read_out(
        places,
        ints,
        floats,
        gap_voltages,
        ring_voltages,
        currents,
        lit,
        supply,
        temperature,
        outcome,
    ):
        outcome[STATE], outcome[FAULTS] = LOST, 0
        figures[RESIDUAL] = math.nan
        write_lost(rotation, translation, random, systematic, figures)
        return UNFIT
    stamp = (stamp_ns - epoch[1]) * 1e-9
    restart_if_back(stamp, memory)
    if memory[KNOWN] == 0.0:
        return START
    kinds, rows, prepared = line(places, ints, KINDS, 0), table(places, floats, ROWS), table(places, floats, PREPARED)
    whole = table(places, floats, READINGS)
    m = line(places, ints, HERE, 0).shape[0]
    if not are_here(table(places, ints, CHOSEN), 0, line(places, ints, HERE, 0)):
        take_up(places, ints, floats)
    elif settings[LAGGING] > 0.0:
        for r in range(m):
            turn_row(kinds[r], 0.0, rows, r, prepared)
    for i in range(m):
        for j in range(m):
            whole[i, j] = 0.0
    warm = memory[GIVEN] == 0.0
    start_from_memory(stamp, settings, memory, rotation, translation)
    state, fault = locate_scan(
        places,
        ints,
        floats,
        m,
        stamp,
        at_home,
        True,  # noqa: FBT003  kernels take no keywords
        rotation,
        translation,
        random,
        systematic,
        figures,
    )
    outcome[STATE], outcome[FAULTS] = state, fault
    if state == LOST:
        write_lost(rotation, translation, random, systematic, figures)
    return RETRY if deserves_retry(state, fault, warm) else DONE


@in_place
def take_up(places: IntArray, ints: IntArray, floats: FloatArray) -> None:
    """Take the rows in CHOSEN out of the pool, and find out what their parameters share."""
    kinds, rows, prepared = line(places, ints, KINDS, 0), table(places, floats, ROWS), table(places, floats, PREPARED)
    pool_kinds, pool = line(places, ints, POOL_KINDS, 0), table(places, floats, POOL)
    take_rows(pool_kinds, pool, table(places, ints, CHOSEN), 0, line(places, ints, HERE, 0), kinds, rows, prepared)
    find_shares(places, ints, floats)
    taken = line(places, ints, TAKEN, 0)
    taken[0] += 1


@in_place
def write_lost(
    rotation: FloatArray, translation: FloatArray, random: FloatArray, systematic: FloatArray, figures: FloatArray
) -> None:
    """Make every number of a scan NaN, but for the chi-square that may have been the reason."""
    for i in range(3):
        translation[i] = math.nan
        for j in range(3):
            rotation[i, j] = math.nan
    for i in range(6):
        for j in range(6):
            random[i, j] = math.nan
            systematic[i, j] = math.nan
    for i in range(RESIDUAL):
        figures[i] = math.nan
