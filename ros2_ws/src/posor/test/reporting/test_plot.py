# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Interactive plots: data for download, one library in the page, drawing in a browser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from markupsafe import Markup
from posor.reporting.figure_style import BLUE, LIGHT_BLUE, ORANGE
from posor.reporting.html_page import Section, render_page
from posor.reporting.plot import Plot
from posor_lab.harness.report_page import ReportPage

CHROMIUM = "/usr/bin/chromium"
TIME_S = np.linspace(0.0, 1.0, 50)
SIGMA = np.full(50, 0.5)


def plots() -> list[Plot]:
    error = Plot("Error: x/y", "time [s]", "error [µm]")
    error.band("2 sigma", TIME_S, -2.0 * SIGMA, 2.0 * SIGMA, LIGHT_BLUE)
    error.zero()
    error.curve("POSOR", TIME_S, np.where(TIME_S > 0.9, np.nan, np.sin(TIME_S)), BLUE, extra={"sigma [µm]": SIGMA})
    error.mark("estimated", TIME_S[3:4], np.sin(TIME_S[3:4]), BLUE)
    error.strips("no pose", [0.95], 0.05)
    linked = Plot("Sizes", "time [s]", "size [µm]", x_of=error, y_log=True)
    linked.curve("size, 1", TIME_S, 10.0**TIME_S, ORANGE, dash=None, marker="square", filled=False)
    linked.horizontal("mean", 3.0)
    budget = Plot("Budget", "uncertainty [µm]", "quantity", categories=("tip", "axis <1>"))
    budget.bars("noise", [2.0], ["tip"], ORANGE)
    budget.bars("calibration", [1.0], ["axis <1>"], BLUE)
    budget.intervals("range", [0.5, 0.5], [1.5, 2.5], ["tip", "axis <1>"], LIGHT_BLUE)
    budget.vertical("total", 2.24)
    spread = Plot("Histogram", "size [µm]", "share [%]", x_log=True)
    spread.histogram("poses", [1.0, 2.0, 4.0], [25.0, 75.0], BLUE)
    return [error, linked, budget, spread]


@pytest.fixture(scope="module")
def page() -> str:
    first, *others = plots()
    sections = (Section("One", Markup(), [first]), Section("Others", Markup(), others))
    return render_page("Plots", "Drawn.", holds=True, sections=sections)


def test_the_page_holds_one_library_and_all_data(page: str) -> None:
    assert 1_000_000 < len(page) < 2_000_000  # BokehJS, once, without its further parts
    read = ReportPage(page)
    assert read.problems == []
    data = read.data
    assert list(data) == ["Error_x_y.csv", "Sizes.csv", "Budget.csv", "Histogram.csv"]
    errors = data["Error_x_y.csv"]
    assert list(errors[0]) == ["series", "time [s]", "error [µm]", "sigma [µm]"]
    assert len(errors) == 50
    assert float(errors[10]["error [µm]"]) == pytest.approx(np.sin(TIME_S[10]), rel=1e-6)
    assert errors[-1]["error [µm]"] == ""  # NaN
    assert [row["series"] for row in data["Sizes.csv"]] == ["size, 1"] * 50
    assert data["Budget.csv"] == [
        {"series": "noise", "uncertainty [µm]": "2", "quantity": "tip"},
        {"series": "calibration", "uncertainty [µm]": "1", "quantity": "axis <1>"},
    ]
    assert [row["end of bin, size [µm]"] for row in data["Histogram.csv"]] == ["2", "4"]


def test_a_browser_draws_the_plots_without_a_network(page: str, tmp_path: Path, pytestconfig: pytest.Config) -> None:
    """The screenshot is kept in build/screenshots."""
    sync_api = pytest.importorskip("playwright.sync_api")
    file = tmp_path / "page.html"
    file.write_text(page, encoding="utf-8")
    complaints: list[str] = []
    addresses: list[str] = []
    with sync_api.sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        except sync_api.Error as error:
            if "doesn't exist" not in str(error):
                raise
            pytest.skip(f"chromium is not installed: there is no {CHROMIUM}")
        shown = browser.new_page(viewport={"width": 1280, "height": 1000})
        shown.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        shown.on("pageerror", lambda error: complaints.append(str(error)))
        shown.on("request", lambda request: addresses.append(request.url))
        shown.goto(file.as_uri())
        shown.wait_for_function("window.Bokeh && Bokeh.documents.length && Bokeh.documents.every(d => d.is_idle)")
        assert shown.locator("canvas").count() >= len(plots())
        frame = shown.locator(".bk-Figure").first.bounding_box()
        assert frame is not None
        tooltip = shown.locator(".bk-tooltip-content").first
        for share in np.linspace(0.1, 0.8, 71):  # until the pointer is over the curve
            shown.mouse.move(frame["x"] + 0.5 * frame["width"], frame["y"] + share * frame["height"])
            if tooltip.is_visible():
                break
        under_pointer = tooltip.inner_text()
        for text in ("POSOR", "time [s]", "error [µm]", "sigma [µm]", "0.5"):
            assert text in under_pointer
        with shown.expect_download() as download:
            shown.get_by_text("data (CSV)").first.click()
        assert download.value.suggested_filename == "Error_x_y.csv"
        kept = pytestconfig.rootpath / "build" / "screenshots" / "report_plots.png"
        shown.screenshot(path=kept, full_page=True)
        browser.close()
    assert complaints == []
    assert [address for address in addresses if not address.startswith(("data:", "blob:"))] == [file.as_uri()]
