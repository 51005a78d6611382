"""make thesis: the table, its JSON file and its page; the numbers that must have a row."""

from __future__ import annotations

import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from posor.errors import DataFileError
from posor_lab.thesis_table import motion_test_rows, thesis_table
from posor_lab.thesis_table.thesis_row import ThesisRow, Verdict
from posor_lab.thesis_table.thesis_table import SUBJECTS, Subject, all_rows, format_cells, summary
from posor_lab.thesis_table.thesis_table_command import main

ROOT = Path(__file__).resolve().parents[4]
KEYS = ["section", "quantity", "unit", "printed", "computed", "difference", "verdict", "reason"]
LEAST_AGREEING = 60
BUDGETS = ("Table 5.2", "Table 5.4", "Table 7.9", "Table 7.12")
"""Their cells agree in great numbers; they have a test of their own."""
PRINTED = {
    "1.3": (0.0065,),
    "1.4": (5.6e-9, 6.2e-10),
    "App. 1A": (26, 864),
    "2.4": (862, 0.0012),
    "4.3": (5e-8, 2.5),
    "6.2.2": (318, 1994, 5583, 235, 1475, 4131),
    "App. 6A": (129.79831, 140.721214, 183.779175, 201.010994, 211.716768, 426.793661),
    "6.2.3": (0.3529, 0.21, 0.145, 0.271, 0.813, 2850, 868, 22.3, 0.0082, 12, 78, 123, 154, 100, 1.5),
    "7.2": (0.000408, 0.3, 1.2, 6.0, 4),
    "7.4": (0.0055, 9, 0.0028),
    "7.4.2": (50,),
    "7.3": (0.000308, 0.011096, 0.002708, 0.001033),
    "8.3.1": (351, 264, 175),
    "8.4": (189, 68, 53, 45, 0.0045, 120, 0.004008, 3914, 2505, 0.0155),
    "8.5": (0.000625, 0.008929),
    "9.1": (0.0047,),
    "9.4": (640, 5650, 3200, 12200, 6300, 25575, 10000),
    "9.3.3": (62, 180, 211, 284, 88, 142, 198, 260),
}
"""Numbers that must have a row, by section or by the section above it."""


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
        if row["verdict"] == Verdict.NOT_LEGIBLE.value:
            assert row["printed"] is row["difference"] is None
        else:
            assert row["difference"] == pytest.approx(row["computed"] - row["printed"], abs=1e-15)


def test_at_least_sixty_rows_agree_and_every_other_has_a_reason(rows: list[dict[str, Any]]) -> None:
    agreeing = [row for row in rows if row["verdict"] == Verdict.AGREES.value and row["section"] not in BUDGETS]
    assert len(agreeing) >= LEAST_AGREEING
    assert not [row for row in rows if row["verdict"] != Verdict.AGREES.value and not row["reason"]]


def test_rows_are_ordered_and_distinct(rows: list[dict[str, Any]]) -> None:
    names = [(row["section"], row["quantity"]) for row in rows]
    assert not {name for name in names if names.count(name) > 1}
    assert {row["section"].split(".")[0] for row in rows} >= {"1", "2", "4", "6", "7", "8", "9"}
    first = {row["section"]: index for index, row in reversed(list(enumerate(rows)))}
    assert first["1.3"] < first["App. 1A"] < first["2.4"] < first["6.2.2"] < first["App. 6A"] < first["8.3.1"]


@pytest.mark.parametrize("section", PRINTED)
def test_every_printed_number_has_a_row(section: str, rows: list[dict[str, Any]]) -> None:
    printed = [
        row["printed"]
        for row in rows
        if row["printed"] is not None and (row["section"] == section or row["section"].startswith(section + "."))
    ]
    missing = [number for number in PRINTED[section] if number not in printed]
    assert not missing, f"{section}: {sorted(printed)}"


def test_the_page_has_every_subject_with_its_figures(run: tuple[int, Path], rows: list[dict[str, Any]]) -> None:
    page = run[1].with_suffix(".html").read_text(encoding="utf-8")
    for title in SUBJECTS.values():
        assert f"<h2>{title}</h2>" in page
    assert page.count("<figure>") >= len(SUBJECTS)
    assert page.count("<tr><td>") == len(rows)
    assert f"{len(rows)} rows: " in page


def test_the_documents_state_the_figures_of_the_table(rows: list[dict[str, Any]]) -> None:
    budgets = [row["section"] in BUDGETS for row in rows]
    number = Counter(row["verdict"] for row in rows)
    others = Counter(row["verdict"] for row in rows if row["section"] not in BUDGETS)
    agree, differ, lost = (number[verdict.value] for verdict in (Verdict.AGREES, Verdict.DIFFERS, Verdict.NOT_LEGIBLE))
    page = " ".join((ROOT / "docs" / "background" / "thesis_table.md").read_text(encoding="utf-8").split())
    assert f"{len(rows)} rows: {agree} agree within 2 % or rounding, {differ} differ for the reason stated" in page
    assert f"{sum(budgets)} of these rows are the cells of the error budgets" in page
    assert f"Of the other {others.total()} rows, {others[Verdict.AGREES.value]} agree." in page
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert (
        f"{len(rows)} rows | {agree} agree within 2 % or rounding, {differ} differ for a stated reason, {lost}"
        in readme
    )


def test_a_row_as_text() -> None:
    row = ThesisRow("1.1", "error", "in", ".0100", 0.0111, "because")
    assert format_cells(row) == ("1.1", "error", ".0100", "0.0111", "in", "+11.0 %", "differs", "because")
    row = ThesisRow("1.1", "ratio", "1", "0", 1e-3, "small")
    assert format_cells(row) == ("1.1", "ratio", "0", "0.001", "", "+0.001", "agrees", "small")
    row = ThesisRow("1.1", "error", "in", "", 0.25, "lost")
    assert format_cells(row) == ("1.1", "error", "", "0.25", "in", "", "not legible", "lost")


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
    def fail() -> list[ThesisRow]:
        raise DataFileError("column 'x' is missing", where="table.csv")

    monkeypatch.setattr(motion_test_rows, "rows", fail)
    monkeypatch.setattr(thesis_table, "SUBJECTS", {"motion_test_rows": "Motion tests"})
    assert main(["--output", str(tmp_path / "thesis.json")]) == 1
    captured = capsys.readouterr()
    assert captured.err == "table.csv: column 'x' is missing.\n"
    assert not captured.out
