# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Joins the transforms of all joints by stamp, block after block, as a chain_node that waits for every joint."""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING

import numpy as np

from posor.chain.time_synchroniser import TimeSynchroniser, synchronise_stamps
from posor.estimation.fault_model import EFFECT
from posor.model.scan import MAX_TERMS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from posor.numerics.array_types import BoolArray

    Rows = NDArray[np.void]
    """Transforms of a joint, shape (n,), dtype ``joint_rows``."""

MOST_OPEN = 65_536  # transforms of a joint that may wait for others; then the oldest are given up, to bound memory


def joint_rows(effects: int) -> np.dtype[np.void]:
    """Return the dtype of a joint's transform as the chain needs it, with a number of fault effects."""
    return np.dtype(
        [
            ("order", "i8"),  # position of the scan among those of all joints that were read together
            ("log_time_ns", "i8"),
            ("stamp_ns", "i8"),
            ("state", "i8"),
            ("theta", "f8"),
            ("pose", "f8", (7,)),
            ("covariance_random", "f8", (6, 6)),
            ("covariance_systematic", "f8", (6, 6)),
            ("shared_effects", "f8", (MAX_TERMS, 6)),
            ("stamp_shift", "f8", (6,)),
            ("fault_effects", "f4", (effects, EFFECT)),
        ]
    )


class BlockSynchroniser:
    """Joins the transforms of one stamp, block after block.

    While the stamps of every joint increase, a stamp is complete when all joints have it. After the stamps of a joint
    have gone back, the synchroniser of chain_node (``TimeSynchroniser``) decides transform by transform.

    Attributes:
        incomplete: Number of stamps that were given up.
        missing: Number of them at which each joint was missing.

    """

    def __init__(self, joints: Sequence[str], effects: int = 0) -> None:
        self._joints, self._rows = tuple(joints), joint_rows(effects)
        self._open = [np.empty(0, dtype=self._rows) for _ in self._joints]
        self._last_complete: list[Rows] = []
        self._closed_until = -1
        self._live: TimeSynchroniser[Rows] | None = None
        self.incomplete = 0
        self.missing = dict.fromkeys(self._joints, 0)

    def join(self, block: Sequence[Rows]) -> list[Rows]:
        """Return the transforms of the complete stamps: of each joint equally many, in the same order.

        ``block``: the next transforms of each joint.
        """
        if self._live is None:
            known = [
                np.concatenate(parts) if len(parts[0]) else parts[1] for parts in zip(self._open, block, strict=True)
            ]
            if all(np.all(np.diff(each["stamp_ns"]) > 0) for each in known) and self._follows_last(block):
                return self._join_increasing(known)
            self._live = self._make_live_joiner()
        return self._join_live(self._live, block)

    def finish(self) -> None:
        """Give up all incomplete stamps at the end."""
        if self._live is not None:
            self._live.close_before(np.inf)
            self._count_given_up(self._live)
        else:
            self._give_up_until(np.iinfo(np.int64).max)

    def _follows_last(self, block: Sequence[Rows]) -> bool:
        """Return whether the stamps of every joint increase from the last complete one."""
        last = [int(each["stamp_ns"][0]) for each in self._last_complete] or [-1] * len(block)
        return all(not len(each) or each["stamp_ns"][0] > stamp for each, stamp in zip(block, last, strict=True))

    def _join_increasing(self, known: list[Rows]) -> list[Rows]:
        if any(len(each) and each["stamp_ns"][0] <= self._closed_until for each in known):
            known = [each[each["stamp_ns"] > self._closed_until] for each in known]
        joined = synchronise_stamps([each["stamp_ns"] for each in known])
        complete = [
            each if len(index) == len(each) else each[index] for each, index in zip(known, joined.index.T, strict=True)
        ]
        # A slice without a copy would keep the memory of the whole block in use.
        self._open = [each[begin:].copy() for each, begin in zip(known, joined.first_open, strict=True)]
        self._count_missing(joined.missing)
        if len(joined.stamps):
            self._last_complete = [each[-1:].copy() for each in complete]
            self._closed_until = int(joined.stamps[-1])
        if max(len(each) for each in self._open) > MOST_OPEN:
            self._give_up_until(max(each["stamp_ns"][-MOST_OPEN - 1] for each in self._open if len(each) > MOST_OPEN))
        return complete

    def _give_up_until(self, last: int) -> None:
        """Give up the open stamps up to one."""
        stamps = [each["stamp_ns"][each["stamp_ns"] <= last] for each in self._open]
        union = reduce(np.union1d, stamps)
        self._count_missing(np.column_stack([~np.isin(union, own, assume_unique=True) for own in stamps]))
        self._open = [each[each["stamp_ns"] > last] for each in self._open]
        self._closed_until = max(self._closed_until, int(last))

    def _count_missing(self, missing: BoolArray) -> None:
        """Count stamps that were given up; ``missing``: by joint, (n, joints)."""
        self.incomplete += len(missing)
        for name, count in zip(self._joints, np.count_nonzero(missing, axis=0).tolist(), strict=True):
            self.missing[name] += count

    def _make_live_joiner(self) -> TimeSynchroniser[Rows]:
        """Return chain_node's synchroniser in its present state: with the last complete stamp, and all open ones."""
        live: TimeSynchroniser[Rows] = TimeSynchroniser(self._joints, MOST_OPEN)
        for former in (self._last_complete, self._open):
            for name, each in zip(self._joints, former, strict=False):
                for n in range(len(each)):
                    live.add(name, int(each["stamp_ns"][n]), each[n : n + 1], 0.0)
        return live

    def _join_live(self, live: TimeSynchroniser[Rows], block: Sequence[Rows]) -> list[Rows]:
        joints = np.repeat(np.arange(len(block)), [len(each) for each in block])
        rows = np.concatenate([np.arange(len(each)) for each in block])
        complete: list[list[Rows]] = []
        for n in np.argsort(np.concatenate([each["order"] for each in block]), kind="stable").tolist():
            each, row = block[joints[n]], int(rows[n])
            item = each[row : row + 1]
            scan = live.add(self._joints[joints[n]], int(item["stamp_ns"][0]), item, 0.0)
            if scan is not None:
                complete.append([scan[name] for name in self._joints])
            self._count_given_up(live)  # now: in the next round the same stamps come again
        if not complete:
            return [each[:0] for each in block]
        return [np.concatenate(of_joint) for of_joint in zip(*complete, strict=True)]

    def _count_given_up(self, live: TimeSynchroniser[Rows]) -> None:
        for missing in live.take_incomplete().values():
            self.incomplete += 1
            for name in missing:
                self.missing[name] += 1
