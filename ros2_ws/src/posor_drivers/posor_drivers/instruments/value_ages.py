# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ages of the values in frames: a device may send frames, or answer, more often than its converter has new values.

A value that is equal to the last bit to that of the frame before may have been measured as early as in the period
before the first of the equal frames. This time is the age of the value. A sound device with a coarse converter repeats
values, too. Two rules separate them:

* A channel whose value has changed in each of ``RENEWED_FRAMES`` frames in a row has new values in every frame: its
  ages count as zero from then on, however often it repeats a value. The noise of a sound channel, or one fast motion,
  shows this at once; a converter that needs 1.25 frame periods or more never does. An asked device may answer late, so
  such frames may take up to ``LONGEST_PERIOD`` nominal periods each, on average.
* A channel whose value then changes in ``CHANGES_APART`` of ``CHECKED_FRAMES`` frames, but never in two of them in a
  row, has become slower: its ages count again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_drivers.instruments.frame_store import CAPACITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

    from posor_drivers.instruments.frame_store import FrameStore

RENEWED_FRAMES, LONGEST_PERIOD = 4, 1.5
CHANGES_APART, CHECKED_FRAMES = 20, 1024
FEWEST_FRAMES, MORE_FRAMES = 128, 8
"""Frames among which the first of equal ones is looked for, and by which factor more where it is not among them."""


class ValueAges:
    """Finds how long the channels of a device have kept the values of its newest frames.

    Attributes:
        kept_s: Longest time for which each channel has lately kept a value, (c,) [s]; zero where it has new ones in
            each frame.

    """

    def __init__(self, frames: FrameStore, channels: int) -> None:
        """Start: no channel has shown new values in each frame yet."""
        self._frames, self._is_renewed, self._checked = frames, np.zeros(channels, dtype=bool), 0
        self.kept_s = np.zeros(channels)

    def age_s(self, number: int, columns: Sequence[int]) -> float:
        """Return the greatest age of values in the frame of a number and the two before it [s].

        ``columns``: channels that are looked at.
        """
        if number - self._checked >= CHECKED_FRAMES:
            self._checked = number
            self._find_slower(number)
        doubtful = [column for column in columns if not self._is_renewed[column]]
        if not doubtful:
            return 0.0
        count, is_found = FEWEST_FRAMES, False
        while not is_found and count <= CAPACITY:
            numbers, times_s, values = self._frames.until(number, count, doubtful)
            changed = _changes(values)
            is_found, count = bool(changed[:-2].any(axis=0).all()), MORE_FRAMES * count
        streaks = _streaks(changed, numbers)
        within_s = RENEWED_FRAMES * LONGEST_PERIOD * self._frames.period_s
        is_fast = times_s[RENEWED_FRAMES:] - times_s[:-RENEWED_FRAMES] <= within_s
        is_renewed = (streaks[RENEWED_FRAMES - 1 :] >= RENEWED_FRAMES) & is_fast[:, None]
        self._is_renewed[doubtful] = is_renewed.any(axis=0)
        frames = np.arange(1, len(values))[:, None]
        first_equal = np.maximum.accumulate(np.where(changed, frames, 1), axis=0)
        ages_s = np.maximum(times_s[1:, None] - times_s[first_equal - 1], 0.0)  # less where the clock was set back
        ages_s[:, self._is_renewed[doubtful]] = 0.0
        self.kept_s[doubtful] = ages_s.max(axis=0)
        return float(ages_s[-3:].max())

    def _find_slower(self, number: int) -> None:
        """Find the channels that no longer have new values in each frame."""
        numbers, _, values = self._frames.until(number, CHECKED_FRAMES, slice(None))
        changed = _changes(values)
        is_slower = np.count_nonzero(changed, axis=0) >= CHANGES_APART
        self._is_renewed &= ~(is_slower & (_streaks(changed, numbers).max(axis=0) == 1))


def _changes(values: FloatArray) -> BoolArray:
    """Return where values of frames differ from those of the frame before, (n - 1, c); invalid ones do not."""
    after = values[1:]
    changed: BoolArray = (after != values[:-1]) & (after == after)  # noqa: PLR0124  NaN
    return changed


def _streaks(changed: BoolArray, numbers: IntArray) -> IntArray:
    """Return in how many frames in a row each channel has changed until each one, (n - 1, c); lost ones end a row."""
    frames = np.arange(1, len(numbers))[:, None]
    is_new = changed & (np.diff(numbers) == 1)[:, None]
    streaks: IntArray = frames - np.maximum.accumulate(np.where(is_new, 0, frames), axis=0)
    return streaks
