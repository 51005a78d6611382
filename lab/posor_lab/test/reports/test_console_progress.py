# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Progress in the terminal and elsewhere."""

from __future__ import annotations

import io

from posor_lab.reports.console_progress import StageProgress
from rich.console import Console


def test_stages_are_bars_in_a_terminal_and_lines_elsewhere() -> None:
    shown = {}
    for terminal in (True, False):
        console = Console(file=io.StringIO(), force_terminal=terminal, width=100)
        with StageProgress(console) as stages, stages.stage("sweeping", 2) as on_done:
            on_done()
            on_done()
        shown[terminal] = console.file.getvalue()  # type: ignore[attr-defined]  # of a StringIO
    assert "2/2" in shown[True]
    assert shown[False] == "sweeping: 2 done in 0 s\n"
