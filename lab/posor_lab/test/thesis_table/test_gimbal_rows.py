"""Rows of gimbals (6.2.3, 7.3, 9.3.2) follow from the text's input; plots."""

from __future__ import annotations

import csv

import pytest
from posor_lab.thesis_table import gimbal_rows
from posor_lab.thesis_table.thesis_row import Verdict

from .find_row import find_row


def test_the_print_follows_from_the_density_of_steel_as_the_reason_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gimbal_rows, "BEAM_DENSITY", gimbal_rows.STEEL_DENSITY)
    row = find_row(gimbal_rows.rows(), "6.2.3.2", "allowed mu r")
    assert row.verdict is Verdict.AGREES
    assert row.computed == pytest.approx(0.0082, abs=1e-5)


def test_rows_follow_from_the_input_of_the_text(monkeypatch: pytest.MonkeyPatch) -> None:
    before = gimbal_rows.rows()
    monkeypatch.setitem(gimbal_rows.WIRE, "angle", 2.0 * gimbal_rows.ANGLE)
    monkeypatch.setitem(gimbal_rows.BEAM, "modulus", 2.0 * gimbal_rows.BEAM["modulus"])
    for section, quantity, ratio in (
        ("6.2.3", "bending torque", 2.0),
        ("6.2.3", "rotation of the gimbals", 0.5),
        ("6.2.3.1", "length of the wires, four", 2.0),
        ("6.2.3.1", "length of the wires, two degrees of freedom, about Z", 2.0),
        ("6.2.3.1", "stress by the stretch", 1.0),
    ):
        changed = find_row(gimbal_rows.rows(), section, quantity).computed
        assert changed == pytest.approx(ratio * find_row(before, section, quantity).computed, rel=1e-9)


def test_plots_show_the_printed_torque_and_table_7_2() -> None:
    wires, friction = gimbal_rows.plots()
    lines = list(csv.reader(wires.csv.splitlines()[1:]))
    two = [(float(length), float(torque)) for name, length, torque in lines if name.startswith("two wires")]
    assert [torque for _, torque in two] == sorted((torque for _, torque in two), reverse=True)
    assert friction.csv.count("measured (printed)") == len(gimbal_rows.BEARINGS)
