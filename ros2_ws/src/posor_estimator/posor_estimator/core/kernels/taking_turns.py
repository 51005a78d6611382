"""Rows of readings of one POSOR into an array in which eight POSORs take turns, and rows of poses out of one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import EIGHT, in_place, inlined
from posor_estimator.core.kernels.abreast import (
    FOUND,
    FOUND_COVARIANCE,
    FOUND_RESIDUAL,
    FOUND_ROTATION,
    FOUND_THETA,
    FOUND_TRANSLATION,
)
from posor_estimator.core.kernels.abreast_read import SUPPLY, TEMPERATURE, TIME, VOLTAGES
from posor_estimator.core.kernels.chain_pose import write_pose
from posor_estimator.core.kernels.locate import NATIVE, OK, RESIDUAL, write_native
from posor_estimator.core.kernels.matrix import matrix
from posor_estimator.core.kernels.readout import FAULTS, STATE, choose_rows
from posor_estimator.core.kernels.records import (
    CURRENTS,
    FIT,
    GAPS,
    RECORD,
    STAMP_NS,
    TO_COVARIANCE,
    is_at_home,
    read_lit,
    stamp_of,
    write_all_but_covariance,
)
from posor_estimator.core.kernels.records import SUPPLY as SUPPLY_COLUMN
from posor_estimator.core.kernels.records import TEMPERATURE as TEMPERATURE_COLUMN
from posor_estimator.core.kernels.rows import are_here
from posor_estimator.core.kernels.scan import take_up
from posor_estimator.core.kernels.tables import (
    CHOSEN,
    EPOCH,
    FIGURES,
    HERE,
    OUTCOME,
    READOUTS,
    ROTATION,
    TRANSLATION,
    line,
    table,
)
from posor_estimator.core.kernels.vector import at

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray, WordArray


@inlined
def reads_on(places: IntArray, ints: IntArray, record: IntArray, words: WordArray, currents: FloatArray) -> bool:
    """Choose the rows that a scan reads, as ``read_out`` does; return whether its sources are known."""
    readouts, chosen, lit = table(places, ints, READOUTS), line(places, ints, CHOSEN, 0), record[RECORD:]
    read_lit(record, words, lit)
    known = True
    for s in range(readouts.shape[0]):
        known &= choose_rows(readouts, s, currents, lit, chosen) == 0
    return known


@in_place
def take_in(
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    record: IntArray,
    raw: FloatArray,
    words: WordArray,
    readings: FloatArray,
    lane: int,
    spare: int,
    begin: int,
    end: int,
) -> int:
    """Write scans of one POSOR where they are read from, as far as they are ordinary and read as the first one does.

    Ordinary as far as can be told by now: with a time, to be used, not at home. Where the first one reads other rows
    than the one before, these are taken up, and what is ``COMMON`` has to be copied.

    Args:
        places: See ``kernels.tables``, as ``ints`` and ``floats``.
        ints: The POSOR's whole numbers.
        floats: The POSOR's numbers.
        record: See ``kernels.records``, as ``raw`` and ``words``.
        raw: Rows of readings, shape (n, k).
        words: The same, as whole numbers, shape (n, 2 k).
        readings: To write, see ``kernels.abreast``; the first scan comes first.
        lane: Whose turn of the eight is the POSOR's.
        spare: From whose turn on nobody has one; the POSOR is to stand in. Eight where another one does.
        begin: First row.
        end: The row after the last.

    Returns:
        The row after the last that was taken in.

    """
    epoch, here, chosen = line(places, ints, EPOCH, 0), line(places, ints, HERE, 0), table(places, ints, CHOSEN)
    gaps, gap_count, currents, count = record[GAPS], record[GAPS + 1], record[CURRENTS], record[CURRENTS + 1]
    width = VOLTAGES + gap_count + count
    for n in range(begin, end):
        row, whole = raw[n], words[n]
        stamp_ns = stamp_of(record, whole)
        if epoch[0] == 0 or stamp_ns == 0 or record[FIT] == 0 or is_at_home(record, whole):
            return n
        if not reads_on(places, ints, record, whole, row[currents : currents + count]):
            return n
        if not are_here(chosen, 0, here):
            if n > begin:
                return n
            take_up(places, ints, floats)
        out = readings[(n - begin) * width * EIGHT : (n - begin + 1) * width * EIGHT]
        out[TIME * EIGHT + lane] = (stamp_ns - epoch[1]) * 1e-9
        out[SUPPLY * EIGHT + lane] = row[record[SUPPLY_COLUMN]]
        out[TEMPERATURE * EIGHT + lane] = row[record[TEMPERATURE_COLUMN]]
        for k in range(gap_count):
            out[(VOLTAGES + k) * EIGHT + lane] = row[gaps + k]
        for k in range(count):
            out[(VOLTAGES + gap_count + k) * EIGHT + lane] = row[currents + k]
        for other in range(spare, EIGHT):
            for k in range(width):
                out[k * EIGHT + other] = out[k * EIGHT + lane]
    return end


@in_place
def give_out(
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    record: IntArray,
    words: WordArray,
    template: FloatArray,
    out: FloatArray,
    out_words: WordArray,
    found: FloatArray,
    lane: int,
    begin: int,
    end: int,
) -> None:
    """Write the rows of poses of one POSOR from what was found of eight; see ``take_in`` and ``write_record``."""
    outcome, figures = line(places, ints, OUTCOME, 0), line(places, floats, FIGURES, 0)
    rotation, translation = table(places, floats, ROTATION), line(places, floats, TRANSLATION, 0)
    covariance = record[TO_COVARIANCE]
    for k in range(outcome.shape[0]):
        outcome[k] = 0
    outcome[STATE], outcome[FAULTS] = OK, 0
    for n in range(begin, end):
        scan = found[(n - begin) * FOUND * EIGHT : (n - begin + 1) * FOUND * EIGHT]
        for i in range(3):
            translation[i] = scan[(FOUND_TRANSLATION + i) * EIGHT + lane]
            for j in range(3):
                rotation[i, j] = scan[(FOUND_ROTATION + 3 * i + j) * EIGHT + lane]
        figures[RESIDUAL] = scan[FOUND_RESIDUAL * EIGHT + lane]
        write_pose(matrix(rotation, 0), at(translation, 0), figures)
        write_native(rotation, translation, scan[FOUND_THETA * EIGHT + lane], figures, NATIVE)
        record[STAMP_NS] = stamp_of(record, words[n])
        write_all_but_covariance(places, ints, floats, record, words[n], template, out[n], out_words[n])
        for k in range(36):
            out[n, covariance + k] = scan[(FOUND_COVARIANCE + k) * EIGHT + lane]
