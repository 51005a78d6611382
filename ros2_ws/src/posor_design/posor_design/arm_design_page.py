"""An allotment as tables for the terminal and as a page with a plot."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from posor.reporting.figure_style import BLUE, GREY, ORANGE
from posor.reporting.html_page import Section, bullet_list, paragraph, render_page, table
from posor.reporting.plot import Plot

from posor_design.arm_allotment import AXES
from posor_design.posor_design_page import ring_text
from posor_design.quantity_text import format_quantity

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_design.arm_allotment import Allotment
    from posor_design.layout_evaluation import Candidate

PARTS_HEADER = ("part", "quantity", "required", "present", "present / required", "share of the variance")
ENDPOINT_HEADER = ("posture", *AXES)
LAYOUT_HEADER = ("joint", "layout", "outside diameter", "theta")
NOTES = (
    "Standard uncertainties, k = 1, the same about or along all axes of a part.",
    (
        "Least effort: the sum of present over required uncertainty of all parts is the smallest that meets the "
        "requirement in every posture. Levers come from the endpoint budget of the chain."
    ),
    "Shares are of the endpoint's variance along or about the axis that uses most of its requirement.",
    "The temperature of the beams is a bound, not a variance: it is in the protection level (posor budget --arm).",
)


def part_rows(allotment: Allotment) -> list[list[str]]:
    """Return a row of ``PARTS_HEADER`` for each group."""
    return [
        [
            f"{group.part}{' (beam)' if group.beam else ''}",
            group.what,
            _text(sigma, group.unit),
            _text(present, group.unit),
            f"{present / sigma:.2f}",
            f"{100.0 * share:.0f} %",
        ]
        for group, sigma, present, share in zip(
            allotment.groups, allotment.allotted, allotment.present, allotment.shares, strict=True
        )
    ]


def endpoint_rows(allotment: Allotment) -> list[list[str]]:
    """Return a row of ``ENDPOINT_HEADER`` for the requirement and for each posture."""
    units = ("m",) * 3 + ("rad",) * 3
    listed = [("required", allotment.required)]
    for posture, after, before in zip(allotment.postures, allotment.endpoint, allotment.before, strict=True):
        angles = ", ".join(f"{math.degrees(angle):.0f}" for angle in posture.values())
        listed += [(f"allotted, at {angles} degrees", after), ("at present, same posture", before)]
    return [[name, *(_text(value, unit) for value, unit in zip(values, units, strict=True))] for name, values in listed]


def layout_rows(layouts: Mapping[str, Candidate]) -> list[list[str]]:
    """Return a row of ``LAYOUT_HEADER`` for each joint."""
    return [
        [name, each.kind.name, _text(each.layout.outside_diameter, "m"), ring_text(each.layout)]
        for name, each in layouts.items()
    ]


def render_arm_page(name: str, allotment: Allotment, layouts: Mapping[str, Candidate]) -> str:
    """Return the page as HTML without external references."""
    labels = [f"{group.part}, {group.what}" for group in allotment.groups]
    plot = Plot("Share of the endpoint's variance", "share [%]", "part", categories=labels)
    for label, beam, colour in (("POSORs", False, BLUE), ("beams", True, ORANGE)):
        chosen = [i for i, group in enumerate(allotment.groups) if group.beam == beam]
        if chosen:
            plot.bars(label, [100.0 * allotment.shares[i] for i in chosen], [labels[i] for i in chosen], colour)
    plot.vertical("equal shares", 100.0 / len(labels), GREY)
    used = float(np.max(allotment.endpoint / allotment.required))
    parts = table(PARTS_HEADER, part_rows(allotment)) + paragraph("A ratio below 1: the part may be worse than it is.")
    designed = [Section("Designed POSORs", table(LAYOUT_HEADER, layout_rows(layouts)))] if layouts else []
    return render_page(
        f"Required uncertainties of the arm '{name}'",
        f"The allotment uses {100.0 * used:.1f} % of the requirement.",
        holds=True,
        sections=(
            Section("Joints and beams", parts, [plot]),
            Section("Endpoint", table(ENDPOINT_HEADER, endpoint_rows(allotment))),
            *designed,
            Section("Notes", bullet_list(NOTES)),
        ),
    )


def _text(value: float, unit: str) -> str:
    return format_quantity(float(f"{value:.3g}"), unit)
