"""Joins the transforms of all joints by stamp, block after block: what a chain_node that waits for all would join."""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.joining import ScanJoiner, join_all
from posor_estimator.reprocess.transforms import Transforms

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.types import BoolArray

MOST_OPEN = 65_536
"""Transforms of a joint that may wait for the other joints; beyond that the oldest are given up: memory is bounded."""


class BlockJoiner:
    """Joins the transforms of one stamp, block after block.

    As long as the stamps of every joint increase, a stamp is complete where all joints have it. Once a joint's stamps
    go back (``ScanJoiner`` tells what that means) it is the live joiner that decides, transform by transform.

    Attributes:
        incomplete: Stamps that were given up.
        missing: How often each joint was missing from them.

    """

    def __init__(self, names: Sequence[str]) -> None:
        """Join transforms of these joints."""
        self._names = tuple(names)
        self._open: list[Transforms] | None = None
        self._last: list[Transforms] = []
        self._closed = -1
        self._live: ScanJoiner[Transforms] | None = None
        self.incomplete = 0
        self.missing = dict.fromkeys(self._names, 0)

    def join(self, block: Sequence[Transforms]) -> list[Transforms]:
        """Return the complete stamps: of each joint as many transforms, in the same order.

        Args:
            block: What has arrived next, of each joint.

        """
        if self._live is None:
            known = (
                list(block)
                if self._open is None
                else [Transforms.joined(two) for two in zip(self._open, block, strict=True)]
            )
            if all(np.all(each.stamps_ns[1:] > each.stamps_ns[:-1]) for each in known) and self._go_on(block):
                return self._joined(known)
            self._live = self._live_joiner(block)
        return self._joined_live(block)

    def finish(self) -> None:
        """Give up what is still incomplete at the end."""
        if self._live is not None:
            self._live.give_up_before(np.inf)
            self._take_given_up()
        elif self._open is not None:
            self._give_up(np.iinfo(np.int64).max)

    def _go_on(self, block: Sequence[Transforms]) -> bool:
        """Return whether the stamps of every joint go on from the last complete one."""
        last = [int(each.stamps_ns[0]) for each in self._last] or [-1] * len(block)
        return all(not len(each) or each.stamps_ns[0] > stamp for each, stamp in zip(block, last, strict=True))

    def _joined(self, known: list[Transforms]) -> list[Transforms]:
        if self._closed >= 0 and any(len(each) and each.stamps_ns[0] <= self._closed for each in known):
            known = [each.chosen(each.stamps_ns > self._closed) for each in known]
        joined = join_all([each.stamps_ns for each in known])
        complete = [
            each if len(index) == len(each) else each.chosen(index)
            for each, index in zip(known, joined.index.T, strict=True)
        ]
        # By indices, which copies: a slice would keep the whole block from being freed.
        self._open = [
            each.chosen(np.arange(begin, len(each))) for each, begin in zip(known, joined.still_open, strict=True)
        ]
        self._count(joined.missing)
        if len(joined.stamps):
            self._last = [each.chosen(np.array([len(each) - 1])) for each in complete]
            self._closed = int(joined.stamps[-1])
        if max(len(each) for each in self._open) > MOST_OPEN:
            self._give_up(np.sort(np.concatenate([each.stamps_ns[:-MOST_OPEN] for each in self._open]))[-1])
        return complete

    def _give_up(self, last: int) -> None:
        """Give up the open stamps up to one."""
        opened = self._open or []
        stamps = [each.stamps_ns[each.stamps_ns <= last] for each in opened]
        every = reduce(np.union1d, stamps)
        self._count(np.column_stack([~np.isin(every, own, assume_unique=True) for own in stamps]))
        self._open = [each.chosen(each.stamps_ns > last) for each in opened]
        self._closed = max(self._closed, int(last))

    def _count(self, missing: BoolArray) -> None:
        """Count stamps that were given up, by who was missing, (n, joints)."""
        self.incomplete += len(missing)
        for name, count in zip(self._names, np.count_nonzero(missing, axis=0).tolist(), strict=True):
            self.missing[name] += count

    def _live_joiner(self, block: Sequence[Transforms]) -> ScanJoiner[Transforms]:
        """Return the live joiner as it would stand now: with the last complete stamp, and all that is open."""
        live: ScanJoiner[Transforms] = ScanJoiner(self._names, MOST_OPEN)
        for former in (self._last, self._open or [each.chosen(slice(0)) for each in block]):
            for name, each in zip(self._names, former, strict=False):
                for n in range(len(each)):
                    live.add(name, int(each.stamps_ns[n]), each.chosen(slice(n, n + 1)), 0.0)
        return live

    def _joined_live(self, block: Sequence[Transforms]) -> list[Transforms]:
        live = self._live
        if live is None:
            message = "there is no live joiner"
            raise AssertionError(message)
        joints = np.repeat(np.arange(len(block)), [len(each) for each in block])
        within = np.concatenate([np.arange(len(each)) for each in block])
        complete: list[list[Transforms]] = []
        for n in np.argsort(np.concatenate([each.places for each in block]), kind="stable").tolist():
            each, own = block[joints[n]], int(within[n])
            item = each.chosen(slice(own, own + 1))
            scan = live.add(self._names[joints[n]], int(item.stamps_ns[0]), item, 0.0)
            if scan is not None:
                complete.append([scan[name] for name in self._names])
            self._take_given_up()  # at once: in the next round the same stamps come again
        if not complete:
            return [each.chosen(slice(0)) for each in block]
        return [Transforms.joined(of_joint) for of_joint in zip(*complete, strict=True)]

    def _take_given_up(self) -> None:
        if self._live is not None:
            for missing in self._live.take_given_up().values():
                self.incomplete += 1
                for name in missing:
                    self.missing[name] += 1
