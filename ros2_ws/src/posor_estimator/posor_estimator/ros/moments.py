"""Remembers when things happened and when they should have, at next to no cost; figures are made of it later."""

from __future__ import annotations

from array import array
from time import time_ns
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.kernels.moments import FIGURES, figures_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.types import IntArray

NS = 1_000_000_000
NEVER_NS = 2**63 - 1
ROOM = 1 << 14
"""Moments that are remembered; of more than these between two looks, the last ones."""


class Moments:
    """Pairs of times [ns]: one that is told, such as a stamp, and the present one; from one thread, read in another.

    The memory is a ring of fixed size, so that nothing is allocated and nobody waits: a pair counts once both of its
    times are written.
    """

    __slots__ = ("_arrays", "_happened", "_noted", "_taken", "_told", "now_ns")

    def __init__(self, now_ns: Callable[[], int] = time_ns) -> None:
        """Remember nothing yet; ``now_ns`` is the clock, and may be exchanged."""
        self.now_ns = now_ns
        self._told = array("q", bytes(8 * ROOM))
        self._happened = array("q", bytes(8 * ROOM))
        self._arrays = np.frombuffer(self._told, np.int64), np.frombuffer(self._happened, np.int64)
        self._noted = self._taken = 0

    def note(self, told_ns: int) -> None:
        """Remember a time and the present one."""
        number = self._noted
        place = number & (ROOM - 1)
        self._told[place] = told_ns
        self._happened[place] = self.now_ns()
        self._noted = number + 1

    def take(self) -> tuple[IntArray, IntArray]:
        """Return the times told and those at which they were, (n,) each [ns], since the last call."""
        end = self._noted
        begin = max(self._taken, end - ROOM)
        self._taken = end
        told, happened = self._arrays
        first, last = begin & (ROOM - 1), end & (ROOM - 1)
        if first <= last and end - begin < ROOM:
            return told[first:last].copy(), happened[first:last].copy()
        places = np.arange(begin, end) & (ROOM - 1)
        return told[places], happened[places]


def figures(name: str, values_ns: IntArray, limit_ns: int = NEVER_NS) -> dict[str, float]:
    """Return mean, standard deviation, least and greatest [s] of times [ns], (n,).

    Times as far from zero as the limit, or farther, do not count; where none does, there are no figures.
    """
    out = np.empty(FIGURES)
    if not figures_of(values_ns, limit_ns, out):
        return {}
    mean, deviation, least, greatest = (out * 1e-9).tolist()
    return {f"{name}_mean": mean, f"{name}_sd": deviation, f"{name}_min": least, f"{name}_max": greatest}
