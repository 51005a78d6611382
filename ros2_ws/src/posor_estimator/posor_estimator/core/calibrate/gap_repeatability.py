"""Repeatability, hysteresis and drift of gap probes, from runs over the same stops (thesis 7.5.3; JCGM 100, H.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.fit import fit
from posor_estimator.core.calibrate.gap_reference import GapReferenceOptions, gap_data, gap_stops
from posor_estimator.core.calibrate.joining import NS
from posor_estimator.core.calibrate.one_probe import OneProbe
from posor_estimator.core.calibrate.procedure import Figure, Outcome, Procedure, Table
from posor_estimator.core.calibrate.replacement import Replacement
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.calibrate.gap_polynomial import GapData
    from posor_estimator.core.calibrate.joining import Stops
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray, IntArray

NAME = "gap_repeatability"
MICRO = 1e6
DRIFT, HYSTERESIS = "drift", "hysteresis"
RECTANGULAR = float(np.sqrt(12.0))
"""Width of a rectangular distribution over its standard deviation (JCGM 100, 4.3.7)."""


class GapRepeatabilityOptions(GapReferenceOptions):
    """Options of the repeatability of gap probes."""

    same: float = Field(
        default=5e-6, gt=0.0, description="stops whose reference differs by less are the same place, visited again [m]"
    )
    update_zero: bool = Field(
        default=False,
        description="take the drift over the recording for the standard uncertainty of each probe's zero shift, too",
    )


@dataclass(frozen=True)
class RepeatedProbe:
    """What repeated runs say of one probe.

    Attributes:
        probe: The probe.
        fit: Drift [m/s], hysteresis [m] (reading on the way up less that on the way down; absent where all stops are
            approached from the same side), and the deviation from the reference at each place [m].
        residuals: What is left of each stop [m], (d,).
        repeatability: Their standard deviation, with the degrees of freedom left [m].
        noise: Standard deviation of one scan: scatter within the stops, and what the stops scatter beyond it [V].
        noise_sigma: Its standard uncertainty [V].
        slope: Of the gap over the voltage, mean size [m/V].

    """

    probe: OneProbe
    fit: Fit
    residuals: FloatArray
    repeatability: float
    noise: float
    noise_sigma: float
    slope: float


def run(recording: Recording, calibration: Calibration, options: GapRepeatabilityOptions) -> Outcome:
    """Tell how well the gap probes repeat, and how they drift.

    Raises:
        FitError: Too few stops, a stuck channel, or no place that is visited twice.
        TrackError: The reference does not serve.

    """
    stops = gap_stops(recording, options, NAME)
    places = places_of(stops.reference, options.same)
    counts = np.bincount(places)
    if counts.max() < 2:  # noqa: PLR2004  twice
        raise FitError(
            f"each of the {len(counts)} places is visited once",
            where=recording.source,
            expected=f"runs over the same stops, {options.same:g} m being the same place by the option same",
        )
    duration = float(np.ptp(stops.scans.stamps_ns)) / NS
    probes = [
        repeated(probe, gap_data(probe, stops, calibration, options, recording.source), stops, places)
        for probe in OneProbe.all_of(calibration)
    ]
    return Outcome(
        method=f"{len(stops)} visits of {len(counts)} places, with drift and hysteresis fitted (thesis 7.5.3)",
        fits={one.probe.name: one.fit for one in probes},
        replacements=tuple(new for one in probes for new in _replacements(one, duration, options)),
        tables=(_table(probes, duration),),
        warnings=stops.warnings,
        figures=tuple(
            Figure(
                f"{one.probe.name}: repeatability",
                "time [s]",
                "deviation from the mean of its place [µm]",
                {"visits": ((stops.scans.stamps_ns - stops.scans.stamps_ns[0]) / NS, MICRO * one.residuals)},
            )
            for one in probes
        ),
    )


def places_of(reference: FloatArray, same: float) -> IntArray:
    """Return which place each stop is at, (d,): stops that are within ``same`` of the first at a place are there."""
    places: list[FloatArray] = []
    out = np.empty(len(reference), dtype=np.int64)
    for n, value in enumerate(reference):
        near = [i for i, place in enumerate(places) if np.max(np.abs(value - place)) < same]
        out[n] = near[0] if near else len(places)
        if not near:
            places.append(value)
    return out


def repeated(probe: OneProbe, data: GapData, stops: Stops, places: IntArray) -> RepeatedProbe:
    """Return what visits of the same places say of one probe."""
    deviations = probe.gaps(data.scans) - data.reference
    times = (data.scans.stamps_ns - data.scans.stamps_ns.mean()) / NS
    sides = np.sign(np.diff(data.reference, prepend=data.reference[0]))
    sides[0] = sides[1]
    columns, names, units = [times], [DRIFT], ["m/s"]
    if np.any([np.ptp(sides[places == place]) > 0.0 for place in np.unique(places)]):
        columns.append(0.5 * sides)
        names.append(HYSTERESIS)
        units.append("m")
    for place in np.unique(places):
        columns.append((places == place).astype(float))
        names.append(f"place {place + 1}")
        units.append("m")
    design = np.column_stack(columns)
    slopes = probe.slopes(data.scans)
    sigmas = np.hypot(data.reference_sigmas, slopes * data.volt_sigmas)
    scales = np.full(len(names), float(np.max(np.abs(deviations))) or MICRO**-1)
    scales[0] /= float(np.ptp(times))
    found = fit(
        lambda values: (design @ values - deviations) / sigmas,
        np.zeros(len(names)),
        names,
        units,
        scales,
        jacobian=lambda values: design / sigmas[:, None],  # noqa: ARG005  the same at all values
        trust_sigmas=False,
        what=f"{NAME} of {probe.name}",
    )
    residuals = deviations - design @ found.values
    variance = float(np.sum(np.square(residuals))) / found.freedoms
    slope = float(np.mean(slopes))
    within = float(stops.spreads["gap_voltages"][probe.index])
    if not np.isfinite(within):
        within = 0.0
    expected = within**2 * float(np.mean(1.0 / stops.counts))
    noise = float(np.sqrt(within**2 + max(variance / slope**2 - expected, 0.0)))
    return RepeatedProbe(
        probe,
        found,
        residuals,
        repeatability=float(np.sqrt(variance)),
        noise=noise,
        noise_sigma=noise / float(np.sqrt(2.0 * found.freedoms)),
        slope=slope,
    )


def _replacements(one: RepeatedProbe, duration: float, options: GapRepeatabilityOptions) -> list[Replacement]:
    found = [Replacement(f"{one.probe.key}.noise", one.noise, one.noise_sigma)]
    if options.update_zero:
        drifted = abs(one.fit.value(DRIFT)) * duration / RECTANGULAR
        sigma = float(np.hypot(drifted, one.fit.sigma(DRIFT) * duration / RECTANGULAR)) / one.slope
        found.append(Replacement(f"{one.probe.key}.zero_shift", one.probe.calibration.zero_shift.number, sigma))
    return found


def _table(probes: list[RepeatedProbe], duration: float) -> Table:
    rows = []
    for one in probes:
        has_sides = HYSTERESIS in one.fit.names
        rows.append(
            (
                one.probe.calibration.name,
                MICRO * one.repeatability,
                MICRO * duration * one.fit.value(DRIFT),
                MICRO * duration * one.fit.sigma(DRIFT),
                MICRO * one.fit.value(HYSTERESIS) if has_sides else float("nan"),
                MICRO * one.fit.sigma(HYSTERESIS) if has_sides else float("nan"),
                one.noise,
            )
        )
    return Table(
        f"repeatability, and drift over {duration:.4g} s",
        ("probe", "repeatability", "drift", "sigma", "hysteresis", "sigma", "noise of a scan"),
        ("", *("µm",) * 5, "V"),
        tuple(rows),
    )


PROCEDURE = Procedure(
    name=NAME,
    summary="repeatability, hysteresis and drift of the gap probes, from repeated runs over the same stops",
    options=GapRepeatabilityOptions,
    run=run,
)
