# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Collect items with the same stamp from all members: the exact-time policy of ``message_filters``, for scans.

``TimeSynchroniser`` takes item after item, as a node receives them, and follows stamps that go back.
``synchronise_stamps`` gives the same result for whole arrays of increasing stamps.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import reduce
from heapq import heappop, heappush
from math import inf
from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar

import numpy as np

from posor.errors import ChainError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import BoolArray, IntArray

Item = TypeVar("Item")
Key: TypeAlias = tuple[int, int]  # epoch and stamp

MAX_OPEN_SCANS = 64  # default number of scans that may be incomplete at the same time; then the oldest is closed
_FIRST_STAMP, _LAST_STAMP = -(2**63), 2**63 - 1


@dataclass(slots=True)
class _Member:
    """State of one member."""

    epoch: int = 0  # which epoch its items belong to
    items_behind: int = 0  # items since another member began a new epoch
    previous: int = _FIRST_STAMP  # its last stamp but one
    latest: int = _FIRST_STAMP  # its last stamp
    limit: int = _LAST_STAMP  # if it has begun the present epoch: its last stamp of the epoch before

    def restart(self) -> None:
        """Forget all stamps."""
        self.previous = self.latest = _FIRST_STAMP
        self.limit = _LAST_STAMP


@dataclass(slots=True)
class _OpenScan(Generic[Item]):
    """Items of one stamp, and when the first of them arrived."""

    arrived: float
    items: dict[str, Item] = field(default_factory=dict)


class TimeSynchroniser(Generic[Item]):
    """Collects one item from each member for each stamp and returns complete scans.

    A scan is returned when its last item arrives. Older incomplete scans are then closed, because a controller cannot
    use a pose that is older than one already published. ``close_before`` closes scans that wait too long.
    ``take_incomplete`` returns the closed scans with their missing members.

    A member whose stamps go back has restarted (a looping replay, a clock set back) and begins a new epoch. Items of
    different epochs are never combined. If a member continues for MAX_OPEN_SCANS items after another one has restarted,
    only the clock of the other one was set back: the member is then moved to the new epoch.

    A single wrong stamp of a member does not begin an epoch and costs only its own scan: the member's next stamp
    continues the stamps before the wrong one, or lies between the last two.

    Attributes:
        incomplete: Missing members by stamp; see ``take_incomplete``.

    """

    def __init__(self, members: tuple[str, ...], max_open: float = MAX_OPEN_SCANS, max_wait: float = inf) -> None:
        """Synchronise items of these members.

        ``max_open``: number of scans that may be incomplete at the same time; ``max_wait``: longest time from the first
        item of a scan to the last.
        """
        self._members = {member: _Member() for member in members}
        self._max_open = max_open
        self._max_wait = max_wait
        self._epoch = 0
        self._open: dict[Key, _OpenScan[Item]] = {}
        self._keys: list[Key] = []
        self._closed: Key = (0, -1)
        self.incomplete: dict[int, tuple[str, ...]] = {}

    def add(self, member: str, stamp: int, item: Item, arrived: float) -> dict[str, Item] | None:
        """Add one item; return the complete scan of its stamp, or None while members are missing.

        Items of a scan that is complete or closed, or older, are dropped. So is a second item of a member for the same
        stamp: the second transform of a repeated scan is LOST. ``member``: name of the sender; ``stamp``: of
        the scan; ``item``: to be returned with the scan; ``arrived``: monotonic time of arrival, for ``max_wait`` and
        ``close_before``.
        """
        own = self._members[member]
        if own.epoch != self._epoch or not own.latest <= stamp <= own.limit:
            self._change_epoch(member, own, stamp)
        own.previous, own.latest = own.latest, stamp
        key = (own.epoch, stamp)
        if key <= self._closed:
            return None
        scan = self._open.get(key)
        if scan is None:
            scan = self._open[key] = _OpenScan(arrived)
            heappush(self._keys, key)
        elif arrived - scan.arrived > self._max_wait:
            self._close_up_to(key)
            return None
        items = scan.items
        items.setdefault(member, item)
        if len(items) == len(self._members):
            del self._open[key]
            self._close_up_to(key)
            return items
        if len(self._open) > self._max_open:
            self._close_up_to(self._keys[0])
        return None

    def add_together(self, stamp: int, items: dict[str, Item], arrived: float) -> dict[str, Item] | None:
        """Add items of one stamp, as one ``add`` after the other would; return the complete scan or None."""
        if len(items) == len(self._members) and self.is_complete_at_once(stamp):
            self.close_complete(stamp)
            return items
        scan = None
        for member, item in items.items():
            scan = self.add(member, stamp, item, arrived) or scan
        return scan

    def is_complete_at_once(self, stamp: int) -> bool:
        """Return whether items of all members with this stamp would make a scan and close no other."""
        epoch = self._epoch
        if self._open or (epoch, stamp) <= self._closed:
            return False
        for own in self._members.values():  # noqa: SIM110  a generator takes twice as long
            if own.epoch != epoch or not own.latest <= stamp <= own.limit:
                return False
        return True

    def close_complete(self, stamp: int) -> None:
        """Close the scan of ``is_complete_at_once``, of which all members have sent their items."""
        for own in self._members.values():
            own.previous, own.latest = own.latest, stamp
        self._closed = self._epoch, stamp

    def _change_epoch(self, member: str, own: _Member, stamp: int) -> None:
        """Begin a new epoch, follow the others into theirs, or forget a wrong stamp, as this stamp requires."""
        if own.epoch != self._epoch:
            own.items_behind += 1
            if stamp <= own.latest or own.items_behind > MAX_OPEN_SCANS:
                own.restart()
                own.epoch, own.items_behind = self._epoch, 0
        elif stamp > own.limit:
            self._revert_epoch(member, own)
        elif _FIRST_STAMP < own.previous < stamp and self._forget(member, (own.epoch, own.latest)):
            own.latest = own.previous
        else:
            self._epoch += 1
            former = own.latest
            own.restart()
            own.epoch, own.limit = self._epoch, former

    def _revert_epoch(self, member: str, own: _Member) -> None:
        """Undo the epoch that a member has begun if it holds only the member's first stamp; else let it continue."""
        limit, own.limit = own.limit, _LAST_STAMP
        if own.previous == _FIRST_STAMP and self._forget(member, (own.epoch, own.latest)):
            self._epoch -= 1
            own.epoch, own.latest = self._epoch, limit
            for other in self._members.values():
                other.items_behind = 0

    def _forget(self, member: str, key: Key) -> bool:
        """Close an open scan if it holds only the item of one member; return whether it did."""
        scan = self._open.get(key)
        if scan is None or list(scan.items) != [member]:
            return False
        del self._open[key]
        self._keys = sorted(self._open)
        self.incomplete[key[1]] = tuple(other for other in self._members if other != member)
        return True

    def close_before(self, arrived: float) -> None:
        """Close every scan whose first item arrived before a time, and all older scans."""
        late = [key for key, scan in self._open.items() if scan.arrived < arrived]
        if late:
            self._close_up_to(max(late))

    def take_incomplete(self) -> dict[int, tuple[str, ...]]:
        """Return the missing members of the scans closed since the last call, by stamp."""
        incomplete, self.incomplete = self.incomplete, {}
        return incomplete

    def _close_up_to(self, key: Key) -> None:
        """Close all scans up to one; scans that are still open are incomplete."""
        keys = self._keys
        while keys and keys[0] <= key:
            scan = self._open.pop(older := heappop(keys), None)
            if scan is not None:
                self.incomplete[older[1]] = tuple(member for member in self._members if member not in scan.items)
        self._closed = key


@dataclass(frozen=True)
class SynchronisedStamps:
    """Result of ``synchronise_stamps`` for j members."""

    stamps: IntArray  # stamps of the complete scans, (n,)
    index: IntArray  # index of each of them in the stamps of each member, (n, j)
    incomplete: IntArray  # stamps before the last complete one that a member lacks, (m,)
    missing: BoolArray  # which members lack them, (m, j)
    first_open: IntArray  # index of the first stamp after the last complete one, for each member, (j,)


def synchronise_stamps(stamps: Sequence[IntArray]) -> SynchronisedStamps:
    """Synchronise whole arrays, with the result of a ``TimeSynchroniser`` without a bound on open scans.

    ``stamps``: of each member, (k,), increasing. If stamps go back, the result depends on the order of arrival: use a
    ``TimeSynchroniser``. Raises ChainError: stamps do not increase.
    """
    for member, own in enumerate(stamps):
        backward = np.flatnonzero(own[1:] <= own[:-1])
        if backward.size:
            n = int(backward[0])
            raise ChainError(
                f"stamp {own[n + 1]} after {own[n]}", where=f"member {member}", expected="stamps that increase"
            )
    if all(np.array_equal(stamps[0], own) for own in stamps[1:]):
        count, members = len(stamps[0]), len(stamps)
        return SynchronisedStamps(
            stamps[0],
            np.broadcast_to(np.arange(count)[:, None], (count, members)),
            np.empty(0, dtype=np.int64),
            np.empty((0, members), dtype=np.bool_),
            np.full(members, count),
        )
    complete = reduce(lambda one, other: np.intersect1d(one, other, assume_unique=True), stamps)
    union = reduce(np.union1d, stamps)
    last = complete[-1] if complete.size else np.iinfo(np.int64).min
    closed = union[union < last]
    missing = np.column_stack([~np.isin(closed, own, assume_unique=True) for own in stamps])
    incomplete = missing.any(axis=1)
    return SynchronisedStamps(
        complete,
        np.column_stack([np.searchsorted(own, complete) for own in stamps]),
        closed[incomplete],
        missing[incomplete],
        np.array([np.searchsorted(own, last, side="right") for own in stamps]),
    )
