"""Scan after scan, from raw readings to poses. The same loop serves one scan at servo rate and a whole bag."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor_estimator.core.compiled import in_place, without_lock
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
    line,
    table,
)

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray


@in_place
def locate_scans(  # noqa: C901  the steps from scan to scan, to be compiled
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    stamps_ns: IntArray,
    gap_voltages: FloatArray,
    ring_voltages: FloatArray,
    currents: FloatArray,
    lit: IntArray,
    supplies: FloatArray,
    temperatures: FloatArray,
    at_home: IntArray,
    begin: int,
    end: int,
    outcomes: IntArray,
    rotations: FloatArray,
    translations: FloatArray,
    random: FloatArray,
    systematic: FloatArray,
    figures: FloatArray,
) -> int:
    """Locate scans ``begin`` to ``end``, as far as no start is wanted.

    Args:
        places: See ``kernels.tables``, as ``ints`` and ``floats``.
        ints: The POSOR's whole numbers.
        floats: The POSOR's numbers, its memory among them.
        stamps_ns: Middle of each exposure [ns], shape (n,).
        gap_voltages: As in ``Scans``, and those that follow.
        ring_voltages: (n, probes) [V].
        currents: (n, diodes, 4) [A].
        lit: (n, diodes).
        supplies: (n,) [V].
        temperatures: (n,) [K].
        at_home: (n,).
        begin: First scan.
        end: The scan after the last.
        outcomes: State, faults and codes to write, shape (n, 2 + sensors).
        rotations: R_R_T to write, shape (n, 3, 3).
        translations: Origin of T in R [m] to write, shape (n, 3).
        random: Random covariances to write, shape (n, 6, 6).
        systematic: Systematic covariances to write, shape (n, 6, 6).
        figures: What else is known of each scan to write, see FIGURES, shape (n, 14).

    Returns:
        ``end`` when done; n where scan n needs a start pose in the memory; ``-1 - n`` where scan n failed
        from the last pose and deserves another try from a fresh start.

    """
    settings, memory = line(places, floats, SETTINGS, 0), line(places, floats, MEMORY, 0)
    kinds, rows, prepared = line(places, ints, KINDS, 0), table(places, floats, ROWS), table(places, floats, PREPARED)
    pool_kinds, pool = line(places, ints, POOL_KINDS, 0), table(places, floats, POOL)
    here, chosen = line(places, ints, HERE, 0), table(places, ints, CHOSEN)
    whole = table(places, floats, READINGS)
    epoch = line(places, ints, EPOCH, 0)
    m = here.shape[0]
    if epoch[0] == 0 and end > begin:
        epoch[0], epoch[1] = 1, stamps_ns[begin]
    for n in range(begin, end):
        if not read_out(
            places,
            ints,
            floats,
            n,
            gap_voltages,
            ring_voltages,
            currents,
            lit,
            supplies[n],
            temperatures[n],
            outcomes,
        ):
            outcomes[n, STATE], outcomes[n, FAULTS] = LOST, 0
            figures[n, RESIDUAL] = math.nan
            write_lost(n, rotations, translations, random, systematic, figures)
            continue
        stamp = (stamps_ns[n] - epoch[1]) * 1e-9
        restart_if_back(stamp, memory)
        if memory[KNOWN] == 0.0:
            return n
        if not are_here(chosen, 0, here):
            take_rows(pool_kinds, pool, chosen, 0, here, kinds, rows, prepared)
            find_shares(places, ints, floats)
        elif settings[LAGGING] > 0.0:
            for r in range(m):
                turn_row(kinds[r], 0.0, rows, r, prepared)
        for i in range(m):
            for j in range(m):
                whole[i, j] = 0.0
        warm = memory[GIVEN] == 0.0
        rotation, translation = rotations[n], translations[n]
        start_from_memory(stamp, settings, memory, rotation, translation)
        state, fault = locate_scan(
            places,
            ints,
            floats,
            m,
            stamp,
            at_home[n] != 0,
            True,  # noqa: FBT003  kernels take no keywords
            rotation,
            translation,
            random[n],
            systematic[n],
            figures[n],
        )
        outcomes[n, STATE], outcomes[n, FAULTS] = state, fault
        if state == LOST:
            write_lost(n, rotations, translations, random, systematic, figures)
        if deserves_retry(state, fault, warm):
            return -1 - n
    return end


@without_lock
def locate_many(*arguments: Any) -> int:
    """Do ``locate_scans`` while other threads run: for many scans. For one, taking the lock back costs more."""
    return locate_scans(*arguments)


@in_place
def write_lost(
    n: int,
    rotations: FloatArray,
    translations: FloatArray,
    random: FloatArray,
    systematic: FloatArray,
    figures: FloatArray,
) -> None:
    """Make every number of scan n NaN, but for the chi-square that may have been the reason."""
    for i in range(3):
        translations[n, i] = math.nan
        for j in range(3):
            rotations[n, i, j] = math.nan
    for i in range(6):
        for j in range(6):
            random[n, i, j] = math.nan
            systematic[n, i, j] = math.nan
    for i in range(RESIDUAL):
        figures[n, i] = math.nan
