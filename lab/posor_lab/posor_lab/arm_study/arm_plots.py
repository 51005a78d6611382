# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Interactive plots of a run of a simulated arm: errors along the path, each axis with its band, many arms."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.reporting.figure_style import BLUE, GREEN, GREY, LIGHT_BLUE, MICRON, ORANGE
from posor.reporting.plot import Plot

from posor_lab.accuracy.consistency import FREEDOMS, REGION_LIMIT
from posor_lab.arm_study.arm_record import rms

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

    from posor_lab.arm_study.arm_coverage import Coverage
    from posor_lab.arm_study.arm_record import ArmRecord

MOST_TICKS = 2000  # of a longer record the plots show every second, third... tick
BINS = 40
NEES_END = 24.0  # end of the histogram; 99.9 % of chi-square with 6 degrees of freedom lie below
ENLARGED_TO = 0.15  # share of the path's extent to which the largest error is enlarged
BAND_SIGMAS = 2.0
AXES = (("x", "µm"), ("y", "µm"), ("z", "µm"), ("about X", "µrad"), ("about Y", "µrad"), ("about Z", "µrad"))
POSORS, ENCODERS, TRUTH = "POSORs", "encoders alone", "truth"
TIME, DISTANCE = "time [s]", "distance from the truth [µm]"


def plot_path(record: ArmRecord) -> list[Plot]:
    """Return the distance from the truth against time and its distribution, and the path from above and the side."""
    shown = _shown(record)
    errors = Plot(f"Position error along the path{_every(record)}", TIME, DISTANCE, y_log=True)
    for name, vectors, colour in _position_errors(record):
        label = f"{name}, rms {rms(vectors) / MICRON:.3g} µm"
        errors.curve(label, record.times_s[shown], _lengths_um(vectors)[shown], colour)
    return [errors, _plot_distribution(record), *_plot_projections(record)]


def plot_axes(record: ArmRecord) -> list[Plot]:
    """Return the error of the POSORs' pose in each axis of the base, with the published band of 2 sigma."""
    shown, known = _shown(record), record.has_pose
    plots: list[Plot] = []
    for axis, (name, unit) in enumerate(AXES):
        error = record.posor_errors[:, axis] / MICRON
        sigma = np.sqrt(record.covariances[:, axis, axis]) / MICRON
        inside = 100.0 * float(np.mean(np.abs(error[known]) <= BAND_SIGMAS * sigma[known]))
        title = f"{name}: {inside:.1f} % of the poses in the band{_every(record)}"
        plot = Plot(title, TIME, f"POSORs minus truth, {name} [{unit}]", x_of=plots[0] if plots else None)
        time, width = record.times_s[shown], BAND_SIGMAS * sigma[shown]
        plot.band("published, 2 sigma", time, -width, width, LIGHT_BLUE)
        plot.zero()
        plot.curve("error", time, error[shown], BLUE, extra={f"published sigma [{unit}]": sigma[shown]})
        plots.append(plot)
    return plots


def plot_controller(before: ArmRecord, after: ArmRecord) -> Plot:
    """Return the distance of the true endpoint from its target, without and with a controller."""
    plot = Plot(f"True endpoint from its target{_every(before)}", TIME, "distance from the target [µm]", y_log=True)
    for record, name, colour in ((before, ENCODERS, ORANGE), (after, "POSORs and stage", GREEN)):
        # The same phases of the scenario's cycle, although the two records begin at different ticks.
        phase = np.mod(np.array(record.ticks) - before.ticks[0], len(before))
        order = np.argsort(phase)[_shown(record)]
        label = f"{name}, rms {rms(record.target_distances) / MICRON:.3g} µm"
        plot.curve(label, before.times_s[phase[order]], record.target_distances[order] / MICRON, colour)
    return plot


def plot_coverage(coverage: Coverage) -> list[Plot]:
    """Return the normalised errors of many arms, and the displacement that an uncorrected sag leaves."""
    from scipy.stats import chi2  # noqa: PLC0415  takes half a second to load

    edges = np.linspace(0.0, NEES_END, BINS + 1)
    counts, _ = np.histogram(coverage.normalised, edges)
    title = f"{coverage.arms} arms: {100.0 * coverage.inside.value:.1f} % of the poses in their 95 % region"
    errors = Plot(title, "normalised error squared", "density")
    errors.histogram("poses of all arms", edges, counts / len(coverage.normalised) / (edges[1] - edges[0]), BLUE)
    middles = 0.5 * (edges[:-1] + edges[1:])
    errors.curve(f"chi-square, {FREEDOMS} freedoms", middles, chi2.pdf(middles, FREEDOMS), GREY)
    errors.vertical(f"end of the 95 % region, {REGION_LIMIT:.2f}", REGION_LIMIT, ORANGE)
    title = f"Sag of the beams: found / predicted {coverage.shift_ratio.value:.3f}"
    sag = Plot(title, "pose of the path", "displacement of the endpoint [µm]")
    poses = np.arange(1, coverage.poses + 1)
    for name, shifts, colour, marker, size in (
        ("predicted by the beams file", coverage.shift_predicted_m, GREY, "square", 12),
        ("found, sag not corrected", coverage.shift_found_m, ORANGE, "diamond", 9),
    ):
        filled = marker == "diamond"
        sag.curve(name, poses, _lengths_um(shifts), colour, dash=None, marker=marker, size=size, filled=filled)
    rest = coverage.rms_m / MICRON
    sag.horizontal(f"error left when corrected, rms {rest:.1f} µm", rest, BLUE, "solid")
    return [errors, sag]


def _plot_distribution(record: ArmRecord) -> Plot:
    plot = Plot("Distribution of the position errors", DISTANCE, "share of the poses [%]", x_log=True)
    sizes = [(name, _lengths_um(vectors), colour) for name, vectors, colour in _position_errors(record)]
    known = [(name, size[np.isfinite(size) & (size > 0.0)], colour) for name, size, colour in sizes]
    every = np.concatenate([size for _, size, _ in known])
    edges = np.geomspace(every.min(), every.max() * 1.0001, BINS + 1)
    for name, size, colour in known:
        counts, _ = np.histogram(size, edges)
        plot.histogram(name, edges, 100.0 * counts / len(size), colour)
        plot.vertical(f"median {np.median(size):.3g} µm", float(np.median(size)), colour)
    return plot


def _plot_projections(record: ArmRecord) -> list[Plot]:
    truth, shown = record.truth.translations, _shown(record)
    extent = float(np.max(np.ptp(truth[np.isfinite(truth[:, 0])], axis=0)))
    largest = float(np.nanmax(np.linalg.norm(record.encoder_errors[:, :3], axis=1)))
    scale = _round_down(ENLARGED_TO * extent / largest) if extent > 0.0 and largest > 0.0 else 1.0
    curves = [*_position_errors(record), (TRUTH, np.zeros_like(truth), GREY)]
    plots: list[Plot] = []
    for axis, view, label in ((1, "above", "y [m]"), (2, "the side", "z [m]")):
        title = f"Path from {view}, errors enlarged {scale:g} times{_every(record)}"
        plot = Plot(title, "x [m]", label, x_of=plots[0] if plots else None)
        for (name, vectors, colour), dash in zip(curves, ("dashed", "solid", "dotted"), strict=True):
            points = (truth + scale * vectors)[shown]
            plot.curve(name, points[:, 0], points[:, axis], colour, dash=dash, extra={TIME: record.times_s[shown]})
        plots.append(plot)
    return plots


def _position_errors(record: ArmRecord) -> list[tuple[str, FloatArray, str]]:
    """Return the position errors [m], (n, 3), by encoders and by POSORs, with name and colour."""
    return [(ENCODERS, record.encoder_errors[:, :3], ORANGE), (POSORS, record.posor_errors[:, :3], BLUE)]


def _lengths_um(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors, axis=1) / MICRON)


def _round_down(value: float) -> float:
    """Return the next lower of 1, 2, 5, 10, 20..."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value))


def _shown(record: ArmRecord) -> slice:
    """Return which ticks of a record are drawn."""
    return slice(None, None, -(-len(record) // MOST_TICKS))


def _every(record: ArmRecord) -> str:
    """Return the end of a title that says which ticks are drawn; empty: all."""
    step = _shown(record).step
    return "" if step == 1 else f" (1 tick of {step})"
