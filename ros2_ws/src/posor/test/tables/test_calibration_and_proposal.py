# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tables beside a calibration: what does not fit is refused, and a map is proposed that reads the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from posor import (
    CalibrationError,
    DataFileError,
    Posor,
    PosorError,
    Scans,
    State,
    load_calibration,
    read_table,
    simulate,
)
from posor.tables.map_proposal import propose_map
from posor.tables.table_readings import load_readings

from .test_binary_tables import write_tdms

CALIBRATION = Path(__file__).parents[3] / "posor_bringup/arms/test_rig/calibrations/joint1.yaml"
COUNT = 40
NAMES = ["Time (s)", *(f"AI{n} (mV)" for n in range(3)), *(f"I{n} (uA)" for n in range(8))]
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def scans() -> Scans:
    poses = np.zeros((COUNT, 7))
    poses[:, 2], poses[:, 6] = 735e-6 + 1e-6 * np.arange(COUNT), 1.0
    return simulate(load_calibration(CALIBRATION), poses, rate=500.0, seed=1)


def columns_of(scans: Scans) -> list[Array]:
    times = (scans.stamps_ns - scans.stamps_ns[0]) * 1e-9
    return [times, *(1e3 * scans.gap_voltages.T), *(1e6 * scans.diode_currents.reshape(COUNT, 8).T)]


def write_csv(
    path: Path, columns: list[Array], names: list[str], separator: str = ",", decimal: str = ".", head: str = ""
) -> Path:
    rows = [[f"{number:.6f}".replace(".", decimal) for number in row] for row in np.column_stack(columns)]
    path.write_text(head + "\n".join(separator.join(row) for row in [names, *rows]) + "\n", encoding="utf-8")
    return path


def propose(path: Path, **calibrations: Path) -> tuple[Path, tuple[str, ...]]:
    proposal = propose_map(path, "rig", calibrations or {"joint1": CALIBRATION})
    table_map = path.with_suffix(".yaml")
    table_map.write_text(proposal.text, encoding="utf-8")
    return table_map, proposal.unsure


WAYS: dict[str, dict[str, Any]] = {
    "units in the names": {},
    "semicolons and decimal commas": {"separator": ";", "decimal": ","},
    "tabs": {"separator": "\t"},
    "comments and header lines": {"head": "# export 2026-11-25\nDAQ of the lab\nrate;500\n"},
    "names that occur several times": {"names": ["Time (s)", *["AI (mV)"] * 3, *["I (uA)"] * 8]},
    "no units": {"names": ["Time", *(f"AI{n}" for n in range(3)), *(f"I{n}" for n in range(8))]},
    "a preamble wider than the data, and a column of comments": {
        "names": ["X_Value", *NAMES[1:], "Comment"],
        "separator": "\t",
        "head": "LabVIEW Measurement\nDecimal_Separator\t.\n" + "Y_Unit_Label\t" * 20 + "\n",
    },
    "PlotJuggler": {
        "names": [
            "__time",
            *(f"/raw/gap_voltages[{n}]" for n in range(3)),
            *(f"/raw/diode_currents[{n}]" for n in range(8)),
        ]
    },
    "names of the calibration": {
        "names": [
            "t [s]",
            "gap_1 [mV]",
            "gap 2 [mV]",
            "GAP_3 [mV]",
            *(f"diode_{n} {c} [uA]" for n in (1, 2) for c in "ABCD"),
        ]
    },
}


@pytest.mark.parametrize("way", WAYS)
def test_a_proposed_map_reads_the_file(way: str, scans: Scans, tmp_path: Path) -> None:
    changes = {"names": NAMES} | WAYS[way]
    columns = columns_of(scans)
    if way == "names of the calibration":  # in any order
        order = np.random.default_rng(1985).permutation(12)
        columns, changes["names"] = [columns[n] for n in order], [changes["names"][n] for n in order]
    path = write_csv(tmp_path / "daq.csv", columns, **changes)
    table_map, unsure = propose(path)
    read = read_table(path, table_map)
    np.testing.assert_allclose(read.gap_voltages, scans.gap_voltages, atol=1e-9)
    np.testing.assert_allclose(read.diode_currents, scans.diode_currents, atol=1e-12)
    np.testing.assert_allclose(np.diff(read.stamps_ns), 2_000_000)
    guessed = [doubt for doubt in unsure if "by the order of the columns only" in doubt]
    assert len(guessed) == (0 if way == "names of the calibration" else 11)
    units = 11 if way in ("no units", "PlotJuggler") else 0
    assert sum("unit by the size of the values" in doubt for doubt in unsure) == units
    states = Posor(load_calibration(CALIBRATION)).estimate_all(read).states
    assert (states == int(State.OK)).all()


ENDS: dict[str, Callable[[str, list[str]], list[str]]] = {
    "separators below the names": lambda names, rows: [names, *(f"{row},," for row in rows)],
    "a separator behind the names": lambda names, rows: [f"{names},", *rows],
    "separators, but not in the first row": lambda names, rows: [names, rows[0], *(f"{row}," for row in rows[1:])],
    "a separator in the first row": lambda names, rows: [names, f"{rows[0]},", *rows[1:]],
    "separators below names and in the units": lambda _, rows: [
        ",".join(name.partition(" ")[0] for name in NAMES),
        ",".join(name.partition(" ")[2].strip("()") for name in NAMES) + ",",
        *(f"{row}," for row in rows),
    ],
    "a comment in the first row": lambda names, rows: [f"{names},Comment", f"{rows[0]},begin", *rows[1:]],
    "form feeds": lambda names, rows: [f"\f{names}", f"\f{rows[0]}", *rows[1:]],
    "vertical tab": lambda names, rows: [names, rows[0].replace(",", "\v,"), *rows[1:]],
    "a separator of files": lambda names, rows: ["# a\x1cb", names, *rows],
    "a next line": lambda names, rows: ["# a\x85b", names, *rows],
    "names behind a comment sign": lambda names, rows: [f"# {names}", *rows],
    "names behind the last of two comment signs": lambda names, rows: ["# of the lab", f"#{names}", *rows],
    "names behind a comment sign, and remarks": lambda names, rows: [f"# {names}", rows[0], "# pump on", *rows[1:]],
    "names between blanks behind a comment sign": lambda _, rows: [
        "# t u v w " + " ".join(f"i{n}" for n in range(8)),
        *(row.replace(",", " ") for row in rows),
    ],
    "a line separator of Unicode": lambda names, rows: ["# a\u2028b", names, *rows],
}


@pytest.mark.parametrize("kind", ENDS)
def test_a_proposal_finds_names_and_rows_where_the_reader_does(kind: str, scans: Scans, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "daq.csv", columns_of(scans), NAMES)
    names, *rows = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join(ENDS[kind](names, rows)) + "\n", encoding="utf-8")
    read = read_table(path, propose(path)[0])
    np.testing.assert_allclose(read.gap_voltages, scans.gap_voltages, atol=1e-9)
    np.testing.assert_allclose(np.diff(read.stamps_ns), 2_000_000)


def test_a_proposal_skips_no_row_that_begins_with_an_error_of_a_spreadsheet(scans: Scans, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "daq.csv", columns_of(scans), NAMES)
    path.write_text(path.read_text(encoding="utf-8").replace("\n0.000000", "\n#N/A", 1), encoding="utf-8")
    with pytest.raises(DataFileError, match=r"line 2, column 'Time \(s\)'"):
        read_table(path, propose(path)[0])


def test_a_proposal_states_what_is_missing(scans: Scans, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "daq.csv", columns_of(scans)[1:8], NAMES[1:8])
    table_map, unsure = propose(path)
    assert sum("no column found" in doubt for doubt in unsure) == 4
    assert any("write the rate of its rows" in doubt for doubt in unsure)
    with pytest.raises(CalibrationError, match=r"key time\.rate\.value: '\?'"):
        read_table(path, table_map)


def test_a_proposal_of_a_tdms_file_has_its_rate(tmp_path: Path) -> None:
    write_tdms(tmp_path / "a.tdms")
    proposal = propose_map(tmp_path / "a.tdms", "rig", {"joint1": CALIBRATION})
    assert yaml.safe_load(proposal.text)["time"]["rate"] == {"value": 500, "unit": "Hz"}


def edit_map(table_map: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    content = yaml.safe_load(table_map.read_text(encoding="utf-8"))
    content["time"]["start"] = "2026-11-25T10:00:00Z"
    change(content["joints"]["joint1"])
    table_map.write_text(yaml.safe_dump(content, allow_unicode=True), encoding="utf-8")
    return table_map


def in_volts(joint: dict[str, Any]) -> None:
    for entry in joint["gap_voltages"]:
        entry |= {"unit": "V", "header_unit": "ignored"}


def in_milliamperes(joint: dict[str, Any]) -> None:
    for entry in joint["diode_currents"]:
        entry |= {"unit": "mA", "header_unit": "ignored"}


MISTAKES: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "a gap probe is missing": (
        lambda joint: joint["gap_voltages"].pop(),
        "gap_voltages of gap_3 are missing; expected 3 columns, in the order of the calibration.",
    ),
    "a diode is missing": (
        lambda joint: joint.update(diode_currents=joint["diode_currents"][:4], lit_sources=[0]),
        "diode_currents of diode_2 A, diode_2 B, diode_2 C, diode_2 D are missing; expected 8 columns",
    ),
    "a probe too many": (
        lambda joint: joint["gap_voltages"].append({"column": "Time (s)", "unit": "V", "header_unit": "ignored"}),
        "there are 4 gap_voltages; expected 3, those of the calibration.",
    ),
    "another frame": (lambda joint: joint.update(frame_id="x"), "frame_id 'x'; expected 'joint1_receiving'."),
    "an unknown light source": (lambda joint: joint.update(lit_sources=[0, 7]), "light source 7; expected 0 to 1."),
    "millivolts as volts": (in_volts, "every value of gap_1 is beyond its calibration, the first "),
    "unit of volts": (in_volts, "; unit: mV?"),
    "microamperes as milliamperes": (in_milliamperes, "every sum of opposite currents of diode_1 A is beyond"),
}


@pytest.mark.parametrize("kind", MISTAKES)
def test_a_map_that_does_not_fit_the_calibration_is_refused(kind: str, scans: Scans, tmp_path: Path) -> None:
    change, sentence = MISTAKES[kind]
    path = write_csv(tmp_path / "daq.csv", columns_of(scans), NAMES)
    table_map = edit_map(propose(path)[0], change)
    with pytest.raises(PosorError) as caught:
        read_table(path, table_map)
    assert sentence in str(caught.value)
    assert str(table_map) in str(caught.value)


def test_single_values_beyond_the_calibration_are_counted(scans: Scans, tmp_path: Path) -> None:
    columns = columns_of(scans)
    columns[1][:3] = 9e3
    path = write_csv(tmp_path / "daq.csv", columns, NAMES)
    notes = load_readings(path, propose(path)[0]).notes
    assert "3 of 40 values of gap_1 are beyond its calibration, -6 to 6 V" in notes
    assert "supply_voltage of joint joint1 is not mapped: its effect is not corrected" in notes


def test_estimates_that_are_all_lost_say_why(scans: Scans) -> None:
    estimates = Posor(load_calibration(CALIBRATION)).estimate_all(
        scans.with_fields({"gap_voltages": 1e3 * scans.gap_voltages})
    )
    assert repr(estimates).startswith(f"<{COUNT} Estimates: {COUNT} LOST (scan 0, gap probe gap_1: 7")
    assert "is outside the calibrated range" in repr(estimates)


def test_a_file_without_rows_has_no_proposal(tmp_path: Path) -> None:
    path = tmp_path / "daq.csv"
    path.write_text("a,b\n", encoding="utf-8")
    with pytest.raises(DataFileError, match="has no rows"):
        propose(path)
    path.write_text("a" * 200_000 + "\n1,2\n", encoding="utf-8")
    with pytest.raises(DataFileError, match="line 1: field larger than field limit"):
        propose(path)
    path.write_text("AI0 (mV)  AI1 (mV)\n1  2\n3  4\n", encoding="utf-8")
    with pytest.raises(DataFileError, match="line 2: there are 2 cells; expected 4, as in the header"):
        propose(path)
