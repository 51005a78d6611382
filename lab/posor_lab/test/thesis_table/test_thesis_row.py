# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Agreement and kind of a row."""

from __future__ import annotations

import pytest
from posor_lab.thesis_table.thesis_row import Agreement, ComparisonKind, ThesisRow


@pytest.mark.parametrize(
    ("printed", "computed", "input_rounding", "verdict", "kind"),
    [
        ("100", 102.0, 0.0, Agreement.AGREES, "computed from inputs"),
        ("100", 102.1, 0.0, Agreement.DIFFERS, "computed from inputs"),
        ("3", 3.49, 0.0, Agreement.AGREES, "rounding of 1 digit"),
        ("3", 3.51, 0.0, Agreement.DIFFERS, "computed from inputs"),
        ("1.5e-9", 1.5499e-9, 0.0, Agreement.AGREES, "rounding of 2 digits"),
        (".05", 0.0549, 0.0, Agreement.AGREES, "rounding of 1 digit"),
        ("0", 0.4, 0.0, Agreement.AGREES, "rounding of 1 digit"),
        ("-1", -1.0, 0.0, Agreement.AGREES, "computed from inputs"),
        ("10", 11.0, 0.5, Agreement.AGREES, "rounding of 2 digits"),
        ("", 11.0, 0.0, Agreement.NOT_LEGIBLE, "computed from inputs"),
    ],
)
def test_verdict_and_kind(printed: str, computed: float, input_rounding: float, verdict: Agreement, kind: str) -> None:
    row = ThesisRow("1.1", "error", "in", printed, computed, input_rounding=input_rounding)
    assert (row.verdict, row.kind_name) == (verdict, kind)


def test_a_stated_kind_is_kept() -> None:
    row = ThesisRow("1.1", "error", "in", "3", 3.4, kind=ComparisonKind.DEPENDENT)
    assert (row.verdict, row.kind_name) == (Agreement.AGREES, "not independent")
