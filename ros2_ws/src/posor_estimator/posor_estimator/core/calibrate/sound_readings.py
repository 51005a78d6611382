"""Readings that do not belong to the stop they were taken in: gross errors, missing numbers, another clock.

While the target stands, what a channel reads scatters by its noise and nothing else. What lies far beyond counts for
nothing and is named; where there is much of it, something else is wrong, and the recording is refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.calibrate.channels import channel_name
from posor_estimator.core.calibrate.checks import MOST_OUTLIERS, ROUNDING
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import BoolArray, FloatArray, IntArray

FAR = 10.0
"""Standard deviations from the median of its stop beyond which a reading does not belong to it."""
TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over the median of its absolute deviations."""
LEAST_SCANS = 4
"""Of a stop in which the odd one can be told from the others."""
NAMED = 3


def sound_parts(
    parts: Sequence[Scans], motion: FloatArray, judged: Sequence[str], where: str
) -> tuple[list[Scans], tuple[str, ...]]:
    """Return the scans of each stop with NaN for what does not belong there, and the sentences that name it.

    Args:
        parts: The scans of each stop.
        motion: How far the reference moved within each stop, over its whole travel, (d,): a channel may have followed.
        judged: Which kinds of readings matter.
        where: What to call the recording.

    Raises:
        FitError: More than a tenth of what a channel read does not belong to its stop.

    """
    said: list[str] = []
    lengths = [len(part) for part in parts]
    of_part = np.repeat(np.arange(len(parts)), lengths)
    numbers = np.concatenate([part.numbers for part in parts])
    out = list(parts)
    for kind in judged:
        shape = getattr(parts[0], kind).shape[1:]
        values = np.concatenate([getattr(part, kind).reshape(len(part), -1) for part in parts])
        for channel in range(values.shape[1]):
            bad = _odd(values[:, channel], of_part, motion)
            if bad.any():
                said.append(_sentence(bad, numbers, channel_name(kind, channel), where))
                values[bad, channel] = np.nan
        ends = np.cumsum(lengths)[:-1]
        for n, own in enumerate(np.split(values, ends)):
            out[n] = out[n].with_fields({kind: own.reshape(len(own), *shape)})
    return out, tuple(said)


def _odd(readings: FloatArray, of_part: IntArray, motion: FloatArray) -> BoolArray:
    """Return which readings (n,) of a channel do not belong to their stop; ``of_part`` says which that is, (n,)."""
    bad = np.zeros(len(readings), dtype=bool)
    known = np.isfinite(readings)
    if not known.any():
        return bad  # there is no such channel, or it never gave a number: its procedure knows whether it matters
    stops = list(_stops(readings, of_part, known))
    scatters = np.array([TO_SIGMA * np.median(np.abs(off)) for _, off in stops])
    noise = float(np.median(scatters[scatters > 0.0])) if np.any(scatters > 0.0) else 0.0
    levels = np.unique(readings[known])
    step = float(np.min(np.diff(levels))) if len(levels) > 1 else 0.0
    step = max(step, ROUNDING * float(np.max(np.abs(levels))))
    travel = float(np.ptp(readings[known]))
    for (which, off), scatter in zip(stops, scatters, strict=True):
        allowed = np.hypot(max(scatter, noise, step), travel * motion[of_part[which[0]]])
        bad[which[np.abs(off) > FAR * allowed]] = True
        bad[(of_part == of_part[which[0]]) & ~known] = True
    return bad


def _stops(readings: FloatArray, of_part: IntArray, known: BoolArray) -> Iterator[tuple[IntArray, FloatArray]]:
    """Yield of each stop with enough readings which these are (m,), and how far they are from their median (m,)."""
    for part in range(int(of_part[-1]) + 1):
        which = np.flatnonzero((of_part == part) & known)
        if len(which) >= LEAST_SCANS:
            yield which, readings[which] - np.median(readings[which])


def _sentence(bad: BoolArray, numbers: FloatArray, name: str, where: str) -> str:
    """Return the sentence that names what is left out of a channel.

    Raises:
        FitError: It is too much.

    """
    count = int(bad.sum())
    scans = [int(number) for number in numbers[bad]]
    if count > MOST_OUTLIERS * len(bad):
        raise FitError(
            f"{count} of {len(bad)} readings of {name} do not belong to the stops they were taken in, such as that of "
            f"scan {scans[0]}",
            where=where,
            expected=f"at most {100 * MOST_OUTLIERS:g} %, and a reference and scans that are stamped by one clock",
        )
    named = ", ".join(map(str, scans[:NAMED])) + (", ..." if count > NAMED else "")
    return (
        f"{where}: left out {count} of {len(bad)} readings of {name}, which do not belong to the stops they were taken "
        f"in (scan {named})."
    )
