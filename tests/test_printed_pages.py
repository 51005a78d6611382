# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Printed on paper, the page of a replay, of an error budget and of a statement are two sheets each."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from posor.calibration.calibration_file import load_calibration
from posor_bringup.statement_command import main as statement
from posor_design.budget_command import main as budget
from posor_lab.harness.browser import BROWSER, opened_browser
from posor_lab.harness.rig_files import calibration_path
from posor_lab.replay_1985.comparison import compare_with_thesis, reasons
from posor_lab.replay_1985.motion_test import offline_motion_test
from posor_lab.replay_1985.printed_results import (
    EXPECTED_ERRORS_FILE,
    PRINTED_FILES,
    read_predicted_errors,
    read_printed,
)
from posor_lab.replay_1985.replay_report import replay_page
from posor_lab.thesis_data import data_path

ROOT = Path(__file__).resolve().parents[1]
ELBOW = ROOT / "ros2_ws/src/posor_bringup/arms/five_axis/calibrations/elbow.yaml"
IS_DRAWN = "() => !window.Bokeh || Bokeh.documents.every(each => each.is_idle)"


def _replay(folder: Path) -> Path:
    test, printed = offline_motion_test("ymo", "printed"), read_printed(data_path(PRINTED_FILES["ymo"]))
    page = replay_page(
        "Replay",
        test=test,
        comparison=compare_with_thesis(test, "ymo", "printed", printed),
        printed=printed,
        predictions=read_predicted_errors(data_path(EXPECTED_ERRORS_FILE), "ymo"),
        reasons=reasons("ymo", "printed"),
        calibration=load_calibration(calibration_path("printed")),
        provenance={},
    )
    (folder / "report.html").write_text(page, encoding="utf-8")
    return folder / "report.html"


def _budget(folder: Path) -> Path:
    with pytest.MonkeyPatch.context() as few:  # draws, to save time
        for module in ("monte_carlo", "budget_command"):
            few.setattr(f"posor_design.{module}.BATCH", 500)
        assert budget([str(ELBOW), "--draws", "1000", "--output", str(folder)]) == 0
    return folder / "budget.html"


def _statement(folder: Path) -> Path:
    assert statement(["six_axis", "--grid", "2", "--output", str(folder)]) == 0
    return folder / "statement.html"


@pytest.mark.skipif(shutil.which(BROWSER) is None, reason=f"the program '{BROWSER}' is not installed")
@pytest.mark.parametrize("make_page", [_replay, _budget, _statement])
def test_a_page_is_printed_on_two_sheets(make_page: Callable[[Path], Path], tmp_path: Path) -> None:
    file = make_page(tmp_path)
    with opened_browser(1280, 1000) as page:
        page.goto(file.as_uri())
        page.wait_for_function(IS_DRAWN)
        sheets = re.findall(rb"/Type\s*/Page\b", page.pdf(prefer_css_page_size=True))
    assert len(sheets) == 2
