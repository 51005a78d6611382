"""Join what belongs to the same scan instant, and never anything else."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from heapq import heappop, heappush
from math import inf
from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar

import numpy as np

from posor_estimator.errors import ChainError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.types import BoolArray, IntArray

Item = TypeVar("Item")
Key: TypeAlias = tuple[int, int]

MOST_OPEN = 64
"""Scans that may be incomplete at the same time unless told otherwise; beyond that the oldest is given up."""


_BEFORE_ALL, _AFTER_ALL = -(2**63), 2**63 - 1


class _Member:
    """The round that a member is in, its last two stamps, and how many items it has sent since it fell a round behind.

    Who has begun a round has a limit: its last stamp of the round before.
    """

    __slots__ = ("before", "behind", "last", "limit", "round")

    def __init__(self) -> None:
        self.round = self.behind = 0
        self.begin()

    def begin(self) -> None:
        self.before = self.last = _BEFORE_ALL
        self.limit = _AFTER_ALL


class _Scan(Generic[Item]):
    """The items of a set, and when the first of them arrived."""

    __slots__ = ("arrived", "items")

    def __init__(self, arrived: float) -> None:
        self.arrived = arrived
        self.items: dict[str, Item] = {}


class ScanJoiner(Generic[Item]):
    """Collects one item from each member for each stamp and hands out complete sets.

    A set is handed out when its last member arrives. Older incomplete sets are then given up, since a pose older than
    one already published is of no use to a controller. ``give_up_before`` gives up those that wait too long for a late
    member. ``take_given_up`` names who was missing.

    A member whose stamps go back has started over (a looping replay, a clock set back) and so begins a new round. Items
    of different rounds are never joined. A member that goes on without starting over for MOST_OPEN items after another
    has done so is taken into the new round as it is: then only the other's clock was set back.

    One wrong stamp of a member is not taken for that, and costs no more than its own scan. It has come too early where
    the member's next one goes on from those before, and too late where that lies between the former two.

    Attributes:
        given_up: What ``take_given_up`` has to tell.

    """

    def __init__(self, members: tuple[str, ...], most_open: float = MOST_OPEN, max_wait: float = inf) -> None:
        """Join items of these members.

        Args:
            members: Their names.
            most_open: Scans that may be incomplete at the same time.
            max_wait: How much later than the first item of a scan the others may arrive.

        """
        self._members = {member: _Member() for member in members}
        self._most_open = most_open
        self._max_wait = max_wait
        self._round = 0
        self._open: dict[Key, _Scan[Item]] = {}
        self._keys: list[Key] = []
        self._closed: Key = (0, -1)
        self.given_up: dict[int, tuple[str, ...]] = {}

    def add(self, member: str, stamp: int, item: Item, arrived: float) -> dict[str, Item] | None:
        """Add one item; return the complete set of its stamp, or None while members are missing.

        Items of a set that has been handed out or given up, or that is older, come too late and are dropped.

        Args:
            member: Whose item it is.
            stamp: Of the scan instant.
            item: What to join.
            arrived: Time of a clock that never goes back, for ``give_up_before``.

        """
        own = self._members[member]
        if own.round != self._round or not own.last <= stamp <= own.limit:
            self._change_round(member, own, stamp)
        own.before, own.last = own.last, stamp
        key = (own.round, stamp)
        if key <= self._closed:
            return None
        scan = self._open.get(key)
        if scan is None:
            scan = self._open[key] = _Scan(arrived)
            heappush(self._keys, key)
        elif arrived - scan.arrived > self._max_wait:
            self._give_up_to(key)
            return None
        items = scan.items
        items[member] = item
        if len(items) == len(self._members):
            del self._open[key]
            self._give_up_to(key)
            return items
        if len(self._open) > self._most_open:
            self._give_up_to(self._keys[0])
        return None

    def _change_round(self, member: str, own: _Member, stamp: int) -> None:
        """Begin a new round, or follow the others into theirs, if a member's stamp says so; or forget a wrong one."""
        if own.round != self._round:
            own.behind += 1
            if stamp <= own.last or own.behind > MOST_OPEN:
                own.begin()
                own.round, own.behind = self._round, 0
        elif stamp > own.limit:
            self._return_from_round(member, own)
        elif _BEFORE_ALL < own.before < stamp and self._forget(member, (own.round, own.last)):
            own.last = own.before
        else:
            self._round += 1
            former = own.last
            own.begin()
            own.round, own.limit = self._round, former

    def _return_from_round(self, member: str, own: _Member) -> None:
        """Undo the round that a member has begun if its first stamp there was the only one; else let it go on."""
        limit, own.limit = own.limit, _AFTER_ALL
        if own.before == _BEFORE_ALL and self._forget(member, (own.round, own.last)):
            self._round -= 1
            own.round, own.last = self._round, limit
            for other in self._members.values():
                other.behind = 0

    def _forget(self, member: str, key: Key) -> bool:
        """Give up an open scan if it has nothing but a member's item; return whether it had."""
        scan = self._open.get(key)
        if scan is None or list(scan.items) != [member]:
            return False
        del self._open[key]
        self._keys = sorted(self._open)
        self.given_up[key[1]] = tuple(other for other in self._members if other != member)
        return True

    def give_up_before(self, arrived: float) -> None:
        """Give up every set whose first item arrived before a time, and the sets older than those."""
        late = [key for key, scan in self._open.items() if scan.arrived < arrived]
        if late:
            self._give_up_to(max(late))

    def take_given_up(self) -> dict[int, tuple[str, ...]]:
        """Return stamps given up since the last call, with the members that were missing."""
        given_up, self.given_up = self.given_up, {}
        return given_up

    def _give_up_to(self, key: Key) -> None:
        """Close all sets up to one; those that are still open are given up."""
        keys = self._keys
        while keys and keys[0] <= key:
            scan = self._open.pop(older := heappop(keys), None)
            if scan is not None:
                self.given_up[older[1]] = tuple(member for member in self._members if member not in scan.items)
        self._closed = key


@dataclass(frozen=True)
class Joined:
    """What belongs together of the stamps of j members, see ``join_all``.

    Attributes:
        stamps: Those that all members have, (n,).
        index: Where each member has them, (n, j).
        given_up: Stamps before the last of these that some member has not, (m,).
        missing: Who has them not, (m, j).
        still_open: Where in each member's stamps those after the last complete one begin, (j,).

    """

    stamps: IntArray
    index: IntArray
    given_up: IntArray
    missing: BoolArray
    still_open: IntArray


def join_all(stamps: Sequence[IntArray]) -> Joined:
    """Join the stamps of all members at once, as a ``ScanJoiner`` with no bound on open sets would one after the other.

    Args:
        stamps: Of each member, (k,), increasing. Where they go back it depends on the order in which items of all
            members arrive what belongs together: that is for a ``ScanJoiner``.

    Raises:
        ChainError: Stamps do not increase.

    """
    for member, own in enumerate(stamps):
        stuck = np.flatnonzero(own[1:] <= own[:-1])
        if stuck.size:
            n = int(stuck[0])
            raise ChainError(
                f"stamp {own[n + 1]} after {own[n]}", where=f"member {member}", expected="stamps that increase"
            )
    if all(np.array_equal(stamps[0], own) for own in stamps[1:]):
        count, members = len(stamps[0]), len(stamps)
        return Joined(
            stamps[0],
            np.broadcast_to(np.arange(count)[:, None], (count, members)),
            np.empty(0, dtype=np.int64),
            np.empty((0, members), dtype=np.bool_),
            np.full(members, count),
        )
    complete = reduce(lambda one, other: np.intersect1d(one, other, assume_unique=True), stamps)
    every = reduce(np.union1d, stamps)
    last = complete[-1] if complete.size else np.iinfo(np.int64).min
    before = every[every < last]
    lacking = np.column_stack([~np.isin(before, own, assume_unique=True) for own in stamps])
    some = lacking.any(axis=1)
    return Joined(
        complete,
        np.column_stack([np.searchsorted(own, complete) for own in stamps]),
        before[some],
        lacking[some],
        np.array([np.searchsorted(own, last, side="right") for own in stamps]),
    )
