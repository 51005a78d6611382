# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The table of steps: terminal, plain lines, CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable

import pytest
from posor.model.scan import DIODES_ESTIMATED
from posor_lab.replay_1985.comparison import compare_with_thesis
from posor_lab.replay_1985.motion_test import MotionTest
from posor_lab.replay_1985.printed_results import PrintedColumns
from posor_lab.replay_1985.replay_report import HEADINGS
from posor_lab.replay_1985.step_table import CSV_HEADER, LiveTable, steps_as_csv
from posor_lab.reports.findings import print_findings
from rich.console import Console


def show_steps(test: MotionTest, *, terminal: bool, live: bool = True, height: int = 60) -> str:
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=terminal, width=130, height=height, highlight=False)
    with LiveTable("a title", console, live=live) as table:
        for count in range(1, len(test.steps) + 1):
            table.show(test.steps[:count])
            table.show(test.steps[:count])
    return screen.getvalue()


def test_every_step_is_one_plain_line_where_there_is_no_terminal(printed_test: Callable[..., MotionTest]) -> None:
    lines = show_steps(printed_test(lost=(15,)), terminal=False).splitlines()
    assert lines[0] == "a title"
    steps = lines[3:]
    assert [line.split()[0] for line in steps] == [str(number) for number in range(1, 16)]
    assert steps[13].split()[1:6] == ["66.0", "3922.0", "4034.0", "-229.0", "-16.0"]
    assert steps[14].split()[1:6] == ["-", "-", "4318.0", "-", "-13.0"]
    assert steps[14].endswith("lost:OUT_OF_RANGE")


def test_the_user_may_have_plain_lines_in_a_terminal(printed_test: Callable[..., MotionTest]) -> None:
    assert "┃" not in show_steps(printed_test(), terminal=True, live=False)


def test_a_terminal_ends_with_the_whole_table_even_if_it_is_low(printed_test: Callable[..., MotionTest]) -> None:
    text = show_steps(printed_test(), terminal=True, height=12)
    last = text[text.rindex("a title") :]
    assert all(f"│ {number:>4} │" in last for number in range(1, 16))


def test_the_comparison_is_printed_line_by_line_or_as_a_table(
    printed_test: Callable[..., MotionTest], printed: PrintedColumns
) -> None:
    comparison = compare_with_thesis(printed_test(lost=(3,)), "ymo", "printed", printed)
    for terminal in (False, True):
        screen = io.StringIO()
        console = Console(file=screen, force_terminal=terminal, width=200, color_system=None)
        print_findings(comparison, console, "a comparison", HEADINGS)
        text = screen.getvalue()
        assert "FAILS" in text
        assert "3 (lost:OUT_OF_RANGE)" in text
        assert ("┃" in text) == terminal
        if not terminal:
            assert len(text.splitlines()) == len(comparison.findings)


def test_steps_as_csv(printed_test: Callable[..., MotionTest]) -> None:
    test = printed_test(lost=(15,), statuses={14: DIODES_ESTIMATED})
    text = steps_as_csv(test)
    assert text.splitlines()[0] == (
        "step,alpha_posor_urad,beta_posor_urad,theta_posor_urad,beta_meas_urad,theta_meas_urad,x_m,y_m,z_m,status"
    )
    rows = list(csv.DictReader(text.splitlines()))
    assert list(rows[0].values()) == ["1", *["0.000"] * 5, *["0.000000000"] * 3, "ok"]
    assert [float(rows[13][name]) for name in CSV_HEADER[1:6]] == pytest.approx([66.0, 3922.0, -229.0, 4034.0, -16.0])
    assert float(rows[13]["y_m"]) == pytest.approx(test.endpoint_displacement[13, 1], abs=1e-9)
    assert rows[13]["status"] == "ok:diodes_estimated"
    assert list(rows[14].values()) == ["15", *[""] * 3, "4318.000", "-13.000", *[""] * 3, "lost:OUT_OF_RANGE"]
