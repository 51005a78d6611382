"""Picture of a run of a simulated arm: errors against time, path, histograms, NEES, sag, controller."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter
from posor.reporting.figure_style import BLUE, GREEN, GREY, MICRON, ORANGE, style_axes, to_png
from scipy.stats import chi2

from posor_lab.accuracy.consistency import FREEDOMS, REGION_LIMIT
from posor_lab.arm_study.arm_record import rms

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.axes import Axes
    from posor.numerics.array_types import FloatArray

    from posor_lab.arm_study.arm_coverage import Coverage
    from posor_lab.arm_study.arm_findings import ArmOutcome
    from posor_lab.arm_study.arm_record import ArmRecord

BINS = 40
NEES_END = 24.0
"""End of the histogram; 99.9 % of chi-square with 6 degrees of freedom lie below."""
ENLARGED_TO = 0.15
"""Share of the path's extent to which the largest error is enlarged."""
POSOR: dict[str, Any] = {"color": BLUE, "lw": 1.3}
ENCODERS: dict[str, Any] = {"color": ORANGE, "lw": 1.3, "ls": (0, (5, 2))}
PLAIN_TICKS = FuncFormatter(lambda value, _: f"{value:g}")


def draw_arm(outcome: ArmOutcome, title: str) -> bytes:
    """Return a picture (PNG) with a panel for each part of a run."""
    figure = Figure(layout=ConstrainedLayoutEngine(wspace=0.04, hspace=0.04))
    figure.suptitle(title, fontsize=15, fontweight="bold")
    panels = list(_panels(outcome))
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure.set_size_inches(5.2 * columns, 4.3 * rows + 0.5)
    grid = figure.add_gridspec(rows, columns)
    for index, (panel, data) in enumerate(panels):
        cell = grid[divmod(index, columns)]
        if panel is _draw_path:
            halves = cell.subgridspec(2, 1)
            top = figure.add_subplot(halves[0])
            _draw_path(top, figure.add_subplot(halves[1], sharex=top), *data)
        else:
            panel(figure.add_subplot(cell), *data)
    for axes in figure.axes:
        style_axes(axes)
    return to_png(figure)


def _panels(outcome: ArmOutcome) -> Iterator[tuple[Any, tuple[Any, ...]]]:
    if outcome.before is not None:
        yield _draw_errors, (outcome.before,)
        yield _draw_path, (outcome.before,)
        yield _draw_histogram, (outcome.before,)
        if outcome.after is not None:
            yield _draw_controller, (outcome.before, outcome.after)
    if outcome.coverage is not None:
        yield _draw_normalised, (outcome.coverage,)
        yield _draw_sag, (outcome.coverage,)


def lengths_um(vectors: FloatArray) -> FloatArray:
    """Return the lengths of vectors [m] in micrometres."""
    return np.asarray(np.linalg.norm(vectors, axis=1) / MICRON)


def _style_time_axis(axes: Axes, record: ArmRecord, label: str) -> None:
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(PLAIN_TICKS)
    axes.set_xlim(0.0, record.times_s[-1])
    axes.set_xlabel("time [s]")
    axes.set_ylabel(label)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * 4.0)  # space for the legend
    axes.legend(loc="upper right", fontsize=9, ncols=1, framealpha=0.9)


def _draw_errors(axes: Axes, record: ArmRecord) -> None:
    axes.set_title("Endpoint's position error along the path", fontsize=11)
    encoders, posor = record.encoder_errors[:, :3], record.posor_errors[:, :3]
    axes.plot(
        record.times_s, lengths_um(encoders), label=f"encoders alone, rms {rms(encoders) / MICRON:.0f} µm", **ENCODERS
    )
    axes.plot(record.times_s, lengths_um(posor), label=f"POSORs, rms {rms(posor) / MICRON:.1f} µm", **POSOR)
    _style_time_axis(axes, record, "distance from the truth [µm]")


def _draw_path(top: Axes, side: Axes, record: ArmRecord) -> None:
    truth = record.truth.translations
    known = np.isfinite(truth[:, 0])
    extent = float(np.max(np.ptp(truth[known], axis=0)))
    largest = float(np.nanmax(np.linalg.norm(record.encoder_errors[:, :3], axis=1)))
    scale = round_down(ENLARGED_TO * extent / largest) if extent > 0.0 and largest > 0.0 else 1.0
    top.set_title(f"Path of the endpoint, errors enlarged {scale:g} times", fontsize=11)
    for axes, axis, label in ((top, 1, "from above\ny [m]"), (side, 2, "from the side\nz [m]")):
        for error, style, name in (
            (record.encoder_errors, ENCODERS, "by encoders alone"),
            (record.posor_errors, POSOR, "by POSORs"),
        ):
            shown = truth + scale * error[:, :3]
            axes.plot(shown[:, 0], shown[:, axis], label=name, **style)
        axes.plot(truth[:, 0], truth[:, axis], color=GREY, lw=1.0, ls=":", label="truth")
        axes.plot(truth[known][0, 0], truth[known][0, axis], color=GREY, marker="o", ms=5, ls="none", label="start")
        axes.set_ylabel(label)
        axes.margins(0.08)
    side.set_xlabel("x [m]")
    top.legend(loc="lower left", fontsize=9, framealpha=0.9)


def round_down(value: float) -> float:
    """Return the next lower of 1, 2, 5, 10, 20..."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value))


def _draw_histogram(axes: Axes, record: ArmRecord) -> None:
    axes.set_title("Distribution of the errors", fontsize=11)
    sizes = {
        "encoders alone": (lengths_um(record.encoder_errors[:, :3]), ORANGE),
        "POSORs": (lengths_um(record.posor_errors[:, :3]), BLUE),
    }
    known = {name: (size[np.isfinite(size) & (size > 0.0)], color) for name, (size, color) in sizes.items()}
    every = np.concatenate([size for size, _ in known.values()])
    bins = np.geomspace(every.min(), every.max() * 1.0001, BINS + 1)
    for name, (size, color) in known.items():
        share = np.full(len(size), 100.0 / len(size))
        axes.hist(size, bins=bins.tolist(), weights=share, color=color, alpha=0.75, label=name)
        axes.axvline(np.median(size), color=color, lw=1.2, ls=":", label=f"median {np.median(size):.3g} µm")
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(PLAIN_TICKS)
    axes.set_xlabel("distance from the truth [µm]")
    axes.set_ylabel("share of the poses [%]")
    axes.legend(loc="center", bbox_to_anchor=(0.6, 0.6), fontsize=9, framealpha=0.9)


def _draw_controller(axes: Axes, before: ArmRecord, after: ArmRecord) -> None:
    axes.set_title("True endpoint from its target, with a controller", fontsize=11)
    for record, style, label in (
        (before, ENCODERS, "encoders alone"),
        (after, {**POSOR, "color": GREEN}, "POSORs and stage"),
    ):
        # The same phases of the scenario's cycle, although the two records begin at different ticks.
        phase = np.mod(np.array(record.ticks) - before.ticks[0], len(before))
        order = np.argsort(phase)
        axes.plot(
            before.times_s[phase[order]],
            record.target_distances[order] / MICRON,
            label=f"{label}, rms {rms(record.target_distances) / MICRON:.3g} µm",
            **style,
        )
    _style_time_axis(axes, before, "distance from the target [µm]")


def _draw_normalised(axes: Axes, coverage: Coverage) -> None:
    inside = coverage.inside
    axes.set_title(
        f"{coverage.arms} arms: {100.0 * inside.value:.1f} ± {100.0 * inside.sigma:.1f} % in their 95 % region",
        fontsize=11,
    )
    shown = coverage.normalised[coverage.normalised < NEES_END]
    share = np.full(len(shown), BINS / NEES_END / len(coverage.normalised))
    axes.hist(
        shown,
        bins=np.linspace(0.0, NEES_END, BINS + 1).tolist(),
        weights=share,
        color=BLUE,
        alpha=0.6,
        label="poses of all arms",
    )
    line = np.linspace(0.0, NEES_END, 400)
    axes.plot(line, chi2.pdf(line, FREEDOMS), color=GREY, lw=1.6, label=f"chi-square, {FREEDOMS} freedoms")
    axes.axvline(REGION_LIMIT, color=ORANGE, lw=1.4, ls="--", label=f"end of the 95 % region, {REGION_LIMIT:.2f}")
    axes.set_xlim(0.0, NEES_END)
    axes.set_xlabel(f"normalised error squared, mean {coverage.nees.value:.2f}")
    axes.set_ylabel("density")
    axes.legend(loc="upper right", fontsize=9, framealpha=0.9)


def _draw_sag(axes: Axes, coverage: Coverage) -> None:
    axes.set_title(f"Sag of the beams: found / predicted {coverage.shift_ratio.value:.3f}", fontsize=11)
    poses = np.arange(1, coverage.poses + 1)
    found, predicted = lengths_um(coverage.shift_found_m), lengths_um(coverage.shift_predicted_m)
    axes.bar(poses, predicted, width=0.62, color="#cccccc", label="predicted from the beams file")
    axes.plot(poses, found, color=ORANGE, marker="D", ms=6, ls="none", label="found, sag not corrected")
    axes.axhline(
        coverage.rms_m / MICRON,
        color=BLUE,
        lw=1.4,
        label=f"error left when corrected, rms {coverage.rms_m / MICRON:.1f} µm",
    )
    axes.set_ylim(0.0, 1.42 * max(found.max(), predicted.max()))
    axes.set_xticks(poses)
    axes.set_xlabel("pose of the path")
    axes.set_ylabel("mean displacement of the endpoint [µm]")
    axes.legend(loc="upper right", fontsize=9, framealpha=0.9)
