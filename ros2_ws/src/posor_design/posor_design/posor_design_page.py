"""The result of ``posor design posor`` as tables for the terminal and as a page with plots."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.designs import SIZED_GAP_PROBE, STANDOFF
from posor.reporting.figure_style import BLUE, GREEN, GREY, LIGHT_BLUE, ORANGE
from posor.reporting.html_page import Section, bullet_list, definition_list, paragraph, render_page, table
from posor.reporting.plot import Plot
from posor.uncertainty.budget_quantities import NATIVE

from posor_design.layout_geometry import DIODE_FRAME, PROBE_LENGTH, PROBE_RADIUS
from posor_design.layout_search import RESERVE, objectives
from posor_design.quantity_text import format_quantity

if TYPE_CHECKING:
    from collections.abc import Iterable

    from posor.numerics.array_types import FloatArray

    from posor_design.layout_evaluation import Candidate
    from posor_design.layout_search import SearchResult
    from posor_design.posor_layout import PosorLayout
    from posor_design.requirement import Requirement

TRADE_OFF_HEADER = (
    "layout",
    "diameter",
    "probe circle",
    "ring radius",
    "parts of the ring",
    "noise",
    "bits",
    "uncertainty used",
    "detectable fault",
)
UNCERTAINTY_HEADER = ("freedom", "required", "layout", "of this by noise", "used")
UNCHECKED = "not all readings checked"
COLOURS = {"light_ring": BLUE, "bumpy_ring": ORANGE, "diodes": GREEN}
NOTES = (
    (
        "Simulated: uncertainties are those that the estimator states for simulated scans at corners of the required "
        "range and in its middle; the largest counts. The search keeps a reserve of "
        f"{100 * (1 - RESERVE):.0f} % of each uncertainty."
    ),
    "Detectable fault: the largest bias of a single reading that the test of one scan may miss (posor budget).",
    (
        "Assumed: all parts are calibrated as assembled, with the uncertainties of the sized designs; white noise, at "
        "1 kHz and noise 1 a share of 1 / 11 000 of a probe's range; bodies of probes of 8 mm by 12 mm; diodes with a "
        "frame of 1.5 mm."
    ),
    "Noise: of the electronics over this reference at the same scan rate. Bits: the fewest with steps below the noise.",
)


def uncertainty_rows(requirement: Requirement, candidate: Candidate) -> list[list[str]]:
    """Return a row of ``UNCERTAINTY_HEADER`` for each freedom; all with the coverage factor of the requirement."""
    factor = requirement.uncertainty.coverage_factor
    noise = np.sqrt(np.max(candidate.random, axis=0))
    return [
        [
            name,
            format_quantity(_digits(factor * required), unit),
            format_quantity(_digits(factor * sigma), unit),
            format_quantity(_digits(factor * random), unit),
            f"{100.0 * sigma / required:.0f} %",
        ]
        for (name, unit), required, sigma, random in zip(
            NATIVE, requirement.sigmas, candidate.sigmas, noise, strict=True
        )
    ]


def layout_terms(requirement: Requirement, candidate: Candidate) -> dict[str, str]:
    """Return the chosen layout in words."""
    layout, rate = candidate.layout, requirement.scan_rate.number
    volts = SIZED_GAP_PROBE.noise * layout.scan_noise(rate)
    azimuths = ", ".join(f"{math.degrees(azimuth) % 360.0:.0f}" for azimuth in layout.gap_azimuths)
    return {
        "layout": candidate.kind.name,
        "outside diameter": _length(layout.outside_diameter),
        "gap probes": (
            f"{len(layout.gap_azimuths)} on a circle of radius {_length(layout.probe_circle)}, at {azimuths} degrees; "
            f"gap {_length(layout.gap)} in the middle, {layout.probe_range:.3g} times the range of the sized designs"
        ),
        "theta": ring_text(layout),
        "electronics": (
            f"noise of a probe up to {format_quantity(_digits(volts), 'V')} in one scan of ±6 V at {rate:g} Hz "
            f"({layout.noise:g} times the reference), converters of {layout.bits(rate)} bits"
        ),
        "detectable fault": _length(candidate.fault) if math.isfinite(candidate.fault) else UNCHECKED,
    }


def ring_text(layout: PosorLayout) -> str:
    """Return the sensor for theta in words."""
    size, radius = _length(layout.ring_size), _length(layout.ring_radius)
    if layout.theta_sensor == "bumpy_ring":
        return (
            f"bumpy ring of radius {radius}, {layout.marks} bumps of pitch {size}, {layout.theta_probes} probes of "
            f"{layout.ring_range:.3g} times the range of the sized designs"
        )
    diodes = f"{layout.theta_probes} diodes of half width {size} on a circle of radius {radius}"
    if layout.theta_sensor == "diodes":
        return f"{diodes}, one fixed light source each"
    return f"{diodes}, {layout.marks} light sources of growing pitch (coded ring)"


def trade_off_rows(requirement: Requirement, candidates: Iterable[Candidate]) -> list[list[str]]:
    """Return a row of ``TRADE_OFF_HEADER`` for each candidate."""
    rows = []
    for each in candidates:
        layout = each.layout
        parts = {"bumpy_ring": "bumps, pitch", "light_ring": "sources, half width", "diodes": "sources, half width"}
        rows.append(
            [
                each.kind.name,
                _length(layout.outside_diameter),
                _length(layout.probe_circle),
                _length(layout.ring_radius),
                f"{layout.marks} {parts[layout.theta_sensor]} {_length(layout.ring_size)}",
                f"{layout.noise:g}",
                f"{layout.bits(requirement.scan_rate.number)}",
                f"{100.0 * objectives(requirement, each)['accuracy']:.0f} %",
                _length(each.fault) if math.isfinite(each.fault) else UNCHECKED,
            ]
        )
    return rows


def verdict(result: SearchResult) -> str:
    """Return the number of layouts, and what the chosen one is best in, in two sentences."""
    checked = sum(math.isfinite(each.fault) for each in result.feasible)
    return (
        f"{len(result.feasible)} layouts meet the requirement; {len(result.trade_off)} of them are not excelled by "
        f"another one in size, accuracy, detectability and noise at once ({result.evaluations} layouts evaluated). "
        + (
            f"In {checked} of them all readings are checked; these come first, and of these the chosen one is best in "
            f"{result.preference}."
            if checked
            else f"In none of them are all readings checked; the chosen one is best in {result.preference}."
        )
    )


def render_posor_page(result: SearchResult, chosen: Candidate) -> str:
    """Return the page as HTML without external references."""
    requirement = result.requirement
    return render_page(
        f"POSOR for the requirement '{requirement.name}' (simulated)",
        verdict(result),
        holds=True,
        sections=(
            Section(
                "Chosen layout",
                definition_list(layout_terms(requirement, chosen))
                + table(UNCERTAINTY_HEADER, uncertainty_rows(requirement, chosen))
                + paragraph(f"Uncertainties with coverage factor {requirement.uncertainty.coverage_factor:g}."),
                [_plan_view(chosen.layout, requirement)],
            ),
            Section(
                "Trade-off",
                table(TRADE_OFF_HEADER, trade_off_rows(requirement, result.trade_off)),
                _trade_off_plots(result, chosen),
            ),
            Section("Notes", bullet_list(NOTES)),
        ),
    )


def _trade_off_plots(result: SearchResult, chosen: Candidate) -> list[Plot]:
    """Return accuracy over size, and detectability over accuracy, with the chosen layout marked."""
    used, size, fault = "largest share of a required uncertainty [%]", "outside diameter [mm]", "detectable fault [um]"
    accuracy = Plot("Accuracy and size", size, used)
    detection = Plot("Detectability and accuracy", used, fault)
    own = {id(each): objectives(result.requirement, each) for each in (*result.trade_off, chosen)}
    for sensor, colour in COLOURS.items():
        listed = [each for each in result.trade_off if each.layout.theta_sensor == sensor]
        checked = [each for each in listed if math.isfinite(each.fault)]
        for plot, shown, x, y in (
            (accuracy, listed, ("size", 1e3), ("accuracy", 1e2)),
            (detection, checked, ("accuracy", 1e2), ("detectability", 1e6)),
        ):
            if shown:
                plot.curve(
                    sensor.replace("_", " "),
                    [x[1] * own[id(each)][x[0]] for each in shown],  # type: ignore[index]
                    [y[1] * own[id(each)][y[0]] for each in shown],  # type: ignore[index]
                    colour,
                    dash=None,
                    marker="circle",
                    extra={
                        "noise": [each.layout.noise for each in shown],
                        "layout": [each.kind.name for each in shown],
                    },
                )
    figures = own[id(chosen)]
    accuracy.mark("chosen", [1e3 * figures["size"]], [1e2 * figures["accuracy"]], GREY)
    if math.isfinite(chosen.fault):
        detection.mark("chosen", [1e2 * figures["accuracy"]], [1e6 * figures["detectability"]], GREY)
        return [accuracy, detection]
    return [accuracy]


def _plan_view(layout: PosorLayout, requirement: Requirement) -> Plot:
    """Return the layout seen along the axis [mm]."""
    plot = Plot("Plan view of the receiving plate", "x [mm]", "y [mm]")
    plot.figure.match_aspect = True
    plot.figure.frame_height = 420
    turn = np.linspace(0.0, 2.0 * math.pi, 181)

    def circles(name: str, radius: float, azimuths: Iterable[float], body: float, colour: str) -> None:
        x, y = [], []
        for azimuth in azimuths:
            x += [*(radius * math.cos(azimuth) + body * np.cos(turn[::2])), math.nan]
            y += [*(radius * math.sin(azimuth) + body * np.sin(turn[::2])), math.nan]
        plot.curve(name, 1e3 * np.array(x), 1e3 * np.array(y), colour)

    circles("outside diameter", 0.0, [0.0], 0.5 * layout.outside_diameter, GREY)
    if requirement.inside_diameter.number > 0.0:
        circles("inside diameter", 0.0, [0.0], 0.5 * requirement.inside_diameter.number, GREY)
    circles("gap probes", layout.probe_circle, layout.gap_azimuths, PROBE_RADIUS, BLUE)
    circles("ring", 0.0, [0.0], layout.ring_radius, LIGHT_BLUE)
    if layout.theta_sensor == "bumpy_ring":
        x, y = _ring_probes(layout)
        plot.curve("ring probes", 1e3 * x, 1e3 * y, ORANGE)
    else:
        circles(
            "diodes (circle around the corners)",
            layout.ring_radius,
            layout.diode_azimuths,
            math.sqrt(2.0) * (layout.ring_size + DIODE_FRAME),
            ORANGE,
        )
    return plot


def _ring_probes(layout: PosorLayout) -> tuple[FloatArray, FloatArray]:
    """Return the outlines of the ring probes [m], separated by NaN."""
    along = np.array([0.0, PROBE_LENGTH, PROBE_LENGTH, 0.0, 0.0, math.nan])
    across = PROBE_RADIUS * np.array([-1.0, -1.0, 1.0, 1.0, -1.0, math.nan])
    radius = layout.ring_radius + layout.ring_range * STANDOFF + along
    azimuths = 2.0 * math.pi * np.arange(layout.theta_probes)[:, None] / layout.theta_probes
    x = radius * np.cos(azimuths) - across * np.sin(azimuths)
    y = radius * np.sin(azimuths) + across * np.cos(azimuths)
    return x.ravel(), y.ravel()


def _digits(value: float) -> float:
    """Return the value with three digits."""
    return float(f"{value:.3g}")


def _length(value: float) -> str:
    return format_quantity(_digits(value), "m")
