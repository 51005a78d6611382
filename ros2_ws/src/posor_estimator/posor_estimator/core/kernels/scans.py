"""Scan after scan, from arrays of raw readings to arrays of poses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor_estimator.core.compiled import in_place, without_lock
from posor_estimator.core.kernels.scan import RETRY, START, locate_one

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray


@in_place
def locate_scans(
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
        currents: (n, 4 diodes) [A].
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
    for n in range(begin, end):
        left = locate_one(
            places,
            ints,
            floats,
            stamps_ns[n],
            gap_voltages[n],
            ring_voltages[n],
            currents[n],
            lit[n],
            supplies[n],
            temperatures[n],
            at_home[n] != 0,
            outcomes[n],
            rotations[n],
            translations[n],
            random[n],
            systematic[n],
            figures[n],
        )
        if left == START:
            return n
        if left == RETRY:
            return -1 - n
    return end


@without_lock
def locate_many(*arguments: Any) -> int:
    """Do ``locate_scans`` while other threads run: for many scans. For one, taking the lock back costs more."""
    return locate_scans(*arguments)
