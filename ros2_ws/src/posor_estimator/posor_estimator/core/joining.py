"""Join what belongs to the same scan instant, and never anything else."""

from __future__ import annotations

from typing import Generic, TypeVar

Item = TypeVar("Item")

MOST_OPEN = 64
"""Scans that may be incomplete at the same time; beyond that the oldest is given up."""


class ScanJoiner(Generic[Item]):
    """Collects one item from each member for each stamp and hands out complete sets.

    A set is handed out when its last member arrives. Older incomplete sets are then given up, since a pose older than
    one already published is of no use to a controller; ``take_given_up`` names who was missing.
    """

    def __init__(self, members: tuple[str, ...]) -> None:
        """Join items of these members."""
        self._members = members
        self._open: dict[int, dict[str, Item]] = {}
        self._done = -1
        self._last: dict[str, int] = {}
        self._given_up: dict[int, tuple[str, ...]] = {}

    def add(self, member: str, stamp: int, item: Item) -> dict[str, Item] | None:
        """Add one item; return the complete set of its stamp, or None while members are missing.

        Items at or before the last stamp handed out come too late and are dropped. A member whose stamps go back has
        started over (a looping replay, a clock set back): everything that is open belongs to the past and is forgotten.
        """
        if stamp < self._last.get(member, stamp):
            self._open.clear()
            self._done = -1
        self._last[member] = stamp
        if stamp <= self._done:
            return None
        scan = self._open.setdefault(stamp, {})
        scan[member] = item
        if len(scan) < len(self._members):
            if len(self._open) > MOST_OPEN:
                self._give_up(min(self._open))
            return None
        del self._open[stamp]
        self._done = stamp
        for older in [other for other in self._open if other < stamp]:
            self._give_up(older)
        return scan

    def take_given_up(self) -> dict[int, tuple[str, ...]]:
        """Return stamps given up since the last call, with the members that were missing."""
        given_up, self._given_up = self._given_up, {}
        return given_up

    def _give_up(self, stamp: int) -> None:
        present = self._open.pop(stamp)
        self._given_up[stamp] = tuple(member for member in self._members if member not in present)
