# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
from html import unescape

import pytest
from posor.reporting.html_page import Cell, Section, bullet_list, definition_list, paragraph, render_page, table
from posor_lab.harness.report_page import ReportPage


def test_page_is_well_formed_and_text_is_escaped() -> None:
    page = render_page(
        "a < b\nsecond line",
        "x & y hold.",
        holds=False,
        sections=(
            Section("Table <1>", table(("name", "<unit>"), [["a<b", Cell("no & no", "fails")]])),
            Section("Text", paragraph("p<q") + bullet_list(["i<j"]) + definition_list({"k<l": "m<n"})),
        ),
    )
    assert page.startswith("<!DOCTYPE html>")
    assert "<script" not in page  # without plots
    read = ReportPage(page)
    assert read.problems == []
    assert {"x & y hold.", "p<q"} <= set(read.texts)
    for text in (
        "<title>a &lt; b</title>",
        "<h1>a &lt; b<br>second line</h1>",
        '<p class="verdict fails">x &amp; y hold.</p>',
        "<h2>Table &lt;1&gt;</h2>",
        "<th>&lt;unit&gt;</th>",
        '<td>a&lt;b</td><td class="fails">no &amp; no</td>',
        "<p>p&lt;q</p><ul><li>i&lt;j</li></ul>",
        "<dt>k&lt;l</dt><dd>m&lt;n</dd>",
    ):
        assert text in page, text


@pytest.mark.parametrize(
    ("cells", "aligned"),
    [
        (("12.25", "-0.5", "100", ""), ("12.25", "-0.5_", "100,__", "")),
        (("± 7.67 µm", "± 19 µm"), ("± 7.67 µm", "± 19 µm,__")),
        (("< 0.1 %", "78.4 %", "∞"), ("< 0.1 %", "78.4 %", "∞")),
        (("1", "2"), ("1", "2")),
        (("1.5", "3 of 5"), None),
        (("1.5", "not detectable", "2 per µm"), ("1.5", "not detectable", "2 per µm,_")),
        (("1.5", "see below"), None),
        (("", ""), None),
    ],
)
def test_columns_of_numbers_are_flush_right_with_their_decimal_points_below_each_other(
    cells: tuple[str, ...], aligned: tuple[str, ...] | None
) -> None:
    page = table(("name", "figure"), [("a", cell) for cell in cells])
    found = re.findall(r'<td class="number">(.*?)</td>', unescape(page))
    assert ('<th class="number">figure</th>' in page) == (aligned is not None)
    assert tuple(text.replace("\u2007", "_").replace("\u2008", ",") for text in found) == (aligned or ())
