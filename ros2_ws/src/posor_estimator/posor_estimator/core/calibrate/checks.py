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
"""So many stops at different places with the same reading to the last digit: the channel may stand."""
STUCK_STEPS, STUCK_SHARE = 3.0, 0.1
"""Steps of the converter, and share of the channel's travel: by so much the reading should have changed meanwhile."""
SINGULAR = 1e-10
"""Of the largest singular value: motions that the stops do not tell apart."""
SAME_STEP, SMALLEST_STEP = 1e-9, 1e-6
"""Relative to the readings: multiples of a converter's step are whole within the first, the step exceeds the second."""
ALIKE = 0.9
"""Rank correlation from which two motions are taken for the same."""
UNLIKE = 0.5
MOST_OUTLIERS = 0.1
"""Share of outliers beyond which the data are refused rather than fitted without them."""
IMPROBABLE = 1e-3
MOST_SPREAD = 10.0
"""Residuals over the stated uncertainties beyond which data and model have nothing to do with one another."""


def check_enough(count: int, least: int, what: str, where: str) -> None:
    """Refuse too few stops (or whatever ``what`` names).

    Raises:
        FitError: There are fewer than ``least``.

    """
    if count < least:
        raise FitError(f"{count} {what}", where=where, expected=f"at least {least}")


def check_alive(names: Sequence[str], means: FloatArray, sigmas: FloatArray, moved: FloatArray, where: str) -> None:
    """Refuse channels that stand while the reference moves.

    Readings of a converter are equal to the last digit also where the motion turns round, or hardly moves a channel:
    such a channel stands only where the motion should have moved it, roughly as it did at all other stops.

    Args:
        names: Of the channels.
        means: Their readings at the stops, (d, c).
        sigmas: Standard uncertainties of those, (d, c); NaN where unknown.
        moved: What the readings follow more or less in proportion, the reference or other channels, (d, k).
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
        runs = _runs(same)
        step = _converter_step(readings, rounding) if runs else 0.0
        allowed = max(STUCK_STEPS * step, STUCK_SHARE * float(np.ptp(readings))) if step else 0.0
        for first, change in zip((first for first, _ in runs), _expected_changes(readings, moved, runs), strict=True):
            if change > allowed:
                raise FitError(
                    f"{name} is stuck at {readings[first]:.6g} from stop {first + 1} on while the reference moves",
                    where=where,
                    expected="a reading that changes",
                )


def _runs(same: BoolArray) -> list[tuple[int, int]]:
    """Return first and last stop of each run of equal readings that is long enough; same (d - 1,)."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
    return [(int(a), int(b)) for a, b in ends.reshape(-1, 2) if b - a >= STUCK_RUN - 1]


def _expected_changes(readings: FloatArray, moved: FloatArray, runs: Sequence[tuple[int, int]]) -> list[float]:
    """Return by how much a channel should have changed within each run, by its readings at all stops outside."""
    spread = np.ptp(moved, axis=0)
    places = (moved - moved.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
    known = np.column_stack([np.ones(len(readings)), places])
    square, product = known.T @ known, known.T @ readings
    changes = []
    for first, last in runs:
        run = slice(first, last + 1)
        if len(readings) - (last + 1 - first) <= known.shape[1]:
            changes.append(math.inf)
            continue
        outside = square - known[run].T @ known[run], product - known[run].T @ readings[run]
        slopes = np.linalg.lstsq(*outside, rcond=SINGULAR)[0]
        changes.append(float(np.ptp(known[run] @ slopes)))
    return changes


def _converter_step(readings: FloatArray, rounding: float) -> float:
    """Return what all readings are whole multiples of, counted from any one of them; zero if there is no such step."""
    steps = np.diff(np.unique(readings))
    least, step = SAME_STEP * float(np.max(np.abs(readings))), 0.0
    for other in steps[steps > rounding]:
        one = float(other)
        while one > least:
            rest = math.fmod(step, one)
            step, one = one, min(rest, one - rest)
    return step if step > SMALLEST_STEP * float(np.max(np.abs(readings))) else 0.0


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


def check_spread(fit: Fit, readings: Sequence[str], where: str) -> None:
    """Refuse a fit whose residuals are far beyond the stated uncertainties.

    Args:
        fit: The fit.
        readings: What to call each residual, (n,); none: the worst is not named.
        where: What to call the fit.

    Raises:
        FitError: They are.

    """
    if fit.spread > MOST_SPREAD and fit.probability < IMPROBABLE:
        worst = int(np.argmax(np.abs(fit.residuals)))
        named = f", the worst is that of {readings[worst]}" if readings else ""
        raise FitError(
            f"the residuals are {fit.spread:.3g} times as large as the stated uncertainties explain{named}",
            where=where,
            expected=f"at most {MOST_SPREAD:g} times; a larger uncertainty of the reference, if that is what it has",
        )


def misfit_sentences(fit: Fit, where: str) -> tuple[str, ...]:
    """Return the sentence that says that residuals exceed the stated uncertainties, none where they do not."""
    if fit.probability >= IMPROBABLE:
        return ()
    said = f"the residuals are {fit.spread:.3g} times as large as the stated uncertainties explain"
    return (f"{where}: {said}; the uncertainties of the result are enlarged by that.",)
