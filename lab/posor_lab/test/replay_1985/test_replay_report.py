# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Page of a replay."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from posor.calibration.calibration_file import load_calibration
from posor.model.scan import DIODES_ESTIMATED
from posor_lab.harness.report_page import ReportPage
from posor_lab.harness.rig_files import calibration_path
from posor_lab.replay_1985.comparison import compare_with_thesis
from posor_lab.replay_1985.motion_test import MotionTest
from posor_lab.replay_1985.printed_results import EXPECTED_ERRORS_FILE, PrintedColumns, read_predicted_errors
from posor_lab.replay_1985.replay_report import replay_page
from posor_lab.thesis_data import data_path


def test_the_page_is_complete_and_self_contained(
    printed_test: Callable[..., MotionTest], printed: PrintedColumns
) -> None:
    test = printed_test(statuses={14: DIODES_ESTIMATED}, lost=(15,))
    comparison = compare_with_thesis(test, "ymo", "printed", printed)
    page = replay_page(
        "a title\nwith <two> lines",
        test=test,
        comparison=comparison,
        printed=printed,
        predictions=read_predicted_errors(data_path(EXPECTED_ERRORS_FILE), "ymo"),
        reasons={"alpha": "zero shifts are not compensated"},
        calibration=load_calibration(calibration_path("printed")),
        provenance={"bag": "ymo & more", "calibration hash": "abc123"},
    )
    reader = ReportPage(page)
    assert reader.problems == []
    assert len(reader.data) == 9
    errors = [row for row in reader.data["theta_POSOR_less_machining_centre.csv"] if row["series"] == "POSOR, replayed"]
    assert [row["step"] for row in errors] == [str(step.number) for step in test.steps]
    assert float(errors[1]["error [µrad]"]) == pytest.approx(1e6 * test.angle_errors[1, 2], rel=1e-5)
    assert errors[1]["predicted error, section 8.4 [µrad]"]
    assert (errors[14]["status"], errors[14]["error [µrad]"]) == ("lost:OUT_OF_RANGE", "")
    for finding in comparison.findings:
        assert {finding.quantity, finding.computed, finding.verdict.value} <= set(reader.texts)
    assert "The comparison does not hold." in reader.texts
    assert {"ymo & more", "abc123", "lost:OUT_OF_RANGE", "ok:diodes_estimated"} <= set(reader.texts)
    text = " ".join(reader.texts)
    assert "tilt_angle: previous_scan." in text
    assert "In step 14 a reading of a diode has no legible digit" in text
    assert "848 mm (33.4 in) from the POSOR's origin" in text
    assert "with <two> lines" in text
    assert "Outside the band from step 5 on: zero shifts are not compensated." in text
    assert "Outside the band from step 2 on: the reason is not known." in text


def test_without_a_printed_table_and_predictions_the_page_draws_the_replay_alone(
    printed_test: Callable[..., MotionTest],
) -> None:
    test = printed_test()
    page = replay_page(
        "a title",
        test=test,
        comparison=compare_with_thesis(test, "ymo", "section84", None),
        printed=None,
        predictions={},
        reasons={},
        calibration=load_calibration(calibration_path("section84")),
        provenance={},
    )
    rows = ReportPage(page).data["theta_POSOR_less_machining_centre.csv"]
    assert {row["series"] for row in rows} == {"POSOR, replayed"}
    assert list(rows[0]) == ["series", "step", "error [µrad]", "status"]
