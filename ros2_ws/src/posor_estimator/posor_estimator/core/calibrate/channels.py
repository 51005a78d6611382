"""The channels of scans: what they are called, and whether one of them stands while its neighbours do not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import FloatArray

KINDS = ("gap_voltages", "ring_voltages", "diode_currents")
CONTACTS = "ABCD"
LONG = 20
"""Scans with the same reading to the last digit, after each other: noise does not do that."""
LIVELY = 0.2
"""Share of scans from which on a neighbour's reading changes: then there is noise that the converter sees."""


def channel_name(kind: str, channel: int) -> str:
    """Return what to call a channel of a scan: ``gap voltage 2``, ``current C of diode 1``."""
    if kind == "diode_currents":
        diode, contact = divmod(channel, len(CONTACTS))
        return f"current {CONTACTS[contact]} of diode {diode + 1}"
    return f"{kind.removesuffix('s').replace('_', ' ')} {channel + 1}"


def check_channels(scans: Scans, kinds: Sequence[str], where: str) -> None:
    """Refuse a channel that keeps one reading while its neighbours change, whatever the target does.

    Neighbours are the other channels of the same kind, of a diode its other contacts. Where they stand too, the
    converter is too coarse for the noise, or the diode is dark: nothing is said.

    Args:
        scans: As they were recorded, not averaged.
        kinds: Which of ``KINDS`` matter.
        where: What to call the recording.

    Raises:
        FitError: One does; named with the scans from which and to which.

    """
    for kind in kinds:
        readings = getattr(scans, kind).reshape(len(scans), -1)
        count = readings.shape[1]
        size = len(CONTACTS) if kind == "diode_currents" else count
        for channel in range(count):
            first, last = _longest_stand(readings[:, channel])
            if last + 1 - first < LONG:
                continue
            begin = channel // size * size
            neighbours = [k for k in range(begin, begin + size) if k != channel]
            changes = np.mean(np.diff(readings[first : last + 1, neighbours], axis=0) != 0.0, axis=0)
            if neighbours and np.median(changes) > LIVELY:
                raise FitError(
                    f"{channel_name(kind, channel)} is stuck at {readings[first, channel]:.6g} from scan "
                    f"{scans.numbers[first]} to scan {scans.numbers[last]}, its neighbours are not",
                    where=where,
                    expected="a reading with noise",
                )


def _longest_stand(readings: FloatArray) -> tuple[int, int]:
    """Return first and last index of the longest run of equal readings (n,)."""
    ends = np.flatnonzero(np.concatenate([[True], np.diff(readings) != 0.0, [True]]))
    longest = int(np.argmax(np.diff(ends)))
    return int(ends[longest]), int(ends[longest + 1]) - 1
