"""Picture and page of a replay."""

from __future__ import annotations

import base64
import io
from html.parser import HTMLParser
from typing import TYPE_CHECKING

import matplotlib.image
import numpy as np
from posor_bringup.installed import calibration_path
from posor_estimator.calibration.calibration_file import load_calibration
from posor_estimator.reporting.figure_style import BLUE, GREY, LIGHT_BLUE, ORANGE
from posor_validation.replay_1985.comparison import compare_with_thesis
from posor_validation.replay_1985.motion_figures import draw_motion_test
from posor_validation.replay_1985.motion_test import DIODES_ESTIMATED
from posor_validation.replay_1985.printed_results import EXPECTED_ERRORS_FILE, read_predicted_errors
from posor_validation.replay_1985.replay_report import replay_notes, replay_page
from posor_validation.thesis_data import data_path

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_validation.replay_1985.motion_test import MotionTest
    from posor_validation.replay_1985.printed_results import PrintedColumns


def pixels_of(picture: bytes, color: str, opacity: float = 1.0) -> int:
    """Return how many pixels have a colour, laid over white."""
    image = matplotlib.image.imread(io.BytesIO(picture), format="png")[..., :3]
    wanted = np.array([int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]) * opacity + 1.0 - opacity
    return int(np.sum(np.all(np.abs(image - wanted) < 0.02, axis=-1)))


def test_the_picture_shows_every_curve(printed_test: Callable[..., MotionTest], printed: PrintedColumns) -> None:
    predictions = read_predicted_errors(data_path(EXPECTED_ERRORS_FILE), "ymo")
    picture = draw_motion_test(printed_test(), "title", printed, predictions)
    assert picture.startswith(b"\x89PNG\r\n\x1a\n")
    for color in (BLUE, ORANGE, GREY):
        assert pixels_of(picture, color) > 500, color
    assert pixels_of(picture, LIGHT_BLUE, 0.3) > 10_000
    bare = draw_motion_test(printed_test(), "title", None, {})
    assert pixels_of(bare, ORANGE) == 0
    assert pixels_of(bare, LIGHT_BLUE, 0.3) < 100
    assert pixels_of(bare, BLUE) > 500


def test_the_picture_is_the_same_every_time(printed_test: Callable[..., MotionTest], printed: PrintedColumns) -> None:
    assert draw_motion_test(printed_test(lost=(15,)), "title", printed, {}) == draw_motion_test(
        printed_test(lost=(15,)), "title", printed, {}
    )


class PageReader(HTMLParser):
    """Collects texts and references of a page, and checks that its tags nest."""

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


def test_the_page_is_complete_and_self_contained(
    printed_test: Callable[..., MotionTest], printed: PrintedColumns
) -> None:
    test = printed_test(statuses={14: DIODES_ESTIMATED}, lost=(15,))
    comparison = compare_with_thesis(test, "ymo", "printed", printed)
    picture = b"\x89PNG and so on"
    page = replay_page(
        "a title\nwith <two> lines",
        test=test,
        comparison=comparison,
        picture=picture,
        notes=replay_notes("ymo", test, load_calibration(calibration_path("printed"))),
        provenance={"bag": "ymo & more", "calibration hash": "abc123"},
    )
    reader = PageReader(page)
    assert not reader.open
    assert reader.references == ["data:image/png;base64," + base64.b64encode(picture).decode()]
    assert "url(" not in page
    assert "<script" not in page
    for finding in comparison.findings:
        assert {finding.quantity, finding.computed, finding.verdict.value} <= set(reader.texts)
    assert "The comparison does not hold." in reader.texts
    assert {"ymo & more", "abc123", "lost:OUT_OF_RANGE", "ok:diodes_estimated"} <= set(reader.texts)
    text = " ".join(reader.texts)
    assert "tilt_angle: previous_scan." in text
    assert "In step 14 a reading of a diode has no legible digit" in text
    assert "33.4 in from the POSOR's origin" in text
    assert "with <two> lines" in text
