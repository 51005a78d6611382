from __future__ import annotations

from posor.reporting.html_page import Cell, Section, bullet_list, definition_list, paragraph, render_page, table
from posor_lab.harness.report_page import ReportPage


def test_page_is_well_formed_and_text_is_escaped() -> None:
    page = render_page(
        "a < b\nsecond line",
        "x & y hold.",
        holds=False,
        sections=(
            Section("Table <1>", table(("name", "<unit>"), [["a<b", Cell("no & no", "fails")]], "numbers")),
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
        '<table class="numbers">',
        "<th>&lt;unit&gt;</th>",
        '<td>a&lt;b</td><td class="fails">no &amp; no</td>',
        "<p>p&lt;q</p><ul><li>i&lt;j</li></ul>",
        "<dt>k&lt;l</dt><dd>m&lt;n</dd>",
    ):
        assert text in page, text
