# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Repeatability, hysteresis and drift of gap probes, from runs over the same places (thesis 7.5.3; JCGM 100, H.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import FitError
from posor.numerics.stamps import NS
from pydantic import Field

from posor_calibration.gap_probe_data import MICRO, GapReferenceOptions, SingleProbe, read_gap_data
from posor_calibration.least_squares import Fit, fit_linear
from posor_calibration.procedure import Figure, Outcome, Procedure, Replacement, Table

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray, IntArray

    from posor_calibration.dwells import DwellMeans
    from posor_calibration.gap_probe_data import GapData

NAME = "gap_repeatability"
DRIFT, HYSTERESIS = "drift", "hysteresis"
RECTANGULAR = float(np.sqrt(12.0))  # width of a rectangular distribution over its standard deviation (JCGM 100, 4.3.7)


class GapRepeatabilityOptions(GapReferenceOptions):
    """Options of ``gap_repeatability``."""

    same: float = Field(
        default=5e-6, gt=0.0, description="dwells whose reference differs by less are visits of the same place [m]"
    )
    update_zero: bool = Field(
        default=False,
        description="also replace the standard uncertainty of each probe's zero shift by the drift over the recording",
    )


@dataclass(frozen=True)
class RepeatedProbe:
    """Result for one probe."""

    probe: SingleProbe
    fit: Fit
    """Drift [m/s], hysteresis [m] (reading on the way up less that on the way down; absent where all places are
    approached from the same side), and the deviation from the reference at each place [m]."""
    residuals: FloatArray  # of each dwell [m], (d,)
    repeatability: float  # their standard deviation with the degrees of freedom left [m]
    noise: float  # standard deviation of one scan: within the dwells, and between them [V]
    noise_sigma: float  # its standard uncertainty [V]
    slope: float  # mean absolute slope of the gap over the voltage [m/V]


def measure_repeatability(recording: Recording, calibration: Calibration, options: GapRepeatabilityOptions) -> Outcome:
    """Find repeatability, hysteresis and drift of all gap probes; raises as ``Procedure.identify``."""
    means, probes = read_gap_data(recording, calibration, options, NAME)
    places = group_places(means.reference, options.same, "m", recording.source)
    seconds = (means.scans.stamps_ns - means.scans.stamps_ns[0]) / NS
    duration = float(seconds[-1])
    results = [_fit_probe(probe, data, means, places) for probe, data in probes]
    return Outcome(
        method=f"{len(means)} visits of {places.max() + 1} places, with drift and hysteresis fitted (thesis 7.5.3)",
        fits={result.probe.name: result.fit for result in results},
        replacements=tuple(r for result in results for r in _replacements(result, duration, options)),
        tables=(_tabulate(results, duration),),
        warnings=means.warnings,
        figures=tuple(
            Figure(
                f"{result.probe.name}: repeatability",
                "time [s]",
                "deviation from the mean of its place [µm]",
                {"visits": (seconds, MICRO * result.residuals)},
            )
            for result in results
        ),
    )


def group_places(reference: FloatArray, same: float, unit: str, source: str) -> IntArray:
    """Return the place of each dwell, (d,): the place of the first dwell that is nearer than ``same``.

    Raises FitError: no place is visited again; ``source``: the recording.
    """
    places: list[FloatArray] = []
    out = np.empty(len(reference), dtype=np.int64)
    for n, value in enumerate(reference):
        near = [i for i, place in enumerate(places) if np.max(np.abs(value - place)) < same]
        out[n] = near[0] if near else len(places)
        if not near:
            places.append(value)
    if len(places) == len(out):
        expected = f"repeated visits of places within {same:g} {unit} (option same)"
        raise FitError(f"each of the {len(out)} places is visited once", where=source, expected=expected)
    return out


def fit_visits(
    values: FloatArray, sigmas: FloatArray, times: FloatArray, places: IntArray, sides: FloatArray, unit: str, what: str
) -> tuple[Fit, FloatArray]:
    """Return the fit of a drift, a hysteresis and the value at each place to visits (d,), and what is left.

    ``times``: about their mean [s]. ``sides``: from which a place is approached, 1 or -1, (d,); without places that are
    approached from both there is no hysteresis.
    """
    columns, names, units = [times], [DRIFT], [f"{unit}/s"]
    if any(np.ptp(sides[places == place]) > 0.0 for place in np.unique(places)):
        columns.append(0.5 * sides)
        names.append(HYSTERESIS)
        units.append(unit)
    for place in np.unique(places):
        columns.append((places == place).astype(float))
        names.append(f"place {place + 1}")
        units.append(unit)
    design = np.column_stack(columns)
    scales = np.full(len(names), float(np.max(np.abs(values))) or 1.0 / MICRO)
    scales[0] /= float(np.ptp(times))
    start = np.zeros(len(names))
    found = fit_linear(design, values, sigmas, start, names, units, scales, trust_sigmas=False, what=what)
    return found, values - design @ found.values


def _fit_probe(probe: SingleProbe, data: GapData, means: DwellMeans, places: IntArray) -> RepeatedProbe:
    deviations = probe.gaps(data.scans) - data.reference
    times = (data.scans.stamps_ns - data.scans.stamps_ns.mean()) / NS
    sides = np.sign(np.diff(data.reference, prepend=data.reference[0]))
    sides[0] = sides[1]
    slopes = probe.slopes(data.scans)
    sigmas = np.hypot(data.reference_sigmas, slopes * data.volt_sigmas)
    found, residuals = fit_visits(deviations, sigmas, times, places, sides, "m", f"{NAME} of {probe.name}")
    variance = float(np.sum(np.square(residuals))) / found.freedoms
    slope = float(np.mean(slopes))
    within = float(np.nan_to_num(means.deviations["gap_voltages"][probe.index]))
    expected = within**2 * float(np.mean(1.0 / means.counts))
    noise = float(np.sqrt(within**2 + max(variance / slope**2 - expected, 0.0)))
    noise_sigma = noise / float(np.sqrt(2.0 * found.freedoms))
    return RepeatedProbe(probe, found, residuals, float(np.sqrt(variance)), noise, noise_sigma, slope)


def _replacements(result: RepeatedProbe, duration: float, options: GapRepeatabilityOptions) -> list[Replacement]:
    found = [Replacement(f"{result.probe.key}.noise", result.noise, result.noise_sigma)]
    if options.update_zero:
        drift = abs(result.fit.value(DRIFT)) * duration / RECTANGULAR
        sigma = float(np.hypot(drift, result.fit.sigma(DRIFT) * duration / RECTANGULAR)) / result.slope
        zero_shift = result.probe.calibration.zero_shift.number
        found.append(Replacement(f"{result.probe.key}.zero_shift", zero_shift, sigma))
    return found


def _tabulate(results: list[RepeatedProbe], duration: float) -> Table:
    rows = []
    for result in results:
        has_sides = HYSTERESIS in result.fit.names
        rows.append(
            (
                result.probe.calibration.name,
                MICRO * result.repeatability,
                MICRO * duration * result.fit.value(DRIFT),
                MICRO * duration * result.fit.sigma(DRIFT),
                MICRO * result.fit.value(HYSTERESIS) if has_sides else float("nan"),
                MICRO * result.fit.sigma(HYSTERESIS) if has_sides else float("nan"),
                result.noise,
            )
        )
    return Table(
        f"repeatability, and drift over {duration:.4g} s",
        ("probe", "repeatability", "drift", "sigma", "hysteresis", "sigma", "noise of a scan"),
        ("", *("µm",) * 5, "V"),
        tuple(rows),
    )


PROCEDURE = Procedure(
    NAME,
    "repeatability, hysteresis and drift of the gap probes, from repeated runs over the same places",
    GapRepeatabilityOptions,
    measure_repeatability,
)
