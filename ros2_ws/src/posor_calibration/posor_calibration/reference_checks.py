# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of a reference beside the fit: values that it repeats while the target moves, and its drift.

A reference that has stopped, such as a tracker whose beam is broken, often repeats its last value. At rest, a reference
of coarse resolution repeats values too: values are repeated wrongly only where the readings move meanwhile.

A drift of the reference in proportion to time (warm-up, dead path, stage) is tested by a second fit to a reference with
such a drift. What this fit does not absorb into the result remains in the residuals, and shows the drift with its
uncertainty. A single travel from one end to the other absorbs the drift: only a target that returns to places where it
has been before shows it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.bags.recording import POSE
from posor.errors import FitError, PosorError, TrackError
from posor.numerics.stamps import NS
from posor.sensors.base import READING_KINDS
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from posor_calibration.data_checks import MOST_OUTLIERS
from posor_calibration.diode_spots import current_ratios
from posor_calibration.procedure import ANGLES, LARGEST_DRIFT, DriftTest

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor.bags.recording import Recording, Track
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import BoolArray, FloatArray

    from posor_calibration.procedure import Options, Outcome, Procedure

LEAST_SCANS = 5  # scans during equal values of the reference below which their motion is not judged
TRIMMED = 0.3  # share of these scans at either end, where reference and target need not stop at one time
BLOCKS = 3  # means of the other scans, among which motion is searched
TOGETHER = 0.02  # share of the largest motion of combined channels below which a combination shows nothing
CLEAR_MOTION = 20.0  # motion of a channel, in standard deviations of its noise, below which it shows nothing
FILTERED = 7  # scans of the median filter against outliers
MOTION_SIGMAS = 8.0  # range of these means in their standard deviations; Gaussian noise exceeds it in 5e-8 of the runs
MOTION_SHARE = 2e-3  # range of these means over the travel below which drift of the readings may be the cause
MAD_OF_SECOND_DIFFERENCES = 0.6745 * float(np.sqrt(6.0))  # median of their absolute values over the noise
STATED_SIGMAS = 3.0  # standard uncertainties of the reference by which it may be wrong

SHIFTS = (1.0, 1e-2)  # drifts of the second fit in standard uncertainties of the reference; the next where one fails
UNSTATED = 1e-4  # drift of the second fit over the travel of a reference without stated uncertainty
HARMLESS = 0.05  # change of the fitted values, in their standard uncertainties, below which a drift does not matter
OTHER_READINGS = 1e-3  # change of the derivatives, over the largest, above which fits have left out other readings
SAME_PLACE, ELSEWHERE = 0.01, 0.1
"""Distances over the travel within which two dwells are visits of one place, and beyond which the target has left."""
MODEL_ERROR = 0.05  # relative error of a calibration before its fit, over the distance of two visits


def check_visits(measured: FloatArray, reference: FloatArray, sigmas: FloatArray, where: str) -> None:
    """Raise FitError if a reference (d,) has drifted between two visits of one place.

    Fits leave single dwells out that do not fit the others: the return to the start must be compared before.
    ``measured`` (d,) are the readings by the present calibration, in the unit of the reference, ``sigmas`` (d,) the
    standard uncertainties of both together.
    """
    travel = float(np.ptp(measured))
    for later in range(2, len(measured)):
        distances = np.abs(measured[:later] - measured[later])
        away = np.flatnonzero(distances > ELSEWHERE * travel)
        visits = np.flatnonzero(distances < SAME_PLACE * travel)
        for first in visits[visits < (away[-1] if away.size else 0)].tolist():
            moved = float(measured[later] - measured[first])
            drift = float(reference[later] - reference[first]) - moved
            sigma = float(np.hypot(np.hypot(sigmas[first], sigmas[later]), MODEL_ERROR * moved))
            if abs(drift) > LARGEST_DRIFT * sigma:
                raise FitError(
                    f"the reference has drifted by {drift:.2g} +- {sigma:.1g} between two visits of one place, "
                    f"dwells {first + 1} and {later + 1}",
                    where=where,
                    expected=f"at most {LARGEST_DRIFT:g} standard uncertainties",
                )


def without_repeated_values(recording: Recording) -> tuple[Recording, tuple[str, ...]]:
    """Return the recording without values that a reference repeats while the readings move, and sentences on them.

    Raises TrackError: a reference repeats more than a tenth of its values so.
    """
    tracks, sentences = dict(recording.tracks), []
    for topic, track in recording.tracks.items():
        repeated = find_repeated_values(recording, track)
        count = int(repeated.sum())
        if not count:
            continue
        first = (int(track.stamps_ns[int(np.argmax(repeated))]) - int(track.stamps_ns[0])) / NS
        what = (
            f"repeats a value at {count} of {len(repeated)} values while the readings move, first after {first:.3g} s"
        )
        if count > MOST_OUTLIERS * len(repeated):
            expected = f"a reference that follows the target; at most {100 * MOST_OUTLIERS:g} % of such values"
            raise TrackError(what, where=track.source, expected=expected)
        tracks[topic] = replace(track, stamps_ns=track.stamps_ns[~repeated], values=track.values[~repeated])
        sentences.append(f"{track.source} {what}: these values are left out.")
    return replace(recording, tracks=tracks), tuple(sentences)


def find_repeated_values(recording: Recording, track: Track) -> BoolArray:
    """Return which values of a track (n,) are equal to the one before while the readings move."""
    values, repeated = track.values, np.zeros(len(track.values), dtype=bool)
    equal = np.concatenate([[False], np.all(values[1:] == values[:-1], axis=1)])
    whole = np.isfinite(values).all()
    features = _reading_features(recording)
    if not equal.any() or not whole or len(features) <= 2 * features.shape[1] + LEAST_SCANS:
        return repeated
    stamps = recording.scans.stamps_ns
    inside = (stamps >= track.stamps_ns[0]) & (stamps <= track.stamps_ns[-1]) & np.isfinite(features).all(axis=1)
    if np.count_nonzero(inside) < LEAST_SCANS:
        return repeated
    moving = features[inside]
    moving = moving[
        :, np.ptp(median_filter(moving, (FILTERED, 1), mode="nearest"), axis=0) > CLEAR_MOTION * _noise(moving)
    ]
    if not moving.shape[1]:
        return repeated
    smooth = median_filter(moving, (FILTERED, 1), mode="nearest")
    reference = np.column_stack([np.interp(stamps[inside], track.stamps_ns, column) for column in values.T])
    middle, spans = smooth.mean(axis=0), np.maximum(np.ptp(smooth, axis=0), np.finfo(float).tiny)
    scaled = (smooth - middle) / spans
    # Channels that move together determine only their common motion: their differences are noise.
    slopes = np.linalg.lstsq(scaled, reference - reference.mean(axis=0), rcond=TOGETHER)[0] / spans[:, None]
    followed = smooth @ slopes  # the reference as the readings follow it, up to a constant
    noise = _noise(moving @ slopes)
    steps = np.array([np.min(np.diff(np.unique(column)), initial=np.inf) for column in values.T])
    travel = np.ptp(followed, axis=0)
    least = np.maximum(STATED_SIGMAS * track.sigmas, MOTION_SHARE * travel)
    least = np.maximum(least, np.where(np.isfinite(steps), np.minimum(2.0 * steps, travel), np.inf))
    lit = recording.scans.lit_sources[inside]
    for begin, end in _runs(equal):
        which = slice(*np.searchsorted(stamps[inside], track.stamps_ns[[begin - 1, end - 1]] + [0, 1]))
        count = which.stop - which.start
        if count < LEAST_SCANS or np.any(lit[which] != lit[which.start]):
            continue
        trim = int(TRIMMED * count)
        parts = np.array_split(followed[which][trim : count - trim], BLOCKS)
        means = np.array([part.mean(axis=0) for part in parts])
        if np.any(np.ptp(means, axis=0) > np.maximum(least, MOTION_SIGMAS * noise / np.sqrt(len(parts[-1])))):
            repeated[begin:end] = True
    return repeated


def _noise(series: FloatArray) -> FloatArray:
    """Return the standard deviation of the noise of each column of a series (n, c) that moves slowly, (c,)."""
    return np.asarray(np.median(np.abs(np.diff(series, n=2, axis=0)), axis=0) / MAD_OF_SECOND_DIFFERENCES)


def _runs(which: BoolArray) -> Iterator[tuple[int, int]]:
    """Yield first and last index + 1 of each run of true elements."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], which, [False]])))
    yield from ((int(begin), int(end)) for begin, end in ends.reshape(-1, 2))


def _reading_features(recording: Recording) -> FloatArray:
    """Return what of the readings moves with the target: voltages and current ratios of all channels, (n, c)."""
    parts = []
    for kind in READING_KINDS:
        readings = getattr(recording.scans, kind)
        if kind == "diode_currents":
            with np.errstate(invalid="ignore", divide="ignore"):
                readings = current_ratios(readings)
        parts.append(readings.reshape(len(readings), -1))
    features = np.concatenate(parts, axis=1)
    return features[:, np.isfinite(features).mean(axis=0) > 1.0 - MOST_OUTLIERS]


def find_drifts(
    procedure: Procedure[Any], recording: Recording, calibration: Calibration, settings: Options, outcome: Outcome
) -> tuple[DriftTest, ...]:
    """Return the drift of each quantity of the references that the result depends on.

    ``outcome`` is that of the recording. Raises FitError: a reference drifts far beyond its stated uncertainty.
    """
    found = []
    for topic, track in recording.tracks.items():
        for index, (name, unit, sigma) in enumerate(_quantities(track)):
            if name not in procedure.drift_of:
                continue
            size = sigma or UNSTATED * float(np.ptp(track.values[:, index % track.values.shape[1]]))
            if not size:
                continue
            others = (_refit(procedure, recording, calibration, settings, (topic, index, k * size)) for k in SHIFTS)
            tests = (_compare(outcome, other, k * size, size) for k, other in zip(SHIFTS, others, strict=True) if other)
            # Where each second fit fails or leaves out other readings, no drift is shown.
            drift, drift_sigma, matters = next(filter(None, tests), (0.0, np.inf, True))
            if matters:
                found.append(DriftTest(topic, name, unit, drift, drift_sigma, sigma))
    for test in found:
        if test.is_refused:
            raise FitError(
                f"{test.topic} drifts against the readings by {test.text} during the recording",
                where=f"{procedure.name}, {recording.source}",
                expected=f"at most {LARGEST_DRIFT:g} standard uncertainties of {test.stated:.2g} {test.unit}",
            )
    return tuple(found)


def _refit(
    procedure: Procedure[Any],
    recording: Recording,
    calibration: Calibration,
    settings: Options,
    drift: tuple[str, int, float],
) -> Outcome | None:
    """Return the outcome with a drift (topic, index, size) of the reference; None: the fit fails."""
    topic, index, size = drift
    track = recording.tracks[topic]
    moved = replace(track, values=_with_drift(track, index, size))
    try:
        return procedure.identify(replace(recording, tracks={**recording.tracks, topic: moved}), calibration, settings)
    except PosorError:
        return None


def _quantities(track: Track) -> list[tuple[str, str, float]]:
    """Return name, unit and standard uncertainty of each quantity that may drift."""
    sigmas = track.sigmas.tolist()
    if len(sigmas) == POSE:
        turns = [(name, "rad", 2.0 * sigma) for name, sigma in zip(ANGLES, sigmas[3:], strict=False)]
        return [*((axis, "m", sigma) for axis, sigma in zip("xyz", sigmas, strict=False)), *turns]
    names = "xyz"[: len(sigmas)] if len(sigmas) > 1 else [""]
    return [(name, "m" if len(sigmas) > 1 else "(SI)", sigma) for name, sigma in zip(names, sigmas, strict=True)]


def _with_drift(track: Track, index: int, size: float) -> FloatArray:
    """Return the values of a track with a drift of one quantity, ``size`` over the time of the track."""
    share = (track.stamps_ns - track.stamps_ns[0]) / max(int(np.ptp(track.stamps_ns)), 1) - 0.5
    values = track.values.copy()
    if values.shape[1] != POSE or index < len("xyz"):
        values[:, index] += size * share
        return values
    turns = Rotation.from_rotvec(size * share[:, None] * np.eye(3)[index - len("xyz")])
    turned = (turns * Rotation.from_quat(values[:, 3:])).as_quat()
    values[:, 3:] = turned * np.sign(np.sum(turned * values[:, 3:], axis=1, keepdims=True))
    return values


def _compare(outcome: Outcome, other: Outcome, size: float, unit: float) -> tuple[float, float, bool] | None:
    """Return drift, its standard uncertainty, and whether one of ``unit`` matters, from a fit with a drift of ``size``.

    None: the second fit has other readings.
    """
    product = square = weight = 0.0
    matters, fits = False, 0
    for name, fit in outcome.fits.items():
        second = other.fits.get(name)
        if second is None or second.jacobian.shape != fit.jacobian.shape or second.names != fit.names:
            return None
        if np.any(np.abs(second.jacobian - fit.jacobian) > OTHER_READINGS * np.abs(fit.jacobian).max(axis=0)):
            return None
        change = np.sqrt(fit.weights) * (second.residuals - fit.residuals) / size
        matters |= bool(np.any(np.abs(second.values - fit.values) * unit > HARMLESS * fit.sigmas * size))
        own, own_square = float(change @ (np.sqrt(fit.weights) * fit.residuals)), float(change @ change)
        if own_square > 0.0:
            # Residuals beyond the stated uncertainties enlarge that of the drift, but for what the drift explains.
            remaining = (fit.spread**2 * fit.freedoms - own**2 / own_square) / max(fit.freedoms - 1, 1)
            weight += own_square * max(remaining, 1.0)
            product, square, fits = product + own, square + own_square, fits + 1
    if square == 0.0:
        return 0.0, np.inf, matters
    # Several fits share the errors of one reference: their residuals may be fully correlated.
    return product / square, float(np.sqrt(fits * weight)) / square, matters or bool(square * unit**2 > HARMLESS**2)
