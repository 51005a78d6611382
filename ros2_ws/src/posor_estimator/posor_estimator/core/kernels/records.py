"""Scan after scan, from messages with raw readings to messages with poses, neither of them taken apart.

A message is a row of numbers: whole ones of four bytes and floats of eight bytes in the same memory. Where a row has
what, and what is the same for all rows, stands in a ``record``, whose entries follow. ``core.records`` makes it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor_estimator.core.compiled import in_place, inlined, without_lock
from posor_estimator.core.fault import Fault
from posor_estimator.core.kernels.locate import LOST, NATIVE, POSE, RESIDUAL
from posor_estimator.core.kernels.readout import FAULTS, STATE
from posor_estimator.core.kernels.reshaped import part
from posor_estimator.core.kernels.scan import DONE, locate_one, write_lost
from posor_estimator.core.kernels.stamps import time_in_kernel
from posor_estimator.core.kernels.tables import (
    FIGURES,
    OUTCOME,
    RANDOM,
    ROTATION,
    SYSTEMATIC,
    TAKEN,
    TRANSLATION,
    line,
    table,
)

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray, WordArray

# Of the readings, columns of whole numbers; a scan number takes two.
SECONDS, NANOSECONDS, NUMBER, STATUS = 0, 1, 2, 3
# Columns of floats, each with how many there are.
GAPS, RINGS, CURRENTS = 4, 6, 8
SUPPLY, TEMPERATURE = 10, 11
# First byte, and how many.
LIT = 12
HOME = 14  # which bits of the status say that the home mark was seen
# Of the poses, columns of whole numbers.
TO_STAMP, TO_NUMBER, TO_VERDICT, TO_FAULTS, TO_STATUS = 15, 16, 17, 18, 19
# Columns of floats.
TO_POSE, TO_NATIVE, TO_RESIDUAL, TO_COVARIANCE = 20, 21, 22, 23
KIND = 24  # which covariance is wanted
REDUNDANCY = 25  # of every scan that is not LOST
FIT = 26  # 0: the readings are not to be used, every scan is LOST
# Of the scan at hand.
AT_HOME = 27  # 1: it counts as having seen the home mark, whatever its status says
STAMP_NS = 28  # its stamp
SAID_STATE, SAID_FAULTS = 29, 30  # what was written of it
SAID_TAKEN = 31  # how often, up to it, other rows of the pool have been taken than for the scan before
SAID_NEWS = 32  # 1: state, faults or that number are other than what was written of the scan before
LEFT = 33  # what is left to do for it
RECORD = 34  # and after it room for the sources lit

KIND_SYSTEMATIC, KIND_TOTAL = 1, 2
"""The third, zero, is the random one."""
OTHER = 4
"""Left to do, beside those of ``kernels.scan``: all, since the row is not one of readings of this kind."""
BAD_READING = int(Fault.BAD_READING)


@inlined
def is_like(words: WordArray, like: WordArray) -> bool:
    """Return whether a row (w,) is as ``like`` (2, w) says: equal to its first row in the bits of its second."""
    differs = 0
    for k in range(like.shape[1]):
        differs |= (words[k] ^ like[0, k]) & like[1, k]
    return differs == 0


@inlined
def stamp_of(record: IntArray, words: WordArray) -> int:
    """Return the stamp of a row of readings [ns]; 0 where it is no time."""
    return time_in_kernel(int(words[record[SECONDS]]), int(words[record[NANOSECONDS]]) & 0xFFFFFFFF)


@inlined
def is_at_home(record: IntArray, words: WordArray) -> bool:
    """Return whether a row of readings has seen the home mark, or counts as having seen it."""
    return bool(record[AT_HOME] != 0 or int(words[record[STATUS]]) & record[HOME] != 0)


@inlined
def read_lit(record: IntArray, words: WordArray, lit: IntArray) -> None:
    """Write which sources were lit."""
    for i in range(record[LIT + 1]):
        byte = record[LIT] + i
        lit[i] = int(words[byte // 4]) >> (8 * (byte % 4)) & 0xFF


@inlined
def write_record(
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    record: IntArray,
    words: WordArray,
    template: FloatArray,
    out: FloatArray,
    out_words: WordArray,
) -> None:
    """Write the estimate that stands in the room for one into a row.

    Args:
        places: See ``kernels.tables``, as ``ints`` and ``floats``.
        ints: OUTCOME is read.
        floats: FIGURES and the covariances are read.
        record: See the module; what is said of the scan is written.
        words: The row of readings, shape (w,): stamp, number and status are copied.
        template: A row of an estimate, for what is the same in all, shape (k,).
        out: Row to write, shape (k,).
        out_words: The same, as whole numbers, shape (2 k,).

    """
    write_all_but_covariance(places, ints, floats, record, words, template, out, out_words)
    random, systematic = table(places, floats, RANDOM), table(places, floats, SYSTEMATIC)
    write_covariance(record[KIND], random, systematic, part(out, record[TO_COVARIANCE], 6, 6))


@inlined
def write_covariance(kind: int, random: FloatArray, systematic: FloatArray, covariance: FloatArray) -> None:
    """Write the covariance that is wanted, of two others (6, 6)."""
    for i in range(6):
        for j in range(6):
            covariance[i, j] = systematic[i, j] if kind == KIND_SYSTEMATIC else random[i, j]
    if kind == KIND_TOTAL:
        for i in range(6):
            for j in range(6):
                covariance[i, j] += systematic[i, j]


@inlined
def write_all_but_covariance(
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    record: IntArray,
    words: WordArray,
    template: FloatArray,
    out: FloatArray,
    out_words: WordArray,
) -> None:
    """Do ``write_record`` but for the covariance."""
    outcome, figures = line(places, ints, OUTCOME, 0), line(places, floats, FIGURES, 0)
    taken = line(places, ints, TAKEN, 0)
    differs = (record[SAID_STATE] ^ outcome[STATE]) | (record[SAID_FAULTS] ^ outcome[FAULTS])
    record[SAID_NEWS] = 1 if differs | (record[SAID_TAKEN] ^ taken[0]) else 0
    record[SAID_STATE], record[SAID_FAULTS], record[SAID_TAKEN] = outcome[STATE], outcome[FAULTS], taken[0]
    lost = outcome[STATE] == LOST
    for k in range(template.shape[0]):
        out[k] = template[k]
    out_words[record[TO_STAMP]] = words[record[SECONDS]]
    out_words[record[TO_STAMP] + 1] = words[record[NANOSECONDS]]
    out_words[record[TO_NUMBER]] = words[record[NUMBER]]
    out_words[record[TO_NUMBER] + 1] = words[record[NUMBER] + 1]
    out_words[record[TO_STATUS]] = words[record[STATUS]]
    out_words[record[TO_VERDICT]] = (0 if lost else record[REDUNDANCY]) | outcome[STATE] << 8
    out_words[record[TO_FAULTS]] = outcome[FAULTS]
    pose, native = record[TO_POSE], record[TO_NATIVE]
    for k in range(NATIVE - POSE):
        out[pose + k] = figures[POSE + k]
    for k in range(RESIDUAL - NATIVE):
        out[native + k] = figures[NATIVE + k]
    out[record[TO_RESIDUAL]] = math.nan if lost else figures[RESIDUAL]


@inlined
def lose_record(places: IntArray, ints: IntArray, floats: FloatArray) -> None:
    """Put into the room for one estimate that its readings cannot be any."""
    outcome = line(places, ints, OUTCOME, 0)
    for k in range(outcome.shape[0]):
        outcome[k] = 0
    outcome[STATE], outcome[FAULTS] = LOST, BAD_READING
    write_lost(
        table(places, floats, ROTATION),
        line(places, floats, TRANSLATION, 0),
        table(places, floats, RANDOM),
        table(places, floats, SYSTEMATIC),
        line(places, floats, FIGURES, 0),
    )


@in_place
def locate_records(
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    record: IntArray,
    like: WordArray,
    raw: FloatArray,
    words: WordArray,
    template: FloatArray,
    out: FloatArray,
    out_words: WordArray,
    begin: int,
    end: int,
) -> int:
    """Locate the scans in rows ``begin`` to ``end``, as far as nothing else is left to do for one.

    A scan without a time, or that is not to be used, is LOST, its readings bad; AT_HOME waits for one that is.

    Args:
        places: See ``kernels.tables``, as ``ints`` and ``floats``.
        ints: The POSOR's whole numbers.
        floats: The POSOR's numbers, its memory among them.
        record: See the module.
        like: What the rows of readings must be like, see ``is_like``, shape (2, w), or (2, 0): they are.
        raw: Rows of readings, shape (n, k).
        words: The same, as whole numbers, shape (n, 2 k).
        template: See ``write_record``.
        out: Rows to write, shape (n, k).
        out_words: The same, as whole numbers, shape (n, 2 k).
        begin: First row.
        end: The row after the last.

    Returns:
        ``end`` when done; n where something is left to do for the scan in row n, LEFT says what.

    """
    lit = record[RECORD:]
    for n in range(begin, end):
        row, whole = raw[n], words[n]
        if not is_like(whole, like):
            record[LEFT] = OTHER
            return n
        stamp_ns = stamp_of(record, whole)
        record[STAMP_NS] = stamp_ns
        if stamp_ns == 0 or record[FIT] == 0:
            lose_record(places, ints, floats)
            write_record(places, ints, floats, record, whole, template, out[n], out_words[n])
            continue
        read_lit(record, whole, lit)
        left = locate_one(
            places,
            ints,
            floats,
            stamp_ns,
            row[record[GAPS] : record[GAPS] + record[GAPS + 1]],
            row[record[RINGS] : record[RINGS] + record[RINGS + 1]],
            row[record[CURRENTS] : record[CURRENTS] + record[CURRENTS + 1]],
            lit,
            row[record[SUPPLY]],
            row[record[TEMPERATURE]],
            is_at_home(record, whole),
            line(places, ints, OUTCOME, 0),
            table(places, floats, ROTATION),
            line(places, floats, TRANSLATION, 0),
            table(places, floats, RANDOM),
            table(places, floats, SYSTEMATIC),
            line(places, floats, FIGURES, 0),
        )
        if left != DONE:
            record[LEFT] = left
            return n
        record[AT_HOME] = 0
        write_record(places, ints, floats, record, whole, template, out[n], out_words[n])
    return end


@without_lock
def locate_many_records(*arguments: Any) -> int:
    """Do ``locate_records`` while other threads run: for many scans. For one, taking the lock back costs more."""
    return locate_records(*arguments)
