"""Which consecutive scans become one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from posor_msgs.msg import RawScan

if TYPE_CHECKING:
    from collections.abc import Iterator

MOST_DARK = 100
"""Dark scans in a row that count as neighbours of a lit one; as many end a group, so that it is not held back."""


@dataclass
class Group:
    """Scans (posor_msgs/RawScan) that become one, in the order they were taken."""

    lit: list[Any] = field(default_factory=list)
    """Scans to average. Where dark scans are no background, these are all scans, with light or without."""
    earlier_dark: list[Any] = field(default_factory=list)
    """Dark scans directly before the first lit one that came with the group before."""
    dark: list[Any] = field(default_factory=list)
    """Dark scans before, between and directly after the lit ones."""
    trailing: int = 0
    """How many of the dark scans came after the last lit one."""

    @property
    def status(self) -> int:
        """The flags of all scans; the home mark of a dark scan counts in one group only."""
        status = 0
        for scan in self.lit + self.dark:
            status |= scan.status
        for scan in self.earlier_dark:
            status |= scan.status & ~RawScan.STATUS_HOME_BUMP
        return status

    def next(self) -> Group:
        """Return the group after this one: the dark scans between the two are neighbours of both."""
        return Group(earlier_dark=self.dark[len(self.dark) - self.trailing :])


class ScanGroups:
    """Cuts a stream of scans into groups of ``size`` lit ones."""

    def __init__(self, size: int, *, subtract_dark: bool) -> None:
        """Begin.

        Args:
            size: Scans of a group; fewer if the light source or the readings change, the clock steps back, or the
                stream ends.
            subtract_dark: Whether scans without light are background, which does not count among ``size``.

        """
        self._size = size
        self._subtract_dark = subtract_dark
        self._group = Group()
        self._previous: Any = None

    def take(self, scan: Any) -> Iterator[Group]:
        """Take one more scan and yield the group that is complete now, if any."""
        dark = self._subtract_dark and is_dark(scan)
        group = self._group
        if self._previous is not None and _parted(self._previous, scan):
            yield from self.rest()
            self._group = Group()
        elif group.lit and not dark and (len(group.lit) == self._size or _source(group.lit[-1]) != _source(scan)):
            yield self._close()
        self._previous = scan
        if dark:
            yield from self._take_dark(scan)
        else:
            self._group.lit.append(scan)
            self._group.trailing = 0
            if len(self._group.lit) == self._size and not self._subtract_dark:
                yield self._close()

    def rest(self) -> Iterator[Group]:
        """Yield the group that was begun, if it holds a lit scan."""
        if self._group.lit:
            yield self._close()

    def _take_dark(self, scan: Any) -> Iterator[Group]:
        group = self._group
        group.dark.append(scan)
        group.trailing += 1
        if group.lit and group.trailing == MOST_DARK:
            yield self._close()
        elif not group.lit and len(group.earlier_dark) + len(group.dark) > MOST_DARK:
            (group.earlier_dark or group.dark).pop(0)

    def _close(self) -> Group:
        group, self._group = self._group, self._group.next()
        return group


def is_dark(scan: Any) -> bool:
    """Return whether a scan was taken with no light source lit."""
    return len(scan.lit_sources) > 0 and all(lit == RawScan.NO_SOURCE for lit in scan.lit_sources)


def stamp_of(scan: Any) -> int:
    """Return the middle of the exposure [ns]."""
    stamp = scan.header.stamp
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


def _parted(before: Any, scan: Any) -> bool:
    """Return whether two successive scans have nothing to do with each other."""
    earlier, later = stamp_of(before), stamp_of(scan)
    return later < earlier or (earlier == 0) != (later == 0) or _layout(before) != _layout(scan)


def _layout(scan: Any) -> tuple[object, ...]:
    readings = (scan.gap_voltages, scan.ring_voltages, scan.diode_currents, scan.lit_sources)
    return (scan.header.frame_id, *map(len, readings))


def _source(scan: Any) -> tuple[object, ...]:
    """Return what must be the same in a group: the sources lit, and whether the background is in the currents."""
    return (*scan.lit_sources, scan.status & RawScan.STATUS_DARK_SUBTRACTED)
