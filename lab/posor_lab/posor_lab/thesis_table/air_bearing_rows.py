"""Rows and plots of the thesis table for aerostatic bearings: 6.2.3.6 (AIR.FOR) and their load in 7.3."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from posor.reporting.figure_style import BLUE, GREEN, GREY, LIGHT_BLUE, ORANGE
from posor.reporting.plot import Plot
from posor_design.air_bearing import aerostatic_bearing
from scipy.constants import inch, lbf

from posor_lab.thesis_table.thesis_row import ThesisRow

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_design.air_bearing import AirBearing

AIR: dict[str, Any] = {
    "diameter": 2.0 * 25.4e-3,
    "orifices": 8,
    "supply_pressure": 551584.0,
    "ambient_pressure": 101353.6,
    "viscosity": 1.853e-5,
    "density": 1.183,
}
"""Input of AIR.FOR; 80 psi above ambient is used as absolute pressure there."""
WIDE_ORIFICE, NARROW_ORIFICE = 0.030 * inch, 0.015 * inch
DISCHARGE_COEFFICIENTS = (0.4, 0.5, 0.6, 0.7, 0.8)
ASPECTS = (0.5, 1.0, 1.5, 2.0, 2.5)
"""Length over diameter."""
ECCENTRICITY_RATIOS = 1.0 - 1.0 / np.arange(1, 21)
"""Loop of AIR.FOR."""
_COLOURS = (BLUE, ORANGE, GREEN, LIGHT_BLUE, GREY)
_DASHES = ("solid", "dashed", "dotted", "dotdash", "dashdot")


def air_bearing(
    clearance: float,
    aspect: float,
    *,
    orifice_radius: float = WIDE_ORIFICE,
    discharge_coefficient: float = 0.6,
    method: Literal["nozzle", "thesis"] = "thesis",
    eccentricity_ratio: float = 0.5,
) -> AirBearing:
    """Return a bearing with the input of AIR.FOR."""
    return aerostatic_bearing(
        length=aspect * AIR["diameter"],
        clearance=clearance,
        orifice_radius=orifice_radius,
        discharge_coefficient=discharge_coefficient,
        eccentricity_ratio=eccentricity_ratio,
        method=method,
        **AIR,
    )


def direction(bearings: Sequence[AirBearing]) -> float:
    """Return 1 if the load rises from each bearing to the next, -1 if it falls, 0 if it does both."""
    signs = set(np.sign(np.diff([bearing.load for bearing in bearings])))
    return float(signs.pop()) if len(signs) == 1 else 0.0


def rows() -> list[ThesisRow]:
    """Return the rows of 6.2.3.6, and those of 7.3 on the aerostatic bearing."""
    clearance, gap, force = 0.002 * inch, 0.0015 * inch, 100.0
    ratio = 1.0 - gap / clearance
    load = air_bearing(clearance, 1.0, eccentricity_ratio=ratio).load
    nozzle = air_bearing(clearance, 1.0, eccentricity_ratio=ratio, method="nozzle").load
    closed_gap = clearance - force / air_bearing(clearance, 2.0).stiffness
    printed_load = air_bearing(clearance, 2.0).stiffness * (clearance - 0.0017 * inch)
    measured_clearance = 0.0025 * inch
    sweep = {
        radius: [
            air_bearing(clearance, 1.0, orifice_radius=radius, discharge_coefficient=coefficient)
            for coefficient in DISCHARGE_COEFFICIENTS
        ]
        for radius in (WIDE_ORIFICE, NARROW_ORIFICE)
    }
    best = max(ASPECTS, key=lambda aspect: air_bearing(clearance, aspect).load)
    wider = [air_bearing(size, 1.0) for size in (clearance, 0.004 * inch)]
    prefix = "direction of the load (1: rises, -1: falls), "
    section = "6.2.3.6"
    return [
        ThesisRow(
            section,
            "load at a gap of .0015 in, clearance .002 in, L/D 1",
            "N",
            "100",
            load,
            "equations 6.18 to 6.21 as AIR.FOR has them (number of orifices once in 6.18, lambda before sinh) at an "
            f"eccentricity of .0005 in; with nozzles that keep the continuity of the flow: {nozzle:.0f} N",
        ),
        ThesisRow(
            section,
            f"{prefix}orifices of .030 in, Cd .4 to .8 (figure 6.12)",
            "1",
            "-1",
            direction(sweep[WIDE_ORIFICE]),
        ),
        ThesisRow(
            section,
            f"{prefix}orifices of .015 in, Cd .4 to .8 (figure 6.13)",
            "1",
            "1",
            direction(sweep[NARROW_ORIFICE]),
        ),
        ThesisRow(
            section,
            f"{prefix}clearance .001 in, L/D .5 to 2.5 (figure 6.14)",
            "1",
            "-1",
            direction([air_bearing(0.001 * inch, aspect) for aspect in ASPECTS]),
        ),
        ThesisRow(section, "L/D of the greatest load, clearance .002 in (figure 6.15)", "1", "1.5", best),
        ThesisRow(
            section,
            f"{prefix}clearance .002 to .004 in at L/D 1 (figures 6.15 and 6.16)",
            "1",
            "-1",
            direction(wider),
        ),
        ThesisRow(
            "7.3",
            "gap at 100 N, clearance .002 in, L/D 2 (figure 6.15)",
            "in",
            ".0017",
            closed_gap / inch,
            f"read from a figure in print; AIR.FOR's equations give {printed_load:.0f} N at .0017 in",
        ),
        ThesisRow(
            "7.3",
            "greatest load without dragging, clearance .0025 in, L/D 2",
            "lbf",
            "25",
            air_bearing(measured_clearance, 2.0).stiffness * measured_clearance / lbf,
            "measured 20 to 25 lbf, while the model's load closes the whole clearance: a high spot or the limits of "
            "the model, as the text says; the load is linear in the eccentricity, which overestimates it",
        ),
    ]


def plots() -> list[Plot]:
    """Return figures 6.12 to 6.16, and the models of the orifices."""
    return [
        _discharge_plot("6.12", WIDE_ORIFICE),
        _discharge_plot("6.13", NARROW_ORIFICE),
        *(_aspect_plot(*figure) for figure in (("6.14", 0.001), ("6.15", 0.002), ("6.16", 0.004))),
        _method_plot(),
    ]


def _load_plot(title: str) -> Plot:
    return Plot(title, "gap [in]", "load [N]")


def _load_curve(plot: Plot, name: str, clearance: float, style: int, **arguments: Any) -> None:
    loads = [air_bearing(clearance, **arguments, eccentricity_ratio=ratio).load for ratio in ECCENTRICITY_RATIOS]
    gaps = clearance / inch * (1.0 - ECCENTRICITY_RATIOS)
    plot.curve(name, gaps, loads, _COLOURS[style], dash=_DASHES[style], marker="circle", size=4.0)


def _discharge_plot(number: str, orifice_radius: float) -> Plot:
    plot = _load_plot(f"Figure {number}: load, orifices of {orifice_radius / inch:.3f} in, clearance .002 in, L/D 1")
    for style, value in enumerate(DISCHARGE_COEFFICIENTS):
        arguments = {"aspect": 1.0, "orifice_radius": orifice_radius, "discharge_coefficient": value}
        _load_curve(plot, f"Cd {value}", 0.002 * inch, style, **arguments)
    return plot


def _aspect_plot(number: str, clearance_inches: float) -> Plot:
    """Return the load over the gap for a clearance in inch."""
    plot = _load_plot(f"Figure {number}: load, clearance {clearance_inches:.3f} in, orifices of .030 in, Cd .6")
    for style, aspect in enumerate(ASPECTS):
        _load_curve(plot, f"L/D {aspect}", clearance_inches * inch, style, aspect=aspect)
    return plot


def _method_plot() -> Plot:
    plot = _load_plot("Models of the orifices: load, clearance .002 in, L/D 1, Cd .6")
    _load_curve(plot, "AIR.FOR", 0.002 * inch, 0, aspect=1.0)
    _load_curve(plot, "nozzles", 0.002 * inch, 1, aspect=1.0, method="nozzle")
    return plot
