"""From a scan's raw readings to linearised ones, sensor by sensor.

Readouts (6 numbers), one for each sensor: where its readings come from, its first reading, its first channel or diode,
how many of them, its first row in the pool, and how many light sources each diode may see.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import inlined
from posor_estimator.core.kernels.diode import CONTACTS, linearise_spots
from posor_estimator.core.kernels.tables import (
    BASIS,
    BY_READOUT,
    CHANNELS,
    CHOSEN,
    DIODES,
    LINES,
    MAPS,
    READOUTS,
    SPOT,
    VALUES,
    VARIANCES,
    line,
    table,
)
from posor_estimator.core.kernels.voltage import linearise_voltages

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

GAP_VOLTAGES = 0
RING_VOLTAGES = 1
SPOTS = 2

STATE, FAULTS, CODES = 0, 1, 2
"""Outcomes of a scan: state, faults, then a code of each sensor, zero where its readings are fit."""

WRONG_COUNT = -1
WRONG_SOURCES = -2
WRONG_SOURCE = -3
"""And below: of diode (WRONG_SOURCE - code)."""


@inlined
def choose_spots(
    currents: FloatArray, lit: IntArray, count: int, sources: int, offset: int, chosen: IntArray, first: int
) -> int:
    """Write which rows of the pool a scan reads, by the sources lit; return zero or what is wrong with the scan."""
    if currents.shape[0] != CONTACTS * count:
        return WRONG_COUNT
    if lit.shape[0] != count:
        return WRONG_SOURCES
    for i in range(count):
        if lit[i] < 0 or lit[i] >= sources:
            return WRONG_SOURCE - i
        for axis in range(2):
            chosen[first + 2 * i + axis] = offset + 2 * (i * sources + lit[i]) + axis
    return 0


@inlined
def choose_rows(readouts: IntArray, s: int, currents: FloatArray, lit: IntArray, chosen: IntArray) -> int:
    """Write which rows of the pool sensor s reads; return zero or what is wrong with the scan."""
    first, count, offset = readouts[s, 1], readouts[s, 3], readouts[s, 4]
    if readouts[s, 0] == SPOTS:
        return choose_spots(currents, lit, count, readouts[s, 5], offset, chosen, first)
    for i in range(count):
        chosen[first + i] = offset + i
    return 0


@inlined
def read_out(
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    gap_voltages: FloatArray,
    ring_voltages: FloatArray,
    currents: FloatArray,
    lit: IntArray,
    supply: float,
    temperature: float,
    outcome: IntArray,
) -> bool:
    """Linearise one scan; return whether it is fit.

    Args:
        places: See ``kernels.tables``.
        ints: See ``kernels.tables``; CHOSEN is written.
        floats: See ``kernels.tables``; values, variances and BY_READOUT are written.
        gap_voltages: Gap probes' outputs [V], shape (p,).
        ring_voltages: Ring probes' outputs [V], shape (p,).
        currents: Contact currents [A], shape (4 d,).
        lit: Which source was lit for each diode, shape (d,).
        supply: Supply voltage [V] or NaN.
        temperature: Temperature [K] or NaN.
        outcome: What is wrong with each sensor to write from entry 2 on, shape (2 + sensors,); after the first that is
            unfit none is looked at.

    """
    readouts, chosen = table(places, ints, READOUTS), line(places, ints, CHOSEN, 0)
    values, variances = line(places, floats, LINES, VALUES), line(places, floats, LINES, VARIANCES)
    by_readout = table(places, floats, BY_READOUT)
    for s in range(readouts.shape[0]):
        outcome[CODES + s] = 0
    for s in range(readouts.shape[0]):
        source, first, begin, count = readouts[s, 0], readouts[s, 1], readouts[s, 2], readouts[s, 3]
        code = choose_rows(readouts, s, currents, lit, chosen)
        if source == SPOTS:
            if code == 0:
                diodes, maps = table(places, floats, DIODES), table(places, ints, MAPS)
                room, basis = table(places, floats, SPOT), table(places, floats, BASIS)
                code = linearise_spots(currents, diodes, maps, begin, values, variances, by_readout, first, room, basis)
        else:
            volts = gap_voltages if source == GAP_VOLTAGES else ring_voltages
            code = WRONG_COUNT
            if volts.shape[0] == count:
                channels = table(places, floats, CHANNELS)
                code = linearise_voltages(
                    volts, supply, temperature, channels, begin, values, variances, by_readout, first
                )
        if code != 0:
            outcome[CODES + s] = code
            return False
    return True
