# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""An allotment as tables for the terminal and as a page with a plot."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from posor.reporting.figure_style import BLUE, GREY, ORANGE
from posor.reporting.html_page import Section, bullet_list, render_page
from posor.reporting.plot import Plot
from posor.reporting.report_table import ReportTable

from posor_design.data_file import read_data
from posor_design.posor_design_page import ring_text
from posor_design.quantity_text import format_quantity
from posor_design.reliability_report import AXES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_design.arm_allotment import Allotment
    from posor_design.layout_evaluation import Candidate


def allotment_tables(allotment: Allotment, layouts: Mapping[str, Candidate]) -> dict[str, ReportTable]:
    """Return the tables of parts, endpoint, and designed POSORs if there are any, by their headings on the page."""
    groups = zip(allotment.groups, allotment.allotted, allotment.present, allotment.shares, strict=True)
    parts = ReportTable(
        "Required standard uncertainties of joints and beams",
        ("part", "quantity", "required", "present", "present / required", "share of the variance"),
        [
            [
                f"{group.part}{' (beam)' if group.beam else ''}",
                group.what,
                *(format_quantity(value, group.unit, 3) for value in (sigma, present)),
                f"{present / sigma:.2f}",
                f"{100.0 * share:.0f} %",
            ]
            for group, sigma, present, share in groups
        ],
        "A ratio below 1: the part may be worse than it is.",
    )
    listed = [("required", allotment.required)]
    for posture, after, before in zip(allotment.postures, allotment.endpoint, allotment.before, strict=True):
        angles = ", ".join(f"{math.degrees(angle):.0f}" for angle in posture.values())
        listed += [(f"allotted, at {angles} degrees", after), ("at present, same posture", before)]
    units = ("m",) * 3 + ("rad",) * 3
    endpoint = ReportTable(
        "Standard uncertainty of the endpoint, axes of the base",
        ("posture", *AXES),
        [[name, *(format_quantity(*each, 3) for each in zip(values, units, strict=True))] for name, values in listed],
    )
    designed = ReportTable(
        "Designed POSORs (simulated)",
        ("joint", "layout", "outside diameter", "theta"),
        [
            [name, each.kind.name, format_quantity(each.layout.outside_diameter, "m", 3), ring_text(each.layout)]
            for name, each in layouts.items()
        ],
    )
    return {"Joints and beams": parts, "Endpoint": endpoint, **({"Designed POSORs": designed} if layouts else {})}


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
    plots = {"Joints and beams": [plot]}
    tables = allotment_tables(allotment, layouts)
    return render_page(
        f"Required uncertainties of the arm '{name}'",
        f"The allotment uses {100.0 * used:.1f} % of the requirement.",
        holds=True,
        sections=(
            *(table.section(heading, plots.get(heading, ())) for heading, table in tables.items()),
            Section("Notes", bullet_list(read_data("page_notes")["arm"])),
        ),
    )
