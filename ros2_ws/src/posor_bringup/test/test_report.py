"""The report's files: picture, page, table of steps."""

from __future__ import annotations

import base64
import csv
import io
from html.parser import HTMLParser
from typing import TYPE_CHECKING

import matplotlib.image
import numpy as np
import pytest
from posor_bringup.comparison import compare
from posor_bringup.drawing import BLUE, GREY, LIGHT_BLUE, ORANGE
from posor_bringup.figures import draw
from posor_bringup.installed import calibration_path, data_path
from posor_bringup.motion import DIODES_ESTIMATED
from posor_bringup.page import Report, page
from posor_bringup.provenance import notes
from posor_bringup.steps_file import COLUMNS, write_steps
from posor_bringup.thesis import EXPECTED_ERRORS_FILE, read_bands
from posor_estimator.core.calibration.load import load_calibration

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor_bringup.motion import MotionTest
    from posor_bringup.thesis import PrintedColumns


def pixels_of(picture: bytes, color: str, opacity: float = 1.0) -> int:
    """Return how many pixels have a colour, laid over white."""
    image = matplotlib.image.imread(io.BytesIO(picture), format="png")[..., :3]
    wanted = np.array([int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]) * opacity + 1.0 - opacity
    return int(np.sum(np.all(np.abs(image - wanted) < 0.02, axis=-1)))


def test_the_picture_shows_every_curve(printed_test: Callable[..., MotionTest], printed: PrintedColumns) -> None:
    bands = read_bands(data_path(EXPECTED_ERRORS_FILE), "ymo")
    picture = draw(printed_test(), "title", printed, bands)
    assert picture.startswith(b"\x89PNG\r\n\x1a\n")
    for color in (BLUE, ORANGE, GREY):
        assert pixels_of(picture, color) > 500, color
    assert pixels_of(picture, LIGHT_BLUE, 0.3) > 10_000
    bare = draw(printed_test(), "title", None, {})
    assert pixels_of(bare, ORANGE) == 0
    assert pixels_of(bare, LIGHT_BLUE, 0.3) < 100
    assert pixels_of(bare, BLUE) > 500


def test_the_picture_is_the_same_every_time(printed_test: Callable[..., MotionTest], printed: PrintedColumns) -> None:
    assert draw(printed_test(lost=(15,)), "title", printed, {}) == draw(printed_test(lost=(15,)), "title", printed, {})


class Page(HTMLParser):
    """Collects the text, the references, and what does not nest."""

    VOID = ("meta", "img", "br")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[str] = []
        self.references: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        self.references += [value or "" for name, value in attrs if name in {"src", "href"}]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.fixture
def report(printed_test: Callable[..., MotionTest], printed: PrintedColumns) -> Report:
    test = printed_test(statuses={14: DIODES_ESTIMATED}, lost=(15,))
    return Report(
        title="a title\nwith <two> lines",
        test=test,
        comparison=compare(test, "ymo", "printed", printed),
        picture=b"\x89PNG and so on",
        provenance={"bag": "ymo & more", "calibration hash": "abc123"},
        notes=notes("ymo", test, load_calibration(calibration_path("printed"))),
    )


def test_the_page_stands_alone(report: Report) -> None:
    read = Page(page(report))
    assert not read.open
    assert read.references == ["data:image/png;base64," + base64.b64encode(report.picture).decode()]
    assert "url(" not in page(report)
    assert "<script" not in page(report)


def test_the_page_tells_everything(report: Report) -> None:
    read = Page(page(report))
    for finding in report.comparison.findings:
        assert finding.what in read.texts
        assert finding.computed in read.texts
        assert finding.verdict.value in read.texts
    assert "The comparison does not hold." in read.texts
    assert {"ymo & more", "abc123", "lost:OUT_OF_RANGE", "ok:diodes_estimated"} <= set(read.texts)
    told = " ".join(read.texts)
    assert "tilt_angle: previous_scan." in told
    assert "In step 14 a reading of a diode has no legible digit" in told
    assert "33.4 in from the POSOR's origin" in told
    assert "with <two> lines" in told


def test_steps_are_written_as_promised(tmp_path: Path, printed_test: Callable[..., MotionTest]) -> None:
    path = tmp_path / "steps.csv"
    test = printed_test(lost=(15,), statuses={14: DIODES_ESTIMATED})
    write_steps(path, test)
    text = path.read_text(encoding="utf-8")
    assert text.splitlines()[0] == (
        "step,alpha_posor_urad,beta_posor_urad,theta_posor_urad,beta_meas_urad,theta_meas_urad,x_m,y_m,z_m,status"
    )
    rows = list(csv.DictReader(text.splitlines()))
    assert list(rows[0].values()) == ["1", *["0.000"] * 5, *["0.000000000"] * 3, "ok"]
    assert [float(rows[13][name]) for name in COLUMNS[1:6]] == pytest.approx([66.0, 3922.0, -229.0, 4034.0, -16.0])
    assert float(rows[13]["y_m"]) == pytest.approx(test.displacement[13, 1], abs=1e-9)
    assert rows[13]["status"] == "ok:diodes_estimated"
    assert [rows[14][name] for name in COLUMNS] == [
        "15",
        "",
        "",
        "",
        "4318.000",
        "-13.000",
        "",
        "",
        "",
        "lost:OUT_OF_RANGE",
    ]
