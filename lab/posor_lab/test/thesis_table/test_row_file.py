# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The evaluator of the files of rows: values, tables, refusals with file and row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from posor.errors import DataFileError
from posor_lab.thesis_table.figure_data import draw_figures
from posor_lab.thesis_table.row_file import RowFile
from posor_lab.thesis_table.thesis_row import ComparisonKind

FILE = """
title: Beams
modules: [posor_design.structures, posor_lab.thesis_table.formulas, scipy.constants]
inputs:
  beam: &beam {length: 10 ft, tip_force: 300 lbf, modulus: 10e6 psi, height: 7 in, width: 4 in}
sources:
  beam: {function: cantilever_beam, <<: *beam, wall: 3/16 in}
  twice: {product: [2, $beam.stress]}
rows:
  App. 1A:
  - {quantity: stress, unit: psi, printed: 4500, value: $beam.stress, reason: "twice: {twice ksi:.1f} ksi"}
  - tables: [{columns: [wall, printed], rows: [[3/16, 26], [1/8, ""]]}, {columns: [name], rows: [[I]]}]
    values: {box: {function: cantilever_beam, <<: *beam, wall: "{wall} in"}}
    quantity: "{name} of a wall of {wall} in"
    unit: in^4
    printed: "{printed}"
    value: $box.second_moment
    reason: {I of a wall of 1/8 in: lost in the scan}
    kind: sign
figures:
- title: Stress
  x: force [lbf]
  y: stress [psi]
  unit: lbf
  scale: psi
  at: [100, 300]
  curves: [{name: box, each: {function: cantilever_beam.stress, <<: *beam, wall: 3/16 in, tip_force: $x}, colour: blue}]
"""


def load(folder: Path, old: str = "", new: str = "") -> RowFile:
    assert old in FILE
    path = folder / "rows.yaml"
    path.write_text(FILE.replace(old, new, 1), encoding="utf-8")
    return RowFile(path)


def test_rows_are_evaluated_with_units_sources_and_tables(tmp_path: Path) -> None:
    file = load(tmp_path)
    stress, thick, thin = file.rows()
    assert (file.title, stress.section, stress.quantity) == ("Beams", "App. 1A", "stress")
    assert stress.computed == pytest.approx(300.0 * 120.0 * 3.5 / 26.4949, rel=1e-5)
    assert stress.reason == f"twice: {2e-3 * stress.computed:.1f} ksi"
    assert stress.kind is ComparisonKind.COMPUTED
    assert [row.quantity for row in (thick, thin)] == ["I of a wall of 3/16 in", "I of a wall of 1/8 in"]
    assert thick.computed == pytest.approx((4.0 * 7.0**3 - 3.625 * 6.625**3) / 12.0)
    assert [row.printed for row in (thick, thin)] == ["26", ""]
    assert [row.reason for row in (thick, thin)] == ["", "lost in the scan"]
    assert thin.kind is ComparisonKind.SIGN
    file.check_unused()


def test_a_figure_is_drawn_in_its_units(tmp_path: Path) -> None:
    file = load(tmp_path)
    (plot,) = draw_figures(file)
    name, force, stress = plot.csv.splitlines()[2].split(",")
    assert (name, force) == ("box", "300")
    assert float(stress) == pytest.approx(file.rows()[0].computed, rel=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("printed: 4500", "print: 4500", "App. 1A, stress: key 'print' is unknown; expected perhaps 'printed'"),
        ("unit: psi, ", "", "App. 1A, stress: key 'unit' is missing"),
        ("unit: psi", "unit: pis", "App. 1A, stress: unit 'pis' is unknown; expected a number or one of"),
        ("10 ft", "10 feet", "App. 1A, stress: unit 'feet' is unknown"),
        ("$beam.stress]", "$beams.stress]", "App. 1A, stress: 'beams' is unknown or refers to itself"),
        ("$beam.stress]", "$twice]", "App. 1A, stress: 'twice' is unknown or refers to itself"),
        ("$beam.stress]", "$beam.strain]", "'strain' is not a field of CantileverBeam"),
        (
            "function: cantilever_beam,",
            "function: cantilever,",
            "function 'cantilever' is unknown; expected a function of",
        ),
        ("function: cantilever_beam,", "function: inch,", "function 'inch' is unknown"),
        ("function: cantilever_beam,", "functions: cantilever_beam,", "key 'function' is missing"),
        ("wall: 3/16 in}", "}", "function 'cantilever_beam': missing a required argument: 'wall'"),
        (
            "wall: 3/16 in}",
            "walls: 3 in, wall: 3/16 in}",
            "function 'cantilever_beam': got an unexpected keyword argument 'walls'",
        ),
        ('"twice: {twice ksi:.1f} ksi"', '""', "'stress' differs without a reason: printed '4500', computed 4755.63"),
        (
            "kind: sign",
            "kind: signs",
            "{name} of a wall of {wall} in: kind 'signs' is unknown; expected one of computed from",
        ),
        ("{product:", "{produce:", "key 'function' is missing"),
        ("[3/16, 26]", "[3/16]", "row ['3/16'] of its table has 1 cells; expected 2"),
        ("[2, $beam", "[nan, $beam", "product of ('nan', "),
        ("title: Beams", "", "key 'title' is missing"),
        ("title: Beams", "title: Beams\ntitle: Rods", "cannot be read: duplicate key 'title', also in line 2"),
        ("  App. 1A:\n", "  App. 1A:\n  - stress\n", "App. 1A, stress: is not a mapping; expected keys"),
        ("structures, ", "structure, ", "a module of 'modules' cannot be imported: No module named"),
        ("colour: blue", "color: blue", "figures, Stress: key 'color' is unknown; expected perhaps 'colour'"),
    ],
)
def test_a_wrong_file_is_refused_with_file_and_row(old: str, new: str, message: str, tmp_path: Path) -> None:
    def evaluate() -> Any:
        file = load(tmp_path, old, new)
        return file.rows(), draw_figures(file)

    with pytest.raises(DataFileError) as caught:
        evaluate()
    assert str(caught.value).startswith(str(tmp_path / "rows.yaml"))
    assert message in " ".join(str(caught.value).split())


def test_an_unused_source_is_refused(tmp_path: Path) -> None:
    file = load(tmp_path, "{twice ksi:.1f} ksi", "9.5 ksi")
    file.rows()
    with pytest.raises(DataFileError, match=r"rows\.yaml: source 'twice' is not used\.$"):
        file.check_unused()


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataFileError, match="cannot be read"):
        RowFile(tmp_path / "missing.yaml")
