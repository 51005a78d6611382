"""Rows of the error budgets: every cell, with the verdict and the reason of the comparison of the budgets."""

from __future__ import annotations

from collections import Counter

import pytest
from posor_lab.thesis_budgets.budget_cells import Agreement, Cell, Printed, Reason
from posor_lab.thesis_budgets.diode_tables import table_5_4, table_7_9
from posor_lab.thesis_budgets.probe_tables import table_5_2, table_7_12
from posor_lab.thesis_table import budget_rows
from posor_lab.thesis_table.thesis_row import Verdict


def test_every_cell_with_an_effect_has_a_row() -> None:
    rows = budget_rows.rows()
    tables = (table_5_2(), table_5_4(), table_7_9(), table_7_12())
    cells = [cell for table in tables for cell in table.cells]
    without_effect = [cell for cell in cells if cell.printed.number == 0.0 and cell.computed == 0.0]
    assert Counter(row.section for row in rows) == Counter(
        f"Table {cell.table}" for cell in cells if cell not in without_effect
    )
    assert len({(row.section, row.quantity) for row in rows}) == len(rows) == 194 - len(without_effect)
    assert not [row for row in rows if row.reason == "no reason is known"]
    assert budget_rows.plots() == []
    shown = [cell for cell in cells if cell not in without_effect]
    agreeing = [row for cell, row in zip(shown, rows, strict=True) if cell.agreement is Agreement.AGREES]
    assert {row.verdict for row in agreeing} == {Verdict.AGREES}


@pytest.mark.parametrize(
    ("printed", "computed", "rounding", "reason", "verdict", "text"),
    [
        (Printed("76", 1.0), 75.6, 0.0, None, Verdict.AGREES, ""),
        (Printed("0", 0.0001), 0.003, 0.0, None, Verdict.DIFFERS, "no reason is known"),
        (Printed("0", 0.0001), 0.00004, 0.0, None, Verdict.AGREES, ""),
        (Printed("nan", 1.0), 199.6, 0.0, None, Verdict.NOT_LEGIBLE, "not legible"),
        (Printed("13", 1.0), 12.4, 0.2, None, Verdict.AGREES, "rounding of the cell and of the printed perturbation"),
        (Printed("13", 1.0), 12.2, 0.2, None, Verdict.DIFFERS, "no reason is known"),
        (Printed("48", 1.0), 40.0, 0.0, Reason("other factor", 48.2), Verdict.DIFFERS, "other factor: 48.2"),
    ],
)
def test_a_cell_keeps_its_reason(
    printed: Printed,
    computed: float,
    rounding: float,
    reason: Reason | None,
    verdict: Verdict,
    text: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cell = Cell("7.9", "group: sigma_X", "induced_sigma_theta_urad", printed, computed, rounding, reason)
    table = table_5_2()
    monkeypatch.setattr(budget_rows, "table_5_2", lambda: type(table)("7.9", "one cell", (cell,)))
    row = budget_rows.rows()[0]
    assert (row.section, row.quantity, row.unit) == ("Table 7.9", "group: sigma_X, effect on theta", "urad")
    assert row.computed == computed
    assert row.verdict is verdict
    assert text in row.reason
    assert bool(text) is bool(row.reason)
