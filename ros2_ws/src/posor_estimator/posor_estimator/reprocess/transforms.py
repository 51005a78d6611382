"""Transforms of one joint as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.bulk.layout import Table
from posor_estimator.core.kernels.stamps import times_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.bulk.layout import TableLayout
    from posor_estimator.core.types import BoolArray, IntArray


def stamps_of(table: Table) -> IntArray:
    """Return the stamps of messages with a header [ns], shape (n,); 0 where one is no time."""
    seconds, nanoseconds = (table[f"header.stamp.{part}"].astype(np.int64) for part in ("sec", "nanosec"))
    return times_ns(seconds, nanoseconds)


@dataclass(frozen=True)
class Transforms:
    """Transforms of one joint, n of them, in the order in which their scans were logged.

    Attributes:
        times_ns: Log times, shape (n,).
        places: Their order among those of all joints in a block, shape (n,).
        table: The transforms.
        stamps_ns: Their stamps, shape (n,).

    """

    times_ns: IntArray
    places: IntArray
    table: Table
    stamps_ns: IntArray

    @staticmethod
    def of(times_ns: IntArray, places: IntArray, table: Table) -> Transforms:
        """Return transforms with their stamps."""
        return Transforms(times_ns, places, table, stamps_of(table))

    @staticmethod
    def none(layout: TableLayout) -> Transforms:
        """Return no transforms."""
        nothing = np.empty(0, dtype=np.int64)
        return Transforms.of(nothing, nothing, layout.new(0))

    @staticmethod
    def joined(parts: Sequence[Transforms]) -> Transforms:
        """Return transforms one after the other; there must be at least one part."""
        parts = [part for part in parts if len(part)] or parts[:1]
        if len(parts) == 1:
            return parts[0]
        return Transforms(
            np.concatenate([part.times_ns for part in parts]),
            np.concatenate([part.places for part in parts]),
            Table(parts[0].table.layout, np.concatenate([part.table.rows for part in parts])),
            np.concatenate([part.stamps_ns for part in parts]),
        )

    def chosen(self, which: BoolArray | IntArray | slice) -> Transforms:
        """Return some of them."""
        return Transforms(self.times_ns[which], self.places[which], self.table.chosen(which), self.stamps_ns[which])

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.stamps_ns)
