# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The result of ``posor design posor`` as tables for the terminal and as a page with plots."""

from __future__ import annotations

import math
from dataclasses import replace
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.design_parts import ring_azimuths
from posor.calibration.designs import SIZED_GAP_PROBE, STANDOFF
from posor.reporting.figure_style import BLUE, GREEN, GREY, LIGHT_BLUE, ORANGE
from posor.reporting.html_page import Section, bullet_list, definition_list, render_page
from posor.reporting.plot import Plot
from posor.reporting.report_table import ReportTable
from posor.uncertainty.budget_quantities import NATIVE

from posor_design.data_file import read_data
from posor_design.layout_geometry import DIODE_FRAME, PROBE_LENGTH, PROBE_RADIUS
from posor_design.layout_search import RESERVE, objectives
from posor_design.quantity_text import format_quantity
from posor_design.requirement import OPTIONS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from posor.numerics.array_types import FloatArray

    from posor_design.layout_evaluation import Candidate
    from posor_design.layout_search import SearchResult
    from posor_design.posor_layout import PosorLayout
    from posor_design.requirement import Requirement

COLOURS = {"light_ring": BLUE, "bumpy_ring": ORANGE, "diodes": GREEN}


def layout_tables(result: SearchResult, chosen: Candidate) -> tuple[ReportTable, ReportTable]:
    """Return the uncertainties of the chosen layout, with the coverage factor of the requirement, and the trade-off."""
    requirement = result.requirement
    factor = requirement.uncertainty.coverage_factor
    noise = np.sqrt(np.max(chosen.random, axis=0))
    freedoms = zip(NATIVE, requirement.sigmas, chosen.sigmas, noise, strict=True)
    uncertainties = ReportTable(
        f"Uncertainty in the whole range, coverage factor {factor:g}",
        ("freedom", "required", "layout", "of this by noise", "used"),
        [
            [
                name,
                *(format_quantity(factor * float(value), unit, 3) for value in (required, sigma, random)),
                f"{100.0 * sigma / required:.0f} %",
            ]
            for (name, unit), required, sigma, random in freedoms
        ],
        f"Uncertainties with coverage factor {factor:g}.",
    )
    header = ("layout", "diameter", "probe circle", "ring radius", "parts of the ring", "noise", "bits")
    trade_off = ReportTable(
        "Trade-off",
        (*header, "uncertainty used", "detectable fault"),
        [_trade_off_row(requirement, each) for each in result.trade_off],
    )
    return uncertainties, trade_off


def _trade_off_row(requirement: Requirement, candidate: Candidate) -> list[str]:
    layout = candidate.layout
    parts = "bumps, pitch" if layout.theta_sensor == "bumpy_ring" else "sources, half width"
    return [
        candidate.kind.name,
        *(_length(size) for size in (layout.outside_diameter, layout.probe_circle, layout.ring_radius)),
        f"{layout.marks} {parts} {_length(layout.ring_size)}",
        f"{layout.noise:g}",
        f"{layout.bits(requirement.scan_rate.number)}",
        f"{100.0 * objectives(requirement, candidate)['accuracy']:.0f} %",
        _fault(candidate),
    ]


def requirement_table(requirement: Requirement) -> ReportTable:
    """Return the requirement as its file states it, with the meaning of each entry."""
    rows = [
        [f"largest uncertainty of {name}", format_quantity(getattr(requirement.uncertainty, name).number, unit, 3)]
        for name, unit in NATIVE
    ]
    for option in OPTIONS.values():
        if option.entry:
            stated = attrgetter(option.entry)(requirement)
            text = "any" if stated is None else format_quantity(stated.number, option.unit, 3)
            rows.append([option.meaning.partition(";")[0], text])
    note = f"Uncertainties with coverage factor {requirement.uncertainty.coverage_factor:g}, anywhere in the range."
    return ReportTable("Requirement", ("quantity", "required"), rows, note)


def layout_terms(result: SearchResult, candidate: Candidate) -> dict[str, str]:
    """Return the chosen layout in words."""
    requirement = result.requirement
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
        "target plane": (
            f"machined with a tilt of {format_quantity(requirement.target_tilt.number, 'rad', 3)}, which shows "
            "exchanged plugs of gap probes"
        ),
        "theta": ring_text(layout),
        "electronics": (
            f"noise of a probe up to {format_quantity(volts, 'V', 3)} in one scan of ±6 V at {rate:g} Hz "
            f"({layout.noise:g} times the reference), converters of {layout.bits(rate)} bits"
        ),
        "detectable fault": _fault(candidate),
        "causes that no reading shows": ", ".join(result.unobservable(candidate)),
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


def verdict(result: SearchResult) -> str:
    """Return the number of layouts, and what the chosen one is best in, in two sentences."""
    counts = [len(result.unobservable(each)) for each in result.feasible]
    fewest = min(counts, default=0)
    return (
        f"{len(result.feasible)} layouts meet the requirement; {len(result.trade_off)} of them are not excelled by "
        f"another one in size, accuracy, detectability and noise at once ({result.evaluations} layouts evaluated). "
        f"{counts.count(fewest)} of them leave the fewest causes unobservable, {fewest}; these come first, and of "
        f"these the chosen one is best in {result.preference}."
    )


def render_posor_page(result: SearchResult, chosen: Candidate) -> str:
    """Return the page as HTML without external references."""
    requirement = result.requirement
    uncertainties, trade_off = layout_tables(result, chosen)
    notes = [note.format(reserve=100.0 * (1.0 - RESERVE)) for note in read_data("page_notes")["posor"]]
    layout = uncertainties.section("Chosen layout", [_plan_view(chosen.layout, requirement)])
    return render_page(
        f"POSOR for the requirement '{requirement.name}' (simulated)",
        verdict(result),
        holds=True,
        sections=(
            requirement_table(requirement).section("Requirement"),
            replace(layout, body=definition_list(layout_terms(result, chosen)) + layout.body),
            trade_off.section("Trade-off", _trade_off_plots(result, chosen)),
            Section("Notes", bullet_list(notes)),
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
    azimuths = np.array(ring_azimuths(layout.marks, layout.theta_probes))[:, None]
    x = radius * np.cos(azimuths) - across * np.sin(azimuths)
    y = radius * np.sin(azimuths) + across * np.cos(azimuths)
    return x.ravel(), y.ravel()


def _fault(candidate: Candidate) -> str:
    return _length(candidate.fault) if math.isfinite(candidate.fault) else "not all readings checked"


def _length(value: float) -> str:
    return format_quantity(value, "m", 3)
