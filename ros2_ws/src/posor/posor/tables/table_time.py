# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Times of the rows of a table: numbers with a unit, texts, or a rate; whole nanoseconds since 1970."""

from __future__ import annotations

import datetime as dt
import re
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING, Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from posor.errors import DataFileError
from posor.numerics.stamps import NS
from posor.tables.number_text import with_exponent_e
from posor.tables.raw_table import MISSING

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from posor.numerics.array_types import IntArray
    from posor.tables.table_map import TimeMap

LAST_NS = NS * 2**31  # end of ROS time
MISSING_NS, INVALID_NS = -1, -2  # in place of the time of a row
EXAMPLE = "such as 2026-11-25T10:00:00Z"
_EPOCH = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
_FRACTION = re.compile(r"(?<=:\d\d)[.,](\d{1,9})\d*")
_OFFSET = re.compile(r"[-+]\d\d:\d\d")


def parse_zone(name: str, where: str) -> dt.tzinfo:
    """Return a time zone. Raises DataFileError: the name is unknown."""
    if _OFFSET.fullmatch(name):
        zone = dt.datetime.fromisoformat(f"2000-01-01T00:00:00{name}").tzinfo
        return zone or dt.UTC
    try:
        return dt.UTC if name == "UTC" else ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise DataFileError(
            f"time zone '{name}' is unknown", where=where, expected="UTC, +01:00 or Europe/Berlin"
        ) from None


def parse_moment(text: str, form: str, zone: dt.tzinfo | None) -> int:
    """Return a moment [ns since 1970]; ``form``: ``iso`` or of ``strptime``; ``zone``: of a text without one.

    Raises:
        ValueError: The text has another form; LookupError: it has no time zone, or summer time begins or ends then.

    """
    fraction = _FRACTION.search(text)
    rest = text[: fraction.start()] + text[fraction.end() :] if fraction else text
    if form == "iso":
        moment = dt.datetime.fromisoformat(rest)
    else:
        moment = dt.datetime.strptime(rest, re.sub(r"[.,]%f", "", form))  # noqa: DTZ007  the zone follows
    if moment.tzinfo is None:
        if zone is None:
            raise LookupError
        moment = moment.replace(tzinfo=zone)
        if moment.utcoffset() != moment.replace(fold=1).utcoffset():
            raise LookupError
    whole = (moment - _EPOCH) // dt.timedelta(microseconds=1) * 1000
    return whole + (int(fraction[1].ljust(9, "0")) if fraction else 0)


def start_ns(time: TimeMap, where: str) -> int:
    """Return the start that a map states [ns]; ``where``: of its entry. Raises DataFileError: it is no moment."""
    try:
        zone = parse_zone(time.time_zone, where) if time.time_zone else None
        return parse_moment(str(time.start), "iso", zone)
    except (ValueError, LookupError):
        raise DataFileError(f"start '{time.start}'", where=where, expected=f"a time with its zone, {EXAMPLE}") from None


def times_at_rate(time: TimeMap, positions: IntArray, first_ns: int) -> IntArray:
    """Return the times of rows at a rate (n,), by their positions in the table."""
    assert time.rate is not None  # noqa: S101  validated
    period = NS / Decimal(repr(time.rate.number))
    return np.array([first_ns + round(n * period) for n in positions.tolist()], dtype=np.int64)


def times_of_numbers(values: NDArray[Any], time: TimeMap, first_ns: int, decimal: str) -> IntArray:
    """Return the times of numbers (n,), as decimals of the file; MISSING_NS or INVALID_NS where there is none."""
    assert time.column_unit is not None  # noqa: S101  validated
    factor = time.column_unit.factor * NS
    if values.dtype.kind in "biuf":
        return np.array([_number_ns(repr(each), factor, first_ns, ".") for each in values.tolist()], dtype=np.int64)
    return np.array([_number_ns(str(each), factor, first_ns, decimal) for each in values.tolist()], dtype=np.int64)


def _number_ns(text: str, factor: Decimal, first_ns: int, decimal: str) -> int:
    text = text.strip()
    if text.lower() in MISSING:
        return MISSING_NS
    if "_" in text or (decimal == "," and "." in text):
        return INVALID_NS
    try:
        text = with_exponent_e(text.replace(",", ".") if decimal == "," else text)
        ns = first_ns + round(Decimal(text) * factor)
    except (InvalidOperation, ValueError, OverflowError):
        return INVALID_NS
    return ns if 0 < ns < LAST_NS else INVALID_NS


def times_of_texts(values: NDArray[Any], time: TimeMap, zone: dt.tzinfo | None) -> IntArray:
    """Return the times of texts (n,); MISSING_NS or INVALID_NS where there is none.

    Raises:
        LookupError: A text has no time zone, and the map states none, or one in which summer time begins or ends then;
            its argument is the index of the row.

    """
    form, times = str(time.format), np.empty(len(values), dtype=np.int64)
    for n, text in enumerate(values.tolist()):
        text = str(text).strip()  # noqa: PLW2901
        if text.lower() in MISSING:
            times[n] = MISSING_NS
            continue
        try:
            ns = parse_moment(text, form, zone)
        except ValueError:
            ns = INVALID_NS
        except LookupError:
            raise LookupError(n) from None
        times[n] = ns if 0 < ns < LAST_NS else INVALID_NS
    return times
