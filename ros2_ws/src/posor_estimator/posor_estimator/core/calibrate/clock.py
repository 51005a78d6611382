"""Whether reference and scans are stamped by one clock, seen by a motion that both follow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.errors import TrackError

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

LONGEST_LAG, LARGEST_LAG, LAGS = 0.2, 5.0, 201
"""Share of a recording, and time [s], up to which a clock may be off to be told; so many lags are tried."""
SMALLEST_MISFIT = 1e-6
"""Of the reference's travel: a smaller misfit may come from rounding."""
MUCH_BETTER = 3.0
"""So many times smaller is the misfit at the right lag of a reference that is off."""


def check_clock(stamps_ns: IntArray, measured: FloatArray, reference: FloatArray, source: str) -> None:
    """Refuse a reference whose motion is that of the readings at another time: its stamps are of another clock.

    Args:
        stamps_ns: Of both [ns], (n,).
        measured: What the present calibration makes of the readings, (n,).
        reference: The reference, (n,).
        source: What to call the reference.

    Raises:
        TrackError: It is; how late it is, is said.

    """
    seconds = (stamps_ns - stamps_ns[0]) * 1e-9
    most = min(LONGEST_LAG * float(seconds[-1]), LARGEST_LAG)
    lags = np.linspace(-most, most, LAGS)
    inside = (seconds >= most) & (seconds <= seconds[-1] - most)
    if np.count_nonzero(inside) < LAGS // 4:
        return
    known = np.column_stack([np.ones(int(inside.sum())), measured[inside]])
    misfits = []
    for lag in [0.0, *lags]:
        shifted = np.interp(seconds[inside] + lag, seconds, reference)
        misfits.append(float(np.sqrt(np.linalg.lstsq(known, shifted, rcond=None)[1].sum())))
    best = int(np.argmin(misfits[1:]))
    noticed = SMALLEST_MISFIT * float(np.ptp(reference)) * float(np.sqrt(inside.sum()))
    if misfits[0] > noticed and misfits[1 + best] * MUCH_BETTER < misfits[0]:
        raise TrackError(
            f"moves as the readings do about {abs(lags[best]):.2g} s {'later' if lags[best] > 0.0 else 'earlier'}",
            where=source,
            expected="stamps of the clock that stamps the scans",
        )
