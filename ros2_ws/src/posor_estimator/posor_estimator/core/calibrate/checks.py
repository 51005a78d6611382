"""What can be wrong with data before anything is fitted to them, or after; each finding is one sentence."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import spearmanr, theilslopes

from posor_estimator.errors import FitError, TrackError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.types import BoolArray, FloatArray

WRONG_UNITS = {
    1000.0: "it is in millimetres",
    1e6: "it is in micrometres",
    1.0 / 0.0254: "it is in inches",
    1e-3 / 0.0254: "it is in inches taken for millimetres",
    25.4: "it was converted from inches but was in millimetres",
    0.0254: "it was converted from inches but was in metres",
    1e-3: "it was converted from millimetres but was in metres",
    180.0 / math.pi: "it is in degrees",
    math.pi / 180.0: "it was converted from degrees but was in radians",
}
"""What a reference is that moves by such a factor too far."""
UNIT_WITHIN = 0.1
"""How far from such a factor the ratio may be, relative."""
PLAUSIBLE = (0.5, 2.0)
"""Of a reference's travel to what the present calibration says of it."""
STUCK_SIGMAS = 6.0
ROUNDING = 1e-12
"""Relative; means of equal numbers differ by so much."""
STUCK_RUN = 3
"""So many stops at different places with the same reading to the last digit: the channel stands."""
ALIKE = 0.9
"""Rank correlation from which two motions are taken for the same."""
UNLIKE = 0.5
MOST_OUTLIERS = 0.1
"""Share of outliers beyond which the data are refused rather than fitted without them."""
IMPROBABLE = 1e-3


def check_enough(count: int, least: int, what: str, where: str) -> None:
    """Refuse too few stops (or whatever ``what`` names).

    Raises:
        FitError: There are fewer than ``least``.

    """
    if count < least:
        raise FitError(f"{count} {what}", where=where, expected=f"at least {least}")


def check_alive(names: Sequence[str], means: FloatArray, sigmas: FloatArray, moved: FloatArray, where: str) -> None:
    """Refuse channels that stand while the reference moves.

    Args:
        names: Of the channels.
        means: Their readings at the stops, (d, c).
        sigmas: Standard uncertainties of those, (d, c); NaN where unknown.
        moved: Reference at the stops, (d, k).
        where: What to call the recording.

    Raises:
        FitError: One does; also when it stands only from some stop on, or gives no numbers.

    """
    places = np.any(np.diff(moved, axis=0) != 0.0, axis=1)
    for index, name in enumerate(names):
        readings = means[:, index]
        if not np.isfinite(readings).all():
            raise FitError(f"{name} is not finite at stop {int(np.argmin(np.isfinite(readings))) + 1}", where=where)
        noise = np.nan_to_num(np.max(sigmas[:, index]), nan=0.0)
        rounding = ROUNDING * float(np.max(np.abs(readings)))
        if np.ptp(readings) <= max(STUCK_SIGMAS * noise, rounding):
            raise FitError(
                f"{name} stays at {readings[0]:.6g} while the reference moves, it is stuck or does not see the motion",
                where=where,
                expected="a reading that changes by more than its noise",
            )
        same = (np.abs(np.diff(readings)) <= rounding) & places
        run = np.convolve(same, np.ones(STUCK_RUN - 1, dtype=int), mode="valid") == STUCK_RUN - 1
        if run.any():
            stop = int(np.argmax(run))
            raise FitError(
                f"{name} is stuck at {readings[stop]:.6g} from stop {stop + 1} on while the reference moves",
                where=where,
                expected="a reading that changes",
            )


def check_unit(measured: FloatArray, reference: FloatArray, source: str, unit: str) -> None:
    """Refuse a reference that moves by another factor than the present calibration says, or the other way round.

    Args:
        measured: What the present calibration makes of the readings, (d,), in ``unit``.
        reference: The reference at the same stops, (d,).
        source: What to call the reference.
        unit: What it should be in.

    Raises:
        TrackError: It does; a factor that a wrong unit makes is named.

    """
    ratio = float(theilslopes(reference, measured)[0])
    if ratio < 0.0:
        raise TrackError(
            f"falls where the readings rise, by {abs(ratio):.3g} of their motion",
            where=source,
            expected="the other sign, see the option direction",
        )
    if PLAUSIBLE[0] <= ratio <= PLAUSIBLE[1]:
        return
    wrong = [what for factor, what in WRONG_UNITS.items() if abs(ratio / factor - 1.0) < UNIT_WITHIN]
    said = f", as if {wrong[0]}" if wrong else ""
    raise TrackError(
        f"moves {ratio:.4g} times as far as the present calibration says{said}",
        where=source,
        expected=f"values in {unit}",
    )


def check_axis(measured: FloatArray, reference: FloatArray, column: int, names: Sequence[str], source: str) -> None:
    """Refuse a reference of several axes of which another one than the chosen moves with the readings.

    Args:
        measured: What moves with the right axis, (d,).
        reference: (d, k).
        column: The chosen axis.
        names: Of the axes.
        source: What to call the reference.

    Raises:
        TrackError: The chosen axis does not move with the readings and another does.

    """
    likeness = [_likeness(measured, reference[:, k]) for k in range(reference.shape[1])]
    best = int(np.argmax(likeness))
    if best != column and likeness[best] >= ALIKE and likeness[column] < UNLIKE:
        raise TrackError(
            f"axis {names[best]} moves with the readings, axis {names[column]} does not; the axes look swapped",
            where=source,
            expected=f"the motion along {names[column]}",
        )


def _likeness(one: FloatArray, other: FloatArray) -> float:
    """Return the size of the rank correlation, zero where one of them stands."""
    if np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return 0.0
    return abs(float(spearmanr(one, other).statistic))


def outlier_sentences(outliers: BoolArray, names: Sequence[str], where: str) -> tuple[str, ...]:
    """Return the sentence that names the outliers left out, none where there are none.

    Args:
        outliers: Which data are, (n,).
        names: What to call each.
        where: What to call the fit.

    Raises:
        FitError: There are too many of them to be accidents.

    """
    count = int(outliers.sum())
    if count > MOST_OUTLIERS * len(outliers):
        raise FitError(
            f"{count} of {len(outliers)} readings do not fit, such as {names[int(np.argmax(outliers))]}",
            where=where,
            expected=f"at most {100 * MOST_OUTLIERS:g} % outliers",
        )
    said = ", ".join(name for name, out in zip(names, outliers, strict=True) if out)
    return (f"{where}: left out {said}, which do not fit the others.",) if count else ()


def misfit_sentences(fit: Fit, where: str) -> tuple[str, ...]:
    """Return the sentence that says that residuals exceed the stated uncertainties, none where they do not."""
    if fit.probability >= IMPROBABLE:
        return ()
    said = f"the residuals are {fit.spread:.3g} times as large as the stated uncertainties explain"
    return (f"{where}: {said}; the uncertainties of the result are enlarged by that.",)
