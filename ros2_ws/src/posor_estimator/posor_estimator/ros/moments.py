"""Remembers when things happened and when they should have, at next to no cost; figures are made of it later."""

from __future__ import annotations

from array import array
from time import time_ns
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.types import IntArray
    from posor_estimator.ros.diagnostics import Value

NS = 1_000_000_000
ROOM = 1 << 14
"""Moments that are remembered; of more than these between two looks, the last ones."""


class Moments:
    """Pairs of times [ns]: one that is told, such as a stamp, and the present one; from one thread, read in another.

    The memory is a ring of fixed size, so that nothing is allocated and nobody waits: a pair counts once both of its
    times are written.
    """

    __slots__ = ("_happened", "_noted", "_taken", "_told", "now_ns")

    def __init__(self, now_ns: Callable[[], int] = time_ns) -> None:
        """Remember nothing yet; ``now_ns`` is the clock, and may be exchanged."""
        self.now_ns = now_ns
        self._told = array("q", bytes(8 * ROOM))
        self._happened = array("q", bytes(8 * ROOM))
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
        places = np.arange(begin, end) & (ROOM - 1)
        return np.frombuffer(self._told, np.int64)[places], np.frombuffer(self._happened, np.int64)[places]


def figures(name: str, values_ns: IntArray) -> dict[str, Value]:
    """Return mean, standard deviation, least and greatest [s] of times [ns], (n,), at least one."""
    seconds = values_ns * 1e-9
    mean = seconds.mean()
    spread = float(np.sqrt(((seconds - mean) ** 2).sum() / max(1, seconds.size - 1)))
    return {
        f"{name}_mean": float(mean),
        f"{name}_sd": spread,
        f"{name}_min": float(seconds.min()),
        f"{name}_max": float(seconds.max()),
    }
