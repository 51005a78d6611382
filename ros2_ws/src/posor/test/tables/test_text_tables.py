# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Text tables: every way to write the same numbers gives the same scans, and every doubt is one sentence."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor import CalibrationError, DataFileError, ParameterError, PosorError, Scans, read_table
from posor.tables.table_map import FileLayout, load_table_map
from posor.tables.table_readings import load_readings
from posor.tables.text_table import TextTable, decode
from posor_lab.harness.case_tables import edited

from .sample_files import CELSIUS, COUNT, NAMES, READINGS, START, START_NS, TIMES, VOLTS, rows, write_csv, write_map


def check_scans(scans: Scans) -> None:
    np.testing.assert_array_equal(scans.stamps_ns, START_NS + np.round(1e9 * TIMES).astype(np.int64))
    np.testing.assert_allclose(scans.gap_voltages, VOLTS, rtol=1e-12)
    np.testing.assert_allclose(scans.temperatures, CELSIUS + 273.15, rtol=1e-12)
    np.testing.assert_array_equal(scans.numbers, np.arange(1, COUNT + 1))
    assert np.isnan(scans.supply_voltages).all()


def csv_of(*, separator: str = ",", decimal: str = ".", names: tuple[str, ...] = NAMES) -> str:
    lines = [separator.join(names), *(separator.join(row) for row in rows(decimal))]
    return "\n".join(lines) + "\n"


TEXT = csv_of()
WAYS: dict[str, tuple[bytes, dict[str, Any]]] = {
    "plain": (TEXT.encode(), {}),
    "semicolons and decimal commas": (
        csv_of(separator=";", decimal=",").encode(),
        {"file": {"separator": ";", "decimal": ","}},
    ),
    "quoted decimal commas": (
        "\n".join([TEXT.splitlines()[0], *(",".join(f'"{cell}"' for cell in row) for row in rows(","))]).encode()
        + b"\n",
        {"file": {"decimal": ","}},
    ),
    "tabs": (csv_of(separator="\t").encode(), {"file": {"separator": "tab"}}),
    "blanks": (
        csv_of(separator="   ", names=("t", "u0", "u1", "T", "r")).encode(),
        {
            "file": {"separator": "space"},
            "time": {"column": "t", "unit": "s", "start": START},
            "joints": {
                "elbow": {
                    "frame_id": "plate",
                    "gap_voltages": [{"column": "u0", "unit": "mV"}, {"column": 3, "unit": "mV"}],
                    "temperature": {"column": "T", "unit": "degC"},
                }
            },
        },
    ),
    "exponents of Fortran": (re.sub(r"(?m)^([0-9.]+),([0-9.]+)", r"\1D+00,\2d+00", TEXT).encode(), {}),
    "byte order mark": (b"\xef\xbb\xbf" + TEXT.encode(), {}),
    "UTF-16": (TEXT.encode("utf-16"), {}),
    "UTF-16 without mark": (TEXT.encode("utf-16-le"), {"file": {"encoding": "utf-16-le"}}),
    "Windows": (TEXT.replace("\n", "\r\n").encode("cp1252"), {"file": {"encoding": "cp1252"}}),
    "old Macintosh lines": (TEXT.replace("\n", "\r").encode(), {}),
    "comments": (TEXT.replace("\n0.0040", "\n\n# a remark, with commas\n0.0040").encode(), {}),
    "other comments": (TEXT.replace("\n0.0040", "\n% a remark\n0.0040").encode(), {"file": {"comment": "%"}}),
    "header lines": (("DAQ 3\nRate;500\n\n" + TEXT).encode(), {"file": {"header_line": 4}}),
    "line of units": (
        TEXT.replace("(mV)", "")
        .replace("\n", "\ns,mV,mV,,\n", 1)
        .replace("AI0 ", "AI0")
        .replace("AI1 ", "AI1")
        .encode(),
        {
            "file": {"data_line": 3},
            "joints": {
                "elbow": {
                    "frame_id": "plate",
                    "gap_voltages": [{"column": "AI0", "unit": "mV"}, {"column": "AI1", "unit": "mV"}],
                    "temperature": READINGS["temperature"],
                }
            },
        },
    ),
    "no header": (
        TEXT.partition("\n")[2].encode(),
        {
            "file": {"header_line": 0},
            "time": {"column": 1, "unit": "s", "start": START},
            "joints": {
                "elbow": {
                    "frame_id": "plate",
                    "gap_voltages": [{"column": 2, "unit": "mV"}, {"column": 3, "unit": "mV"}],
                    "temperature": {"column": 4, "unit": "degC"},
                }
            },
        },
    ),
    "line for Excel": (b"sep=,\n" + TEXT.encode(), {}),
    "names of two lines": (TEXT.replace("AI0 (mV)", '"AI0\n(mV)"').encode(), {}),
    "columns in another order": (
        "\n".join(",".join(reversed(line.split(","))) for line in TEXT.splitlines()).encode() + b"\n",
        {},
    ),
    "separator at the end": (TEXT.replace("\n", ",\n").encode(), {}),
    "no line end": (TEXT.removesuffix("\n").encode(), {}),
    "rate only": (TEXT.encode(), {"time": {"rate": {"value": 500.0, "unit": "Hz"}, "start": START}}),
    "ISO texts": (
        TEXT.replace("\n0.0", "\n2026-11-25T11:00:00.0").encode(),
        {"time": {"column": "Time (s)", "format": "iso", "time_zone": "Europe/Berlin"}},
    ),
    "date and time apart": (
        TEXT.replace("Time (s)", "Date,Clock").replace("\n0.0", "\n25.11.2026,10:00:00.0").encode(),
        {"time": {"column": ["Date", "Clock"], "format": "%d.%m.%Y %H:%M:%S.%f", "time_zone": "UTC"}},
    ),
    "milliseconds since 1970": (
        "\n".join(
            [
                "t" + TEXT.splitlines()[0][8:],
                *(f"{START_NS // 10**6 + 2 * n}{line[6:]}" for n, line in enumerate(TEXT.splitlines()[1:])),
            ]
        ).encode(),
        {"time": {"column": "t", "unit": "ms", "start": "1970-01-01T00:00:00Z"}},
    ),
    "scale and offset": (
        TEXT.replace("AI0 (mV)", "AI0").replace("AI1 (mV)", "AI1").encode(),
        {
            "joints": {
                "elbow": {
                    "frame_id": "plate",
                    "gap_voltages": [
                        {
                            "column": f"AI{n}",
                            "unit": "A",
                            "scale": {"value": 0.5, "unit": "mV/A"},
                            "offset": {"value": volt, "unit": "V"},
                        }
                        for n, volt in enumerate((0.0, 0.0))
                    ],
                    "temperature": READINGS["temperature"],
                }
            }
        },
    ),
}


@pytest.mark.parametrize("way", WAYS)
def test_every_way_to_write_the_table_gives_the_same_scans(way: str, tmp_path: Path) -> None:
    data, changes = WAYS[way]
    path = tmp_path / "daq.csv"
    path.write_bytes(data)
    scans = read_table(path, write_map(tmp_path, **changes))
    if way == "scale and offset":
        np.testing.assert_allclose(scans.gap_voltages, 0.5 * VOLTS, rtol=1e-12)
        return
    check_scans(scans)


ROW = "0.0040,712.000,-254.000,20.20,ok"
BAD: dict[str, tuple[str, dict[str, Any], str]] = {
    "empty": ("", {}, "{csv}: is empty; expected a row of names and one row for each scan."),
    "no rows": (
        TEXT.partition("\n")[0] + "\n",
        {},
        "{csv}: has no rows; expected one row for each scan after the header.",
    ),
    "text": (
        edited(TEXT, ROW, "0.0040,712.O00,-254.000,20.20,ok"),
        {},
        "{csv}, line 4, column 'AI0 (mV)': '712.O00' is invalid; expected a number, {or_leave_out} [invalid_cells] ",
    ),
    "infinite": (edited(TEXT, "712.000", "1e999"), {}, "'1e999' is invalid"),
    "lines in a cell": (edited(TEXT, "712.000", '"7\n12"'), {}, "line 5, column 'AI0 (mV)': '7 12' is invalid"),
    "underscore": (edited(TEXT, "712.000", "71_2.0"), {}, "'71_2.0' is invalid"),
    "decimal comma": (
        edited(TEXT, "712.000", '"712,0"'),
        {},
        "expected a number with a decimal point; file: {{decimal: ','",
    ),
    **{
        f"thousands {number}": (
            edited(TEXT, "712.000", f'"{number}"'),
            {},
            "expected a number without separators of th",
        )
        for number in ("712,000", "1,712.5", "1'712", "1\u202f712.5", "1.712,5")
    },
    "grouped thousands": (edited(TEXT, "712.000", '"1,712.0"'), {}, "'1,712.0' is invalid"),
    "missing": (
        edited(TEXT, "712.000", ""),
        {},
        "{csv}, line 4, column 'AI0 (mV)': the cell has no value; expected a number, {or_leave_out} [missing_cells] ",
    ),
    "NaN": (edited(TEXT, "712.000", "NaN"), {}, "line 4, column 'AI0 (mV)': the cell has no value"),
    "time goes back": (
        edited(TEXT, ROW, "0.0010,712.000,-254.000,20.20,ok"),
        {},
        "{csv}, line 4, column 'Time (s)': the time goes back by 0.001 s; expected times that increase, ",
    ),
    "time repeats": (
        edited(TEXT, ROW, "0.0020,712.000,-254.000,20.20,ok"),
        {},
        "a column with too few digits needs rate",
    ),
    "time invalid": (edited(TEXT, ROW, "x,712.000,-254.000,20.20,ok"), {}, "'x' is no time from 1970 to 2038"),
    "short row": (
        edited(TEXT, ROW, "0.0040,712.000,-254.000"),
        {},
        "{csv}, line 4: there are 3 cells; expected 5, as in the header, or leave_out: [incomplete_rows] in the map.",
    ),
    "short rows": (
        TEXT.replace(",ok", ""),
        {},
        "{csv}, line 2: there are 4 cells (and 9 more); expected 5, as in the header, or leave_out: [incomplete_rows] ",
    ),
    "long row": (edited(TEXT, ROW, ROW + ",7"), {}, "{csv}, line 4: there are 6 cells; expected 5, as in the header; "),
    "last line cut": (TEXT[:-30], {}, "line 11: there are"),
    "last cell cut": (
        edited(TEXT, "Remark", "AI0")[:-2],
        {},
        "at the end of the file is shorter than all cells above it",
    ),
    "quote open": (edited(TEXT, "712.000", '"712.000'), {}, "expected quotes in pairs"),
    "column missing": (
        edited(TEXT, "AI0 (mV)", "AI0_mV"),
        {},
        "column 'AI0 (mV)' of {map}, line 6, key joints.elbow.gap_voltages[0] is missing; expected one of 'Time (s)', ",
    ),
    "column twice": (edited(TEXT, "Remark", "AI0 (mV)"), {}, "occurs 2 times; expected its number, 2 or 5."),
    "unit of the header": (
        edited(TEXT, "AI0 (mV)", "AI0 (V)"),
        {"joints": {"elbow": {"frame_id": "plate", "gap_voltages": [{"column": "AI0 (V)", "unit": "mV"}]}}},
        "column 'AI0 (V)' is in V by the file, in mV by the map; expected unit: V, or header_unit: ignored",
    ),
    "unit of the time": (TEXT, {"time": {"column": "Time (s)", "unit": "ms", "start": START}}, "is in s by the file"),
    "no time zone": (
        TEXT,
        {"time": {"column": "Time (s)", "unit": "s", "start": "2026-11-25T10:00:00"}},
        "start '2026-11-25T10:00:00'; expected a time with its zone",
    ),
    "not UTF-8": (
        "caf\udce9\n" + TEXT,
        {},
        "{csv}, line 1: byte 3 (0xE9) is not utf-8; expected the encoding in the map",
    ),
    "zero bytes": ("\0T\0i\0m\0e", {}, "expected file: {{encoding: utf-16-be}}"),
    "Excel": ("PK\x03\x04...", {}, "{csv}: is a ZIP archive, such as a workbook of Excel; expected a CSV, "),
    "binary": ("CDF\1\0\0\0\7\2\3", {}, "{csv}: holds zero bytes; expected text, or a Parquet, TDMS or MATLAB file."),
    "zero bytes at the end": (TEXT + 9 * "\0", {}, "line 12: there are 1 cells; expected 5, as in the header"),
    "another codec": (
        "t.t\n1-.\n",
        {"file": {"encoding": "punycode"}},
        "{csv}: is not punycode; expected the encoding",
    ),
    "overload of SCPI": (edited(TEXT, "712.000", "9.9E37"), {}, "column 'AI0 (mV)': '9.9E37' is invalid"),
    "lines in a cell, decimal commas": (
        edited(csv_of(separator=";", decimal=","), "712,000", '"7\n12"'),
        {"file": {"separator": ";", "decimal": ","}},
        "column 'AI0 (mV)': '7 12' is invalid",
    ),
    "rows in quotes": (
        edited(TEXT.replace("20.20,ok", '20.20,"ok'), "20.40,ok", '20.40,ok"'),
        {},
        "{csv}, line 6: a quote opens before this line and closes in it, around whole rows; expected quotes in pairs.",
    ),
    "no names": (
        TEXT.partition("\n")[2].replace(",ok", ""),
        {},
        "{csv}, line 1: holds numbers in place of names; expected names, or file: {{header_line: 0}} in the map if ",
    ),
    "names behind #": ("# " + TEXT.replace(",ok", ""), {}, "line 2: holds numbers in place of names"),
    "names that the map skips": (
        TEXT,
        {"file": {"header_line": 0, "data_line": 2}},
        "{csv}, line 1: holds names or units, which header_line: 0 skips; expected the line of the names in the map, ",
    ),
    "another separator": (csv_of(separator=";"), {}, "; file: {{separator: ';'}} in the map if it separates "),
    "second header in another order": (
        TEXT + ",".join([NAMES[0], *NAMES[2:0:-1], *NAMES[3:]]) + "\n1,1,2,3,ok\n",
        {"leave_out": ["invalid_cells"]},
        "{csv}, line 12, column 'AI0 (mV)': another column, 'AI1 (mV)', begins; expected one header",
    ),
    "end of summer time": (
        TEXT.replace("\n0.0", "\n2026-10-25T02:30:00.0"),
        {"time": {"column": "Time (s)", "format": "iso", "time_zone": "Europe/Berlin"}},
        "summer time begins or ends in Europe/Berlin at '2026-10-25T02:30:00.0000', which is no time or two times; ",
    ),
    "nothing left": (
        edited(TEXT, "712.000", "").partition("0.0060")[0].replace("710.000", "").replace("711.000", ""),
        {"leave_out": ["missing_cells"]},
        "no row is whole",
    ),
}


def test_the_unit_of_the_time_is_that_of_the_header_unless_it_is_ignored(tmp_path: Path) -> None:
    path = tmp_path / "daq.csv"
    path.write_text(TEXT.replace("Time (s)", "time [msecs]"), encoding="utf-8")
    time = {"column": "time [msecs]", "unit": "s", "start": START}
    with pytest.raises(DataFileError, match="column 'time \\[msecs\\]' is in ms by the file, in s by the map"):
        read_table(path, write_map(tmp_path, time=time))
    check_scans(read_table(path, write_map(tmp_path, time=time | {"header_unit": "ignored"})))


def test_a_comment_that_labview_leaves_out_is_empty(tmp_path: Path) -> None:
    path, table_map = tmp_path / "daq.lvm", write_map(tmp_path)
    text = TEXT.replace("Remark", "Comment").replace(",ok", "")
    path.write_text(text, encoding="utf-8")
    check_scans(read_table(path, table_map))
    path.write_text(text.removesuffix("0\n"), encoding="utf-8")
    with pytest.raises(DataFileError, match="at the end of the file is shorter than all cells above it"):
        read_table(path, table_map)


@pytest.mark.parametrize(("last", "whole"), [("3.25e-05", 5), ("3.25e-0", 4), ("1e-05", 5), ("12.5", 5), ("none", 5)])
@pytest.mark.parametrize("end", ["", "\n"])
def test_a_cut_exponent_at_the_end_of_a_file_is_no_number(last: str, whole: int, end: str, tmp_path: Path) -> None:
    text = "t,gap\n0,1.5e-04\n1,-2e-05\n2,3e-12\n3,17\n4," + last + end
    cells = TextTable(tmp_path / "daq.csv", text, FileLayout()).read([1], [])
    assert len(cells.places) == (5 if end else whole)
    assert len(cells.incomplete) == 5 - len(cells.places)


@pytest.mark.parametrize("kind", BAD)
def test_a_doubtful_table_is_refused_in_one_sentence(kind: str, tmp_path: Path) -> None:
    text, changes, sentence = BAD[kind]
    path, table_map = tmp_path / "daq.csv", write_map(tmp_path, **changes)
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(DataFileError) as caught:
        read_table(path, table_map)
    assert sentence.format(csv=path, map=table_map, or_leave_out="or leave_out:") in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("missing_cells", edited(TEXT, "712.000", "")),
        ("invalid_cells", edited(TEXT, "712.000", "OVER")),
        ("incomplete_rows", edited(TEXT, ROW, "0.0040,712.000")),
        ("time_back", edited(TEXT, ROW, "0.0010,712.000,-254.000,20.20,ok")),
    ],
)
def test_rows_are_left_out_and_counted_if_the_map_says_so(kind: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / "daq.csv"
    path.write_text(text, encoding="utf-8")
    readings = load_readings(path, write_map(tmp_path, leave_out=[kind]))
    assert readings.left_out == {kind: 1}
    assert readings.unused == ("Remark",)
    assert len(readings.joints["elbow"].scans) == COUNT - 1


JOINT = {"frame_id": "plate", **READINGS}
WRONG_MAPS: dict[str, tuple[dict[str, Any], str]] = {
    "unknown key": ({"colums": 1}, "unknown key 'colums'"),
    "unknown unit": (
        {"joints": {"elbow": JOINT | {"temperature": {"column": 4, "unit": "degX"}}}},
        "unit 'degX' is unknown",
    ),
    "unit of another quantity": (
        {"joints": {"elbow": JOINT | {"temperature": {"column": 4, "unit": "mV"}}}},
        "key joints.elbow.temperature.unit: column '4' is in mV; expected one of degC, degF, K, mK, or a scale ",
    ),
    "scale of another quantity": (
        {
            "joints": {
                "elbow": JOINT | {"temperature": {"column": 4, "unit": "mV", "scale": {"value": 1, "unit": "K/V"}}}
            }
        },
        "scale in K/V; expected one number in K/mV.",
    ),
    "a column twice": (
        {"joints": {"elbow": JOINT | {"gap_voltages": [{"column": "AI0 (mV)", "unit": "mV"}] * 2}}},
        "column 'AI0 (mV)' is used twice, also as joints.elbow.gap_voltages[0]; expected a column of its own for each ",
    ),
    "no lit source": (
        {"joints": {"elbow": JOINT | {"diode_currents": [{"column": n, "unit": "A"} for n in range(1, 5)]}}},
        "4 diode currents and 0 lit sources",
    ),
    "no frame": ({"joints": {"elbow": READINGS}}, "neither calibration nor frame_id"),
    "no start": ({"time": {"column": "Time (s)", "unit": "s"}}, "start is missing"),
    "two times": (
        {"time": {"column": 1, "unit": "s", "format": "iso", "start": START}},
        "the time of a row does not follow",
    ),
    **{
        form: (
            {"time": {"column": 1, "format": f"%d.%m.%Y {form}", "time_zone": "UTC"}},
            f"key time.format: format '%d.%m.%Y {form}' has {what}; expected %",
        )
        for form, what in [("%H:%M %p", "%p without %I"), ("%I:%M", "%I without %p"), ("%H:%M %Z", "%Z")]
    },
    "separator": ({"file": {"separator": ".."}}, "key file.separator"),
    "pattern": (
        {"joints": {"elbow": JOINT | {"flags": {"saturated": {"column": 5, "pattern": "("}}}}},
        "expected a regular expression",
    ),
}


@pytest.mark.parametrize("kind", WRONG_MAPS)
def test_a_wrong_map_is_refused(kind: str, tmp_path: Path) -> None:
    changes, sentence = WRONG_MAPS[kind]
    with pytest.raises(CalibrationError) as caught:
        read_table(write_csv(tmp_path / "daq.csv"), write_map(tmp_path, **changes))
    assert sentence in str(caught.value)
    assert str(tmp_path / "map.yaml") in str(caught.value)


def entry(column: str | int, unit: str = "V") -> dict[str, Any]:
    return {"column": column, "unit": unit}


def write_uses(folder: Path, uses: dict[str, Any]) -> tuple[Path, Path]:
    """Write a table, and the map of joints a and b and of references r and s; ``uses`` adds keys to them."""
    table = folder / "uses.csv"
    lines = ["t,u,v,w,lit,x,y,z", *(f"{n},1,2,3,0,7,8,9" for n in range(1, 4))]
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    joints = {
        name: {"frame_id": name, "gap_voltages": [entry(gap)], **uses.get(name, {})}
        for name, gap in (("a", "u"), ("b", "v"))
    }
    references = {name: {"frame_id": "table", **uses[name]} for name in ("r", "s") if name in uses}
    time = {"column": "t", "unit": "s", "start": START}
    changes = {"joints": joints, "references": references, "number": uses.get("number")}
    return table, write_map(folder, time=time, **changes)


NUMBER = {"standard_uncertainty": {"value": 1e-6, "unit": "m"}}
RATIOS = {"x": entry("x", "1"), "y": entry(6, "1"), "total": {"value": 1.0, "unit": "A"}}
TWICE: dict[str, tuple[dict[str, Any], str]] = {
    "name and number": ({"a": {"gap_voltages": [entry("u"), entry(2)]}}, "joints.a.gap_voltages[1].column"),
    "name with a blank": ({"a": {"gap_voltages": [entry("u"), entry(" u")]}}, "joints.a.gap_voltages[1].column"),
    "two joints": ({"b": {"gap_voltages": [entry(2)]}}, "joints.b.gap_voltages[0].column"),
    "environment and reading": ({"a": {"supply_voltage": entry(3)}}, "joints.b.gap_voltages[0].column"),
    "environment of one joint": (
        {"a": {"supply_voltage": entry("w"), "reference_voltage": entry("w")}},
        "joints.a.reference_voltage.column",
    ),
    "environments of two joints": (
        {"a": {"supply_voltage": entry("w")}, "b": {"reference_voltage": entry("w")}},
        "joints.b.reference_voltage.column",
    ),
    "state and reading": ({"a": {"home_mark": entry("v", "1")}}, "joints.b.gap_voltages[0].column"),
    "ratios of a diode": ({"a": {"lit_sources": [0], "diode_ratios": [RATIOS]}}, "joints.a.diode_ratios[0].y.column"),
    "coordinates": (
        {"r": {"position": [entry("x", "m"), entry("y", "m"), entry(6, "m")]}},
        "references.r.position[2].column",
    ),
    "reading and reference": ({"r": {"reading": entry("u", "m"), **NUMBER}}, "references.r.reading.column"),
    "time and reading": ({"a": {"gap_voltages": [entry(1)]}}, "joints.a.gap_voltages[0].column"),
    "number and reading": ({"number": "w", "a": {"supply_voltage": entry(4)}}, "joints.a.supply_voltage.column"),
}


@pytest.mark.parametrize("kind", TWICE)
def test_a_column_of_two_quantities_is_refused(kind: str, tmp_path: Path) -> None:
    uses, key = TWICE[kind]
    with pytest.raises(CalibrationError, match=rf"map\.yaml, line \d+, key {re.escape(key)}: .* is used twice"):
        load_readings(*write_uses(tmp_path, uses))


def test_columns_that_a_map_may_use_several_times(tmp_path: Path) -> None:
    """Environment and states of two joints, a text of a reading, the times as scan numbers, and two references."""
    joint = {
        "supply_voltage": entry("w"),
        "home_mark": entry("lit", "1"),
        "flags": {"saturated": {"column": "u", "pattern": "OVER"}},
    }
    point = {"position": [entry(name, "m") for name in "xyz"]}
    readings = load_readings(
        *write_uses(
            tmp_path, {"number": "t", "a": joint, "b": joint, "r": point, "s": {"reading": entry("z", "m"), **NUMBER}}
        )
    )
    assert [each.scans.supply_voltages.tolist() for each in readings.joints.values()] == [[3.0] * 3] * 2
    assert readings.joints["b"].scans.numbers.tolist() == [1, 2, 3]
    assert readings.references["r"].values[:, 2].tolist() == readings.references["s"].values[:, 0].tolist() == [9.0] * 3


@pytest.mark.parametrize(
    "skipped", ["", "nan,nan,nan,nan", "OVER,OVER,OVER,OVER", "stop,stop,go,go", "begin,nan,rest,go"]
)
def test_rows_that_a_map_without_names_skips_are_no_names(skipped: str, tmp_path: Path) -> None:
    changes = WAYS["no header"][1] | {"file": {"header_line": 0, "data_line": 3}}
    path = tmp_path / "daq.csv"
    first, *rows = WAYS["no header"][0].decode().splitlines(keepends=True)
    second = f"{skipped},\n" if skipped else rows[0]
    path.write_text("".join([first, second, *rows[1:]]), encoding="utf-8")
    assert len(read_table(path, write_map(tmp_path, **changes))) == COUNT - 2


def test_words_between_blanks_are_no_names(tmp_path: Path) -> None:
    changes = WAYS["no header"][1] | {"file": {"header_line": 0, "data_line": 2, "separator": "space"}}
    path = tmp_path / "daq.csv"
    data = TEXT.partition("\n")[2].replace(",ok", "").replace(",", " ")
    path.write_text(f"measured at the lab\n{data}", encoding="utf-8")
    assert len(read_table(path, write_map(tmp_path, **changes))) == COUNT


def test_flags_references_and_lit_sources(tmp_path: Path) -> None:
    path = tmp_path / "daq.csv"
    head = "t,u,a,b,c,d,lit,light,home,state,x,y,z,qx,qy,qz,qw,laser"
    lines = [
        f"{n},0.5,{n + 1}e-5,2e-5,3e-5,4e-5,{n % 2},{int(n != 2)},{int(n == 1)},{'OVER' if n == 3 else 'ok'},"
        f"1,2,3,0,0,0,1,{n if n != 1 else ''}"
        for n in range(4)
    ]
    path.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")
    joint = {
        "frame_id": "plate",
        "gap_voltages": [{"column": "u", "unit": "V"}],
        "diode_currents": [{"column": name, "unit": "A"} for name in "abcd"],
        "lit_sources": [{"column": "lit", "unit": "1"}],
        "light": {"column": "light", "unit": "1"},
        "home_mark": {"column": "home", "unit": "1"},
        "flags": {"saturated": {"column": "state", "pattern": "OVER"}},
    }
    references: dict[str, dict[str, Any]] = {
        "laser": {
            "frame_id": "table",
            "reading": {"column": "laser", "unit": "um"},
            "standard_uncertainty": {"value": 2e-8, "unit": "m"},
            "missing": "allowed",
        },
        "cmm": {
            "frame_id": "table",
            "child_frame_id": "target",
            "position": [{"column": name, "unit": "mm"} for name in "xyz"],
            "quaternion": [{"column": f"q{name}", "unit": "1"} for name in "xyzw"],
        },
    }
    changes = {
        "time": {"column": "t", "unit": "s", "start": START},
        "joints": {"elbow": joint},
        "references": references,
    }
    readings = load_readings(path, write_map(tmp_path, **changes))
    scans = readings.joints["elbow"].scans
    assert scans.lit_sources[:, 0].tolist() == [0, 1, 255, 1]
    assert scans.at_home.tolist() == [0, 1, 0, 0]
    assert scans.statuses.tolist() == [0, 128, 0, 16]
    np.testing.assert_allclose(scans.diode_currents[1, 0], [2e-5, 2e-5, 3e-5, 4e-5])
    np.testing.assert_allclose(readings.references["laser"].values[:, 0], [0.0, np.nan, 2e-6, 3e-6])
    np.testing.assert_allclose(readings.references["cmm"].values, [[1e-3, 2e-3, 3e-3, 0, 0, 0, 1]] * 4)
    assert readings.references["laser"].topic == "/reference/laser"
    own = {key: entry for key, entry in references["laser"].items() if key != "missing"}
    for changed in ({"laser": own}, references | {"again": own}):  # who allows nothing misses nothing
        changes["references"] = changed
        with pytest.raises(DataFileError, match=r"line 3, column 'laser': the cell has no value"):
            read_table(path, write_map(tmp_path, **changes))


def test_the_maps_of_the_reference_page_are_valid(tmp_path: Path) -> None:
    page = (Path(__file__).parents[5] / "docs/reference/tables.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```yaml\n(?:# excerpt\n)?(format.*?|references.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert len(blocks) == 2
    times = re.findall(r"`(\{(?:column|rate): .*?\})`[;,| ]", page.partition("### Time")[2].partition("### Rows")[0])
    assert len(times) == 4
    for time in times:
        path = tmp_path / "map.yaml"
        path.write_text(re.sub(r"^time: .*$", f"time: {time}", "".join(blocks), flags=re.MULTILINE), encoding="utf-8")
        assert set(load_table_map(path).map.references) == {"laser", "tracker"}


def test_several_joints_need_a_name(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "daq.csv")
    joints = {
        name: {"frame_id": name, "gap_voltages": [gap]}
        for name, gap in zip("ab", READINGS["gap_voltages"], strict=True)
    }
    table_map = write_map(tmp_path, joints=joints)
    np.testing.assert_allclose(read_table(path, table_map, "b").gap_voltages[:, 0], VOLTS[:, 1], rtol=1e-12)
    for joint, sentence in (("", "the map has several joints"), ("c", "joint 'c' is not in the map")):
        with pytest.raises(ParameterError, match=sentence):
            read_table(path, table_map, joint)


@pytest.mark.parametrize("path", ["none.csv", "."])
def test_a_file_that_cannot_be_read(path: str, tmp_path: Path) -> None:
    with pytest.raises(PosorError, match="cannot be read"):
        read_table(tmp_path / path, write_map(tmp_path))


@pytest.mark.parametrize(
    ("text", "whole"),
    [("a\n1\n2\n", "a\n1\n2\n"), ("a\n1\n2", "a\n1\n"), ("a\r1\r2", "a\r1\r"), ("a\n\u00e9", "a\n"), ("a", "")],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-be", "utf-8-sig", "utf-32"])
def test_the_last_line_of_a_growing_file_counts_when_it_has_an_end(text: str, whole: str, encoding: str) -> None:
    data = text.encode(encoding)
    assert decode(data, encoding, "file", growing=True) == whole
    if not whole.endswith(text[-1]):
        assert decode(data[:-1], encoding, "file", growing=True) == whole  # within a character
