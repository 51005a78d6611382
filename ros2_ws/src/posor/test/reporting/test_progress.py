# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Progress: a bar with the remaining time on a terminal, elsewhere a line for a long step, on standard error."""

from __future__ import annotations

import pytest
from posor.reporting.progress import progress_display


def test_a_long_step_has_one_line_with_the_remaining_time(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr("posor.reporting.progress.time.monotonic", lambda: now[0])
    with progress_display() as display:
        step = display.add("bag", 200.0)
        for _ in range(4):
            now[0] += 6.0
            step.advance(20.0)
        step.set(200.0)
        display.begin("reading")
        now[0] += 3.0
        display.begin("fitting [a]")
        now[0] += 30.0
    assert capsys.readouterr() == ("", "bag: 20 % in 12 s, about 48 s remain\nfitting [a]: 30 s\n")


def test_a_terminal_shows_name_share_and_remaining_time(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {"FORCE_COLOR": "1", "TERM": "xterm", "COLUMNS": "120"}.items():
        monkeypatch.setenv(name, value)
    with progress_display() as display:
        step = display.add("bag", 4.0)
        step.advance(1.0)
    shown = capsys.readouterr().err
    assert "bag" in shown
    assert "25%" in shown
