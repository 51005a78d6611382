# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The history of an arm at falling resolution: windows of time, each with the same number of points.

A point holds the least and the largest value of each quantity in its part of the window, so that no peak is lost, and
the memory is bounded.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import FloatArray, IntArray

POINTS = 300  # of each window


class Points(NamedTuple):
    """The points of a window."""

    width_s: float  # of the part of the window that a point stands for
    times_s: FloatArray  # middle of each part (UTC), shape (n,)
    low: FloatArray  # least value of each quantity, shape (n, q); NaN: unknown
    high: FloatArray  # largest value, likewise
    runs: IntArray  # run of the arm, counted from zero, shape (n,)


class _Window:
    """The newest points of one resolution."""

    def __init__(self, width_s: float) -> None:
        self._width_s = width_s
        self._points = deque[tuple[int, "FloatArray", "FloatArray", int]](maxlen=POINTS + 1)

    def add(self, time_s: float, values: FloatArray, run: int) -> None:
        part, last = int(time_s // self._width_s), self._points[-1] if self._points else None
        if last is not None and part == last[0] and run == last[3]:
            np.fmin(last[1], values, out=last[1])
            np.fmax(last[2], values, out=last[2])
        else:
            self._points.append((part, values.copy(), values.copy(), run))

    def points(self, quantities: int) -> Points:
        parts, low, high, runs = zip(*self._points, strict=True) if self._points else ((), (), (), ())
        times_s = (np.array(parts) + 0.5) * self._width_s
        shape = len(parts), quantities
        return Points(
            self._width_s, times_s, np.reshape(low, shape), np.reshape(high, shape), np.array(runs, dtype=np.int64)
        )


class History:
    """Values of some quantities.

    Attributes:
        windows_s: Length of each window [s], from the shortest to the longest.
        run: Number of the present run of the arm.
        newest_s: Time of the newest values (UTC) [s]; minus infinity: there are no values.

    """

    def __init__(self, quantities: int, windows_s: Sequence[float]) -> None:
        self._quantities = quantities
        self.windows_s = tuple(windows_s)
        self._windows = [_Window(window_s / POINTS) for window_s in windows_s]
        self.run = 0
        self.newest_s = -np.inf

    def add(self, time_s: float, values: FloatArray) -> bool:
        """Add values (q,) at a time (UTC); NaN: unknown. Return False where the time goes back: then all others go."""
        goes_on = time_s >= self.newest_s
        if time_s == self.newest_s:
            return True
        if not goes_on:
            self._windows = [_Window(window_s / POINTS) for window_s in self.windows_s]
        for window in self._windows:
            window.add(time_s, values, self.run)
        self.newest_s = time_s
        return goes_on

    @property
    def is_filled(self) -> bool:
        """Whether there is a point."""
        return bool(np.isfinite(self.newest_s))

    def points(self, window: int) -> Points:
        """Return the points of a window, by its place among ``windows_s``."""
        return self._windows[window].points(self._quantities)
