# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ages of the values in frames: a device may send frames, or answer, more often than its converter has new values.

A value that is equal to the last bit to that of the frame before may have been measured just after the frame before the
first of the equal frames. The time since then is the age of the value. A value that has not changed since the first
stored frame has an unknown age, which counts as ``CAPACITY`` periods, the longest that is looked at. A sound device
with a coarse converter repeats values, too. Two rules separate them:

* A channel whose value has changed in each of ``RENEWED_FRAMES`` frames in a row has new values in every frame: its
  ages count as zero from then on, however often it repeats a value. The noise of a sound channel, or one fast motion,
  shows this at once. A converter with an interval of P periods changes in n frames in a row only if (n - 1) P < n, so
  one of 1.25 periods or more never does. An asked device may answer late, so such frames may take up to
  ``LONGEST_PERIOD`` nominal periods each, on average.
* A channel whose value then changes ``ISOLATED_CHANGES`` times, but never in two frames in a row, however long this
  takes, has become slower: its ages count again. An interval below two periods shows two changes in a row, so a channel
  that becomes slower by less is not found.

A gateway that pauses now and then repeats the values of all channels at once, also of those with new values in every
frame. A bearing that comes to rest in front of a coarse converter without noise looks alike, but it slows down before.
After its last two changes c0, c1 a channel would change by 2 c1 - c0 next: an even deceleration to rest makes this zero
or opposite to c1, in a pause it is the motion, or noise. So the ages of frames in which all these channels repeat their
values count where this change is more than ``PAUSE_STEPS`` steps of the converter, and at least ``PAUSE_REPETITIONS``
values of channels with such a change are repeated. The step is the smallest change that the channel has shown. Errors
of rounding are at most three steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from posor_drivers.instruments.frame_store import CAPACITY, NO_FRAME

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

    from posor_drivers.instruments.device import Device
    from posor_drivers.instruments.frame_store import FrameStore

RENEWED_FRAMES, LONGEST_PERIOD = 5, 1.5
ISOLATED_CHANGES = 20
CHECKED_FRAMES = 128
"""Frames after which isolated changes are counted."""
RECENT_FRAMES = 128
"""Newest frames in which each call looks for the first of equal ones; once in half as many frames it looks in all.

Where channels with new values in every frame all repeat them for longer, the bearing is at rest.
"""
PAUSE_STEPS, PAUSE_REPETITIONS = 4, 6
"""Noise of two or more channels looks like a pause in less than one frame of 10000."""
LEAST_REPEATED_PERIODS = 1.5
"""Age in periods from which a channel is reported."""


class ValueAges:
    """Finds the ages of the values of a device in its newest frames.

    Attributes:
        longest_s: Greatest age that each channel has lately had, (c,) [s]; zero where it has new values in each frame.

    """

    def __init__(self, frames: FrameStore, channels: int) -> None:
        """Start: no channel has shown new values in each frame yet."""
        self._frames, self._is_renewed = frames, np.zeros(channels, dtype=bool)
        self._checked, self._isolated = -CHECKED_FRAMES, np.zeros(channels, dtype=np.int64)
        self._slower_until = np.full(channels, NO_FRAME)
        self._smallest = np.full(channels, np.inf)  # change of each channel that was not zero
        self._paused = 0  # newest frame of a call that found a pause
        # Frame of the last search among all frames, ages in it [s], and channels without a change in any of them.
        self._searched, self._found_s = NO_FRAME, np.zeros(channels)
        self._is_constant: BoolArray = np.ones(channels, dtype=bool)
        self.longest_s = np.zeros(channels)

    def age_s(self, first: int, last: int, columns: Sequence[int]) -> float:
        """Return the greatest age of values in stored frames, from the first number to the last one [s].

        ``columns``: channels that are looked at.
        """
        if last - self._checked >= CHECKED_FRAMES:
            self._find_slower(last)
        doubtful = [column for column in columns if not self._is_renewed[column]]
        age_s = self._doubtful_age_s(first, last, doubtful) if doubtful else 0.0
        return max(age_s, self._pause_s(first, last, [column for column in columns if self._is_renewed[column]]))

    def _doubtful_age_s(self, first: int, last: int, doubtful: list[int]) -> float:
        """Return the greatest age in frames of channels that have not shown new values in each; find which do [s]."""
        numbers, times_s, values = self._frames.frames_up_to(last, RECENT_FRAMES, doubtful)
        changed = _changes(values)
        streaks = _streaks(changed, numbers)[RENEWED_FRAMES - 1 :]
        within_s = RENEWED_FRAMES * LONGEST_PERIOD * self._frames.period_s
        is_fast = times_s[RENEWED_FRAMES:] - times_s[:-RENEWED_FRAMES] <= within_s
        is_later = numbers[RENEWED_FRAMES:, None] > self._slower_until[doubtful]
        is_renewed = ((streaks >= RENEWED_FRAMES) & is_fast[:, None] & is_later).any(axis=0)
        self._is_renewed[doubtful] = is_renewed
        frames = np.arange(1, len(values))[:, None]
        first_equal = np.maximum.accumulate(np.where(changed, frames, 1), axis=0)
        ages_s = np.maximum(times_s[1:, None] - times_s[first_equal - 1], 0.0)  # less where the clock was set back
        is_old, unknown_s = ~(changed[numbers[1:] <= first].any(axis=0) | is_renewed), 0.0
        if is_old.any():
            older_s = self._older_s(first)[doubtful] + (times_s[1:, None] - times_s[numbers == first])
            ages_s = np.where(is_old & ~np.logical_or.accumulate(changed, axis=0), older_s, ages_s)
            if (is_old & self._is_constant[doubtful]).any():
                unknown_s = CAPACITY * self._frames.period_s
        ages_s[:, is_renewed] = 0.0
        self.longest_s[doubtful] = ages_s.max(axis=0)
        return max(float(ages_s[numbers[1:] >= first].max()), unknown_s)

    def _pause_s(self, first: int, last: int, columns: list[int]) -> float:
        """Return the greatest age in frames of channels with new values in each, while all of them pause [s]."""
        if last - self._paused > RECENT_FRAMES:
            self.longest_s[columns] = 0.0
        if not columns[1:]:  # one alone may be at the limit of its range
            return 0.0
        _, _, values = self._frames.frames_up_to(last, last - first + 2, columns)
        if _changes(values).any(axis=1).all():
            return 0.0
        numbers, times_s, values = self._frames.frames_up_to(last, RECENT_FRAMES, columns)
        frames, changes = np.arange(1, len(values)), np.diff(values, axis=0)
        newest = np.maximum.accumulate(np.where(_changes(values).any(axis=1), frames, 0))
        following = np.sign(changes[1:]) * (2.0 * changes[1:] - changes[:-1])
        moving = np.count_nonzero(following > PAUSE_STEPS * self._smallest[columns], axis=1)
        repetitions = (frames - newest) * np.concatenate([[0, 0], moving])[newest]
        ages_s = np.where(repetitions >= PAUSE_REPETITIONS, times_s[1:] - times_s[newest - 1], 0.0)
        age_s = float(ages_s[numbers[1:] >= first].max())
        if age_s > 0.0:
            self.longest_s[columns], self._paused = np.maximum(self.longest_s[columns], age_s), last
        return age_s

    def _older_s(self, number: int) -> FloatArray:
        """Return the ages in a frame of the channels that have no new value in the recent frames, (c,) [s].

        Of a channel that has not changed in any stored frame it is the time since the first of them.
        """
        if not 0 <= number - self._searched < RECENT_FRAMES // 2:
            _, times_s, values = self._frames.frames_up_to(number, CAPACITY, slice(None))
            changed = _changes(values)
            self._is_constant, self._searched = np.logical_and.reduce(~changed, axis=0), number
            before_newest = np.where(changed, np.arange(len(changed))[:, None], 0).max(axis=0, initial=0)
            self._found_s = times_s[-1] - times_s[before_newest]
        _, times_s, _ = self._frames.frames_up_to(number, number - self._searched + 1, [])
        return np.asarray(self._found_s + max(0.0, float(times_s[-1] - times_s[0])))

    def fault(self, device: Device[Any]) -> str:
        """Return a sentence on the channel of the device with the oldest values; empty: new ones in each frame."""
        age_s, period_s = self.longest_s.max(), 1.0 / device.frame_rate
        if age_s < LEAST_REPEATED_PERIODS * period_s:
            return ""
        name = device.channels[int(self.longest_s.argmax())].name
        what = f"channel '{name}' repeats its values for {1e3 * age_s:.3g} ms"
        expected = f"new ones after {1e3 * period_s:.3g} ms, in each frame; this time is part of the stamps' error"
        return str(device.error(what, expected))

    def _find_slower(self, number: int) -> None:
        """Find, up to a frame, the channels that no longer have new values in each frame, and the smallest changes."""
        count = min(number - self._checked + 2, CAPACITY)  # with the change of the last frame that was counted
        numbers, _, values = self._frames.frames_up_to(number, count, slice(None))
        changed = _changes(values)
        sizes = np.abs(np.diff(values, axis=0))
        self._smallest = np.fmin(self._smallest, np.fmin.reduce(sizes, axis=0, where=changed, initial=np.inf))
        is_new, self._checked = numbers[1:] > self._checked, number
        is_in_row = _streaks(changed, numbers)[is_new] > 1
        is_isolated = changed[is_new] & ~np.logical_or.accumulate(is_in_row[::-1], axis=0)[::-1]
        self._isolated[is_in_row.any(axis=0)] = 0
        self._isolated += np.count_nonzero(is_isolated, axis=0)
        is_slower = self._isolated >= ISOLATED_CHANGES
        self._is_renewed &= ~is_slower
        self._slower_until[is_slower] = number


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
