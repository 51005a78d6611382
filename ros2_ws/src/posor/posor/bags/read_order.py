# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The order in which every reader of this stack reads a bag.

* Files: by the log time of their first messages, in whatever order ``metadata.yaml`` lists them. Files that overlap in
  log time are merged.
* Messages: by log time; messages of equal log time keep their order in the file.
* Scans of one topic: by scan number. A scan that was logged after its successors, at most ``WINDOW_S`` later, is read
  before them, with the log time of the first of them. It counts as such only if its stamp lies between those of its
  neighbours, too, or after that of the scan before where the clock was set back at the next one.
* Numbers that go back while the stamps go on, or to the beginning of the recording: the recording has started over.
  Both parts are read one after the other.

Otherwise the order is unknown, and the bag is refused with the two files named: a scan was logged later than the
window, the same scan is in two files, or one of several files has no log times.
"""

from __future__ import annotations

from bisect import bisect_left
from contextlib import suppress
from itertools import chain, dropwhile
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.bags.message_block import MessageBlock, TopicReader
from posor.errors import BagError, TopicError
from posor.messages.message_definitions import schema_of_topic
from posor.numerics.stamps import NS
from posor.ros_names import RAW_SCAN

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor.bags.ordered_reader import Messages, OrderedReader
    from posor.numerics.array_types import IntArray

WINDOW_S = 5.0
"""How much later than its successor a scan may be logged [s]."""
WINDOW_BYTES = 64 << 20
"""Limit of the messages that wait for late scans [bytes]; it ends the window early where log times do not increase."""


class _Scan(NamedTuple):
    number: int
    stamp_ns: int


class _TopicScans(NamedTuple):
    """Scans of a topic in a block, shape (n,) each: positions in the block, numbers, stamps and log times."""

    positions: IntArray
    numbers: IntArray
    stamps_ns: IntArray
    times_ns: IntArray

    def scan(self, n: int) -> _Scan:
        return _Scan(int(self.numbers[n]), int(self.stamps_ns[n]))


class _HeldBlock(NamedTuple):
    block: MessageBlock
    scans: list[_TopicScans]  # by topic


class _Part:
    """Scans of a topic from one start of the recording on, those that are held in the order of their numbers."""

    def __init__(self, first: _Scan | None = None, released: _Scan | None = None) -> None:
        self._first, self.released = first, released
        self.scans: list[_Scan] = []
        self.order: list[int] = []  # their positions among all that are held

    def insert(self, place: int, n: int, scan: _Scan) -> None:
        self.scans.insert(place, scan)
        self.order.insert(place, n)

    @property
    def newest(self) -> _Scan | None:
        """The scan with the highest number; None: there is no scan yet."""
        return self.scans[-1] if self.scans else self.released

    @property
    def first(self) -> _Scan:
        return self._first or self.scans[0]

    def is_on_line(self, scan: _Scan, last: _Scan) -> bool:
        """Return whether number and stamp of a scan agree with the clock of the part from its first to a last scan."""
        first = self.first
        if last.number == first.number:
            return self.released is None and len(self.scans) == 1
        period_ns = (last.stamp_ns - first.stamp_ns) / (last.number - first.number)
        expected_ns = first.stamp_ns + period_ns * (scan.number - first.number)
        return 2 * abs(scan.stamp_ns - expected_ns) < last.stamp_ns - expected_ns

    def is_before_clock_step(self, before: _Scan | None, scan: _Scan, successor: _Scan) -> bool:
        """Return whether a scan belongs before another one with which the clock of stamps and log times went back."""
        if before is None or before.number == self.first.number:
            return False
        period_ns = (before.stamp_ns - self.first.stamp_ns) / (before.number - self.first.number)
        follows = 0 < scan.stamp_ns - before.stamp_ns < 2 * (scan.number - before.number) * period_ns
        return follows and 0 < (successor.number - scan.number) * period_ns <= WINDOW_S * NS


def order_scans(
    blocks: Iterator[MessageBlock], reader: OrderedReader, topics: Sequence[str], where: str
) -> Iterator[MessageBlock]:
    """Yield blocks of messages, which come by log time, with the scans of each topic in the order of their numbers.

    ``topics``: topics of the blocks; ``where``: name of the bag in errors. Raises BagError: the order is unknown.
    """
    scan_topics = {connection.topic for connection in reader.connections if connection.msgtype == RAW_SCAN}
    orders = [_TopicOrder(n, topic, reader, where) for n, topic in enumerate(topics) if topic in scan_topics]
    held: list[_HeldBlock] = []
    try:
        for block in blocks:
            following = _HeldBlock(block, [order.scans_of(block) for order in orders])
            follow = [order.follow(scans) for order, scans in zip(orders, following.scans, strict=True)]
            if all(follow):
                held.append(following)
            else:
                held = _in_order([*(each.block for each in held), block], orders)
            while held and (
                held[0].block.times_ns[-1] < held[-1].block.times_ns[-1] - WINDOW_S * NS
                or sum(each.block.nbytes for each in held) > WINDOW_BYTES
            ):
                yield _released(held.pop(0), orders)
    except Exception:
        for each in held:
            yield each.block
        raise
    for each in held:
        yield each.block


def _released(held: _HeldBlock, orders: Sequence[_TopicOrder]) -> MessageBlock:
    for order, scans in zip(orders, held.scans, strict=True):
        order.release(scans)
    return held.block


def _in_order(blocks: Sequence[MessageBlock], orders: Sequence[_TopicOrder]) -> list[_HeldBlock]:
    """Return the messages of all held blocks with the scans in order, cut where the window begins."""
    merged = MessageBlock.merge(blocks)
    which, times_ns = np.arange(len(merged)), merged.times_ns.copy()
    for order in orders:
        scans = order.scans_of(merged)
        positions, found = scans.positions, scans.positions[order.arrange(scans)]
        which[positions] = found
        times_ns[positions] = np.minimum.accumulate(merged.times_ns[found][::-1])[::-1]
    block = merged.select(which)
    block = MessageBlock(block.data, block.topics, times_ns, block.starts, block.lengths)
    block = block.select(np.argsort(times_ns, kind="stable"))
    cut = int(np.searchsorted(block.times_ns, block.times_ns[-1] - WINDOW_S * NS))
    parts = [block.select(part).compact() for part in (slice(cut), slice(cut, None))]
    return [_HeldBlock(part, [order.scans_of(part) for order in orders]) for part in parts if len(part)]


class _TopicOrder:
    """Order of the scans of one topic."""

    def __init__(self, number: int, topic: str, reader: OrderedReader, where: str) -> None:
        self._topic, self._reader, self._where = topic, reader, where
        self._connections = [connection for connection in reader.connections if connection.topic == topic]
        self._schema = schema_of_topic(self._connections, topic, where)
        self._tables = TopicReader(number, topic, self._schema, where)
        self._first: _Scan | None = None  # of the part of the recording that is being released
        self._released: _Scan | None = None  # the last one
        self._newest = -1  # highest number of the present part

    def scans_of(self, block: MessageBlock) -> _TopicScans:
        """Return the scans in a block, up to the first invalid one, which its reader refuses."""
        parts = [_TopicScans(*4 * [np.empty(0, dtype=np.int64)])]
        try:
            for times_ns, positions, table in self._tables.read_tables(block):
                stamps = [table[f"header.stamp.{part}"].astype(np.int64) for part in ("sec", "nanosec")]
                numbers = table["scan"].astype(np.int64)
                parts.append(_TopicScans(positions, numbers, stamps[0] * NS + stamps[1], times_ns))
        except BagError:
            pass
        return _TopicScans(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def follow(self, scans: _TopicScans) -> bool:
        """Return whether the numbers of the next scans increase."""
        numbers = scans.numbers
        if not len(numbers):
            return True
        follow = bool(numbers[0] > self._newest and np.all(numbers[1:] > numbers[:-1]))
        self._newest = int(numbers[-1])
        return follow

    def release(self, scans: _TopicScans) -> None:
        """Keep the first and the last scan of the part of the recording that is being released."""
        if not len(scans.numbers):
            return
        if self._released is not None:
            last = [np.array([each]) for each in (-1, *self._released, -1)]
            scans = _TopicScans(*(np.concatenate(each) for each in zip(last, scans, strict=True)))
        steps = np.diff(scans.numbers)
        starts = np.flatnonzero((steps < 0) | ((steps == 0) & (np.diff(scans.stamps_ns) != 0))) + 1
        if self._first is None or len(starts):
            self._first = scans.scan(starts[-1] if len(starts) else 0)
        self._released = scans.scan(-1)

    def arrange(self, scans: _TopicScans) -> IntArray:
        """Return the order of all held scans."""
        done, part = list[int](), _Part(self._first, self._released)
        for n, pair in enumerate(zip(scans.numbers.tolist(), scans.stamps_ns.tolist(), strict=True)):
            scan, newest = _Scan(*pair), part.newest
            place: int | None = len(part.scans)
            if newest is not None and scan.number <= newest.number:
                place = self._place(scans, n, part, newest)
            if place is None:
                done += part.order
                part, place = _Part(), 0
            part.insert(place, n, scan)
        self._newest = -1 if part.newest is None else part.newest.number
        return np.array(done + part.order, dtype=np.int64)

    def _place(self, scans: _TopicScans, n: int, part: _Part, newest: _Scan) -> int | None:
        """Return the place of scan n, whose number goes back, among those before; None: the recording starts over."""
        scan, times_ns = scans.scan(n), scans.times_ns
        place = bisect_left(part.scans, scan)
        before = part.scans[place - 1] if place else part.released
        successor = part.scans[place] if place < len(part.scans) else None
        fits = (
            successor is not None
            and (part.is_on_line(scan, newest) if before is None else _increase(before, scan))
            and (_increase(scan, successor) or part.is_before_clock_step(before, scan, successor))
        )
        if fits and times_ns[n] - times_ns[part.order[place]] <= WINDOW_S * NS:
            return place
        again = successor == scan
        is_released = not place and part.released is not None and part.is_on_line(scan, part.released)
        displaced = fits or again or is_released
        if not displaced:
            return None
        later = chain(
            (scans.scan(each) for each in range(n + 1, len(scans.numbers))),
            self._scans_after(scans.scan(-1), int(times_ns[-1])),
        )
        if (
            scan.stamp_ns <= part.first.stamp_ns + WINDOW_S * NS
            and (again or scan.number <= part.first.number or self._was_read(scan, int(times_ns[n])))
            and _goes_on(scan, part, newest, later)
        ):
            return None
        if not again:
            files = [self._files_with(each)[0] for each in (scan, newest)]
            raise BagError(
                f"scan {scan.number} of {self._topic} in {files[0]} is logged after scan {newest.number} in {files[1]}",
                where=self._where,
                expected=f"scans in the order of their numbers, logged at most {WINDOW_S:g} s late",
            )
        self._check_one_file(scan, int(times_ns[0]), int(times_ns[-1]))
        return place + 1

    def _check_one_file(self, scan: _Scan, first_ns: int, last_ns: int) -> None:
        files = sorted(set(self._files_with(scan, first_ns, last_ns + 1))) if len(self._reader.files) > 1 else []
        if len(files) > 1:
            raise BagError(
                f"scan {scan.number} of {self._topic} is in {files[0]} and in {files[1]}",
                where=self._where,
                expected="every scan in one file",
            )

    def _was_read(self, scan: _Scan, time_ns: int) -> bool:
        """Return whether a scan that is logged at a time is in the bag before, too."""
        return len(list(self._copies(scan, self._reader.messages(self._connections, stop=time_ns + 1)))) > 1

    def _scans_after(self, scan: _Scan, time_ns: int) -> Iterator[_Scan]:
        """Yield the scans that are read after the last held one, which was logged at a time."""
        later = self._scans(self._reader.messages(self._connections, start=time_ns))
        yield from dropwhile(lambda each: each == scan, dropwhile(lambda each: each != scan, later))

    def _files_with(self, scan: _Scan, start: int | None = None, stop: int | None = None) -> list[str]:
        """Return the name of the file of each message with a scan; ``start``, ``stop``: see ``by_file``."""
        files = self._reader.by_file(self._connections, start, stop)
        return [file.name for file, messages in files for _ in self._copies(scan, messages)]

    def _copies(self, scan: _Scan, messages: Messages) -> Iterator[_Scan]:
        """Yield a scan as often as it is among some messages; only those that hold its number are decoded."""
        numbers = [scan.number.to_bytes(8, order, signed=True) for order in ("little", "big")]
        possible = (each for each in messages if any(number in bytes(each[2]) for number in numbers))
        return (each for each in self._scans(possible) if each == scan)

    def _scans(self, messages: Messages) -> Iterator[_Scan]:
        for _, _, data in messages:
            with suppress(TopicError):
                values = self._schema.values(bytes(data))
                yield _Scan(values["scan"], values["header.stamp.sec"] * NS + values["header.stamp.nanosec"])


def _goes_on(scan: _Scan, part: _Part, newest: _Scan, later: Iterator[_Scan]) -> bool:
    """Return whether the next scans after one are those that the recording had after its first scan."""
    following = (each.number for each in later if each.number >= part.first.number and each != scan)
    return next(following, newest.number + 1) <= newest.number


def _increase(first: _Scan, second: _Scan) -> bool:
    return first.number < second.number and first.stamp_ns < second.stamp_ns
