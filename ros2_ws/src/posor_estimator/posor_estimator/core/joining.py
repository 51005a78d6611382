"""Join what belongs to the same scan instant, and never anything else."""

from __future__ import annotations

from typing import Generic, TypeAlias, TypeVar

Item = TypeVar("Item")
Key: TypeAlias = tuple[int, int]

MOST_OPEN = 64
"""Scans that may be incomplete at the same time unless told otherwise; beyond that the oldest is given up."""


class ScanJoiner(Generic[Item]):
    """Collects one item from each member for each stamp and hands out complete sets.

    A set is handed out when its last member arrives. Older incomplete sets are then given up, since a pose older than
    one already published is of no use to a controller. ``give_up_before`` gives up those that wait too long for a late
    member. ``take_given_up`` names who was missing.

    A member whose stamps go back has started over (a looping replay, a clock set back) and so begins a new round. Items
    of different rounds are never joined. A member that goes on without starting over for MOST_OPEN items after another
    has done so is taken into the new round as it is: then only the other's clock was set back.
    """

    def __init__(self, members: tuple[str, ...], most_open: float = MOST_OPEN) -> None:
        """Join items of these members, with at most so many scans incomplete at the same time."""
        self._members = members
        self._most_open = most_open
        self._round = 0
        self._rounds = dict.fromkeys(members, 0)
        self._behind = dict.fromkeys(members, 0)
        self._last: dict[str, int] = {}
        self._open: dict[Key, dict[str, Item]] = {}
        self._arrived: dict[Key, float] = {}
        self._closed: Key = (0, -1)
        self._given_up: dict[int, tuple[str, ...]] = {}

    def add(self, member: str, stamp: int, item: Item, arrived: float) -> dict[str, Item] | None:
        """Add one item; return the complete set of its stamp, or None while members are missing.

        Items of a set that has been handed out or given up, or that is older, come too late and are dropped.

        Args:
            member: Whose item it is.
            stamp: Of the scan instant.
            item: What to join.
            arrived: Time of a clock that never goes back, for ``give_up_before``.

        """
        key = (self._round_of(member, stamp), stamp)
        if key <= self._closed:
            return None
        scan = self._open.setdefault(key, {})
        scan[member] = item
        self._arrived.setdefault(key, arrived)
        if len(scan) < len(self._members):
            if len(self._open) > self._most_open:
                self._give_up(min(self._open))
            return None
        del self._open[key], self._arrived[key]
        for older in sorted(other for other in self._open if other < key):
            self._give_up(older)
        self._closed = key
        return scan

    def _round_of(self, member: str, stamp: int) -> int:
        """Return the round that an item belongs to."""
        on = stamp - self._last.get(member, stamp - 1)
        self._last[member] = stamp
        if self._rounds[member] == self._round:
            if on < 0:
                self._round += 1
                self._rounds[member] = self._round
        else:
            self._behind[member] += 1
            if on <= 0 or self._behind[member] > MOST_OPEN:
                self._rounds[member] = self._round
                self._behind[member] = 0
        return self._rounds[member]

    def give_up_before(self, arrived: float) -> None:
        """Give up every set whose first item arrived before a time, and the sets older than those."""
        late = [key for key, first in self._arrived.items() if first < arrived]
        if late:
            for key in sorted(key for key in self._open if key <= max(late)):
                self._give_up(key)

    def take_given_up(self) -> dict[int, tuple[str, ...]]:
        """Return stamps given up since the last call, with the members that were missing."""
        given_up, self._given_up = self._given_up, {}
        return given_up

    def _give_up(self, key: Key) -> None:
        present = self._open.pop(key)
        del self._arrived[key]
        self._closed = max(self._closed, key)
        self._given_up[key[1]] = tuple(member for member in self._members if member not in present)
