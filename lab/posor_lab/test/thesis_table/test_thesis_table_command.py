# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""make thesis: the table, its JSON file and its page; the numbers that must have a row."""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from posor_lab.thesis_budgets.budget_tables import budget_tables
from posor_lab.thesis_table import thesis_table_command
from posor_lab.thesis_table.row_file import RowFile
from posor_lab.thesis_table.thesis_row import Agreement, ComparisonKind, ThesisRow
from posor_lab.thesis_table.thesis_table_command import Subject, all_rows, format_cells, main, row_files, summary

COMPUTED = ComparisonKind.COMPUTED.value
ROOT = Path(__file__).resolve().parents[4]
KEYS = ["section", "quantity", "unit", "printed", "computed", "difference", "verdict", "kind", "reason"]
RECORDED = Path(__file__).with_name("recorded_rows.csv")
"""The rows as they were found and checked: what changes here is to be explained."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, Path]:
    output = tmp_path_factory.mktemp("thesis") / "new" / "thesis.json"
    return main(["--output", str(output)]), output


@pytest.fixture(scope="module")
def rows(run: tuple[int, Path]) -> list[dict[str, Any]]:
    content = json.loads(run[1].read_text(encoding="utf-8"))
    assert list(content) == ["rows"]
    found: list[dict[str, Any]] = content["rows"]
    return found


def test_every_row_has_the_stated_fields(run: tuple[int, Path], rows: list[dict[str, Any]]) -> None:
    assert run[0] == 0
    for row in rows:
        assert list(row) == KEYS
        assert all(isinstance(row[key], str) for key in ("section", "quantity", "unit", "verdict", "reason"))
        assert row["section"]
        assert row["quantity"]
        assert math.isfinite(row["computed"])
        if row["verdict"] == Agreement.NOT_LEGIBLE.value:
            assert row["printed"] is row["difference"] is None
        else:
            assert row["difference"] == pytest.approx(row["computed"] - row["printed"], abs=1e-15)


def test_every_row_has_the_recorded_number_verdict_and_kind(rows: list[dict[str, Any]]) -> None:
    with RECORDED.open(encoding="utf-8", newline="") as file:
        recorded = list(csv.DictReader(file))
    assert [(row["section"], row["quantity"]) for row in rows] == [
        (row["section"], row["quantity"]) for row in recorded
    ]
    for row, known in zip(rows, recorded, strict=True):
        assert row["computed"] == pytest.approx(float(known["computed"]), rel=1e-6, abs=1e-8), known["quantity"]
        assert (row["unit"], row["verdict"], row["kind"]) == (known["unit"], known["verdict"], known["kind"])
        assert row["printed"] == (float(known["printed"]) if known["printed"] else None)


def test_reason_and_kind_of_a_row_agree(rows: list[dict[str, Any]]) -> None:
    for row in rows:
        assert row["reason"] or row["verdict"] == Agreement.AGREES.value
        assert ("not independent" in row["reason"]) is (row["kind"] == ComparisonKind.DEPENDENT.value)
        assert row["section"].startswith("Table 8.2") is ("table 8.2 is not in the scan" in row["reason"])
        assert ("assumed budget" in row["quantity"]) is row["reason"].startswith("assumed errors")
        assert row["reason"] != "no reason is known"


def test_rows_are_ordered_and_distinct(rows: list[dict[str, Any]]) -> None:
    names = [(row["section"], row["quantity"]) for row in rows]
    assert not {name for name in names if names.count(name) > 1}
    assert {row["section"].split(".")[0] for row in rows} >= {"1", "2", "4", "6", "7", "8", "9"}
    first = {row["section"]: index for index, row in reversed(list(enumerate(rows)))}
    assert first["1.3"] < first["App. 1A"] < first["2.4"] < first["6.2.2"] < first["App. 6A"] < first["8.3.1"]


def test_the_page_has_every_subject_with_its_figures(run: tuple[int, Path], rows: list[dict[str, Any]]) -> None:
    page = run[1].with_suffix(".html").read_text(encoding="utf-8")
    for path in row_files():
        assert f"<h2>{RowFile(path).title}</h2>" in page
    assert page.count("<figure>") == 55
    assert page.count("<tr><td>") == len(rows)
    assert f"{len(rows)} rows: " in page


def test_every_budget_cell_with_an_effect_has_a_row(rows: list[dict[str, Any]]) -> None:
    cells = [cell for table in budget_tables().values() for cell in table.cells]
    cells = [cell for cell in cells if cell.printed_number != 0.0 or cell.computed != 0.0]
    found = [row for row in rows if row["kind"] == ComparisonKind.BUDGET_CELL.value]
    assert Counter(row["section"] for row in found) == Counter(f"Table {cell.table}" for cell in cells)


def test_the_documents_state_the_figures_of_the_table(rows: list[dict[str, Any]]) -> None:
    number = Counter(row["verdict"] for row in rows)
    kinds = Counter(row["kind"].partition(" of ")[0] for row in rows if row["verdict"] == Agreement.AGREES.value)
    cells = sum(row["kind"] == ComparisonKind.BUDGET_CELL.value for row in rows)
    agree, differ, lost = (
        number[verdict.value] for verdict in (Agreement.AGREES, Agreement.DIFFERS, Agreement.NOT_LEGIBLE)
    )
    page = " ".join((ROOT / "docs" / "background" / "thesis_table.md").read_text(encoding="utf-8").split())
    assert f"{len(rows)} rows: {agree} agree within 2 % or rounding, {differ} differ for the reason stated" in page
    assert f"{cells} of these rows are the cells of the error budgets" in page
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"{len(rows)} rows | {agree} agree within 2 % or rounding (" in readme
    assert f"), {differ} differ for a stated reason, {lost}" in readme
    for kind, count in kinds.items():
        assert f"| {kind} | {count} |" in page
        assert f"{count} {kind}" in readme


def test_a_row_as_text() -> None:
    row = ThesisRow("1.1", "error", "in", ".0100", 0.0111, "because")
    assert format_cells(row) == (
        "1.1",
        "error",
        ".0100",
        "0.0111",
        "in",
        "+11.0 %",
        "computed from inputs",
        "differs",
        "because",
    )
    row = ThesisRow("1.1", "ratio", "1", "0", 1e-3, "small")
    assert format_cells(row) == ("1.1", "ratio", "0", "0.001", "", "+0.001", "rounding of 1 digit", "agrees", "small")
    row = ThesisRow("1.1", "error", "in", "", 0.25, "lost")
    assert format_cells(row) == ("1.1", "error", "", "0.25", "in", "", COMPUTED, "not legible", "lost")


def test_sections_are_ordered_as_in_the_thesis() -> None:
    sections = ["App. 6A", "6.10", "Table 7.1", "6.9.1", "7.1", "1.3", "App. 1A", "6.9"]
    subject = Subject("all", tuple(ThesisRow(section, "x", "1", "1", 1.0) for section in sections), ())
    ordered = [row.section for row in all_rows([subject])]
    assert ordered == ["1.3", "App. 1A", "6.9", "6.9.1", "6.10", "App. 6A", "Table 7.1", "7.1"]
    assert summary(subject.rows).startswith("8 rows: 8 agree within 2 % or rounding, 0 differ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--outptu", "x"], "thesis: unrecognized arguments: --outptu x; expected"),
        (["--output", "{folder}/file/x.json"], "--output {folder}/file/x.json: cannot be written:"),
        (["--output", "{folder}"], "--output {folder}: cannot be written: is a folder; expected a file.\n"),
        (["--output", "{folder}/x.html"], "thesis: --output {folder}/x.html: the page has this name; expected"),
    ],
)
def test_invalid_options_are_refused(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert main([each.replace("{folder}", str(tmp_path)) for each in arguments]) == 2
    assert capsys.readouterr().err.startswith(message.replace("{folder}", str(tmp_path)))


def test_a_failed_calculation_is_one_sentence_and_no_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rows.yaml"
    monkeypatch.setattr(thesis_table_command, "row_files", lambda: [path])
    assert main(["--output", str(tmp_path / "thesis.json")]) == 1
    captured = capsys.readouterr()
    assert captured.err.startswith(f"{path}: cannot be read: ")
    assert captured.err.count("\n") == 1
    assert not captured.out
