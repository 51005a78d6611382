"""Linearise the readings of a scan of each of eight POSORs, see ``kernels.abreast``.

Readings (3 + gaps + currents): time of the scan [s], from the memories' epochs, supply [V], temperature [K], gap
voltages [V], contact currents [A].
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import inlined
from posor_estimator.core.kernels.diode import CONTACTS, DOMAIN, FRAME, MAP, SUMS, write_variances
from posor_estimator.core.kernels.readout import SPOTS
from posor_estimator.core.kernels.spot_map import tensor
from posor_estimator.core.kernels.tables import (
    BASIS,
    BY_READOUT,
    CHANNELS,
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
from posor_estimator.core.kernels.voltage import COLUMNS, HIGHEST, LOWEST, write_gap

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

TIME, SUPPLY, TEMPERATURE, VOLTAGES = 0, 1, 2, 3


@inlined
def read_abreast(places: IntArray, ints: IntArray, floats: FloatArray, readings: FloatArray) -> bool:
    """Write values, variances and BY_READOUT; return which of the eight have all readings in their ranges.

    Args:
        places: See ``kernels.tables``.
        ints: Of any of the POSORs.
        floats: Eights.
        readings: See the module, eights.

    """
    readouts, gaps = table(places, ints, READOUTS), 0
    in_range: bool = readings[TIME] == readings[TIME]  # of all, until told otherwise
    for s in range(readouts.shape[0]):
        if readouts[s, 0] != SPOTS:
            gaps = readouts[s, 3]
            in_range &= read_gaps(places, floats, readings, readouts[s, 1], readouts[s, 2], gaps)
    for s in range(readouts.shape[0]):
        if readouts[s, 0] == SPOTS:
            first, begin, count = readouts[s, 1], readouts[s, 2], readouts[s, 3]
            in_range &= read_spots(places, ints, floats, readings[VOLTAGES + gaps :], first, begin, count)
    return in_range


@inlined
def read_gaps(places: IntArray, floats: FloatArray, readings: FloatArray, first: int, begin: int, count: int) -> bool:
    """Do ``linearise_voltages`` for eight POSORs; return whose voltages are all in range."""
    channels, by_readout = table(places, floats, CHANNELS), table(places, floats, BY_READOUT)
    values, variances = line(places, floats, LINES, VALUES), line(places, floats, LINES, VARIANCES)
    order = channels.shape[1] - COLUMNS
    in_range: bool = readings[TIME] == readings[TIME]  # of all, until told otherwise
    for i in range(count):
        c = begin + i
        volt = readings[VOLTAGES + i] + channels[c, order]
        in_range &= (volt >= channels[c, order + LOWEST]) & (volt <= channels[c, order + HIGHEST])
        supply, temperature = readings[SUPPLY], readings[TEMPERATURE]
        write_gap(volt, supply, temperature, channels, c, values, variances, by_readout, first + i)
    return in_range


@inlined
def read_spots(
    places: IntArray, ints: IntArray, floats: FloatArray, currents: FloatArray, first: int, begin: int, count: int
) -> bool:
    """Do ``linearise_spots`` for eight POSORs, no map of CURVES among theirs; return whose currents are all fit."""
    diodes, maps = table(places, floats, DIODES), table(places, ints, MAPS)
    room, basis, by_readout = (
        table(places, floats, SPOT),
        table(places, floats, BASIS),
        table(places, floats, BY_READOUT),
    )
    values, variances = line(places, floats, LINES, VALUES), line(places, floats, LINES, VARIANCES)
    ratios, slope = room[0], room[2:4]
    in_range: bool = currents[0] == currents[0]  # of all whose currents are numbers
    for i in range(count):
        d, row = begin + i, first + 2 * i
        for axis in range(2):
            plus, minus = currents[CONTACTS * i + axis], currents[CONTACTS * i + axis + 2]
            total = plus + minus
            ratio = (plus - minus) / total
            lowest = DOMAIN + 2 * axis
            in_range &= (total >= diodes[d, SUMS]) & (total <= diodes[d, SUMS + 1])
            in_range &= (ratio >= diodes[d, lowest]) & (ratio <= diodes[d, lowest + 1])
            ratios[axis] = ratio
        tensor(
            maps[d, 0],
            maps[d],
            diodes[d, FRAME:MAP],
            diodes[d, MAP:],
            ratios,
            values[row : row + 2],
            slope,
            by_readout[row : row + 2],
            basis,
        )
        write_variances(diodes, d, slope, variances, row)
    return in_range
