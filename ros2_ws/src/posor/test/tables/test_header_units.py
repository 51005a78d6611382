# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Units in the header of a table: every spelling is known, and one that contradicts the map is refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from posor import DataFileError, read_table
from posor.tables.table_readings import load_readings
from posor.tables.table_units import UNITS, unit_in_name, unknown_unit_in_name
from posor_lab.harness.case_tables import edited

from .sample_files import START, write_map

UNITS_OF_NAMES = {
    "AI0 (mV)": "mV",
    "AI0 [Volts] filtered": "V",
    "(uA) I0": "uA",
    "AI0 (mVDC)": "mV",
    "AI0 (V DC)": "V",
    "AI0 (mv)": "mV",
    "AI0 (millivolts)": "mV",
    "AI0/V": "V",
    "U / mV": "mV",
    "Spannung in V": "V",
    "gap, mV": "mV",
    "gap_mV": "mV",
    "time_s": "s",
    "E (V/m)": None,
    "E V/m": None,
    "status n/a": None,
    "thermocouple_K": None,  # a type
    "diode 1_A": None,  # a contact
    "diode 1, A": None,
    "temperature_min": None,
    "Dev1/ai0": None,
    "AI0 (channel 1)": None,
    "/arm/elbow/raw/gap_voltages[1]": None,  # an index
    "/arm/s": None,  # a path
    "AI0/min": None,
    "AI0 / min": "min",
    "speed m/s": None,
    **dict.fromkeys(("t [msecs]", "time_msec", "t (milliseconds)", "time ms"), "ms"),
    **dict.fromkeys(("t_sec", "t (sec.)", "t [secs]", "t [s since start]"), "s"),
    **dict.fromkeys(("AI0 [mVolt]", "AI0 [mV rms]", "AI0 (mV, filtered)", "AI0 mV", "AI0,mV"), "mV"),
    **dict.fromkeys(("x [micron]", "x [microns]", "x (Micrometers)"), "um"),
    **dict.fromkeys(("laser_inches", "laser_inch", "x [in.]", "x [Zoll]"), "in"),
    **dict.fromkeys(("x [uin]", "x [\N{MICRO SIGN}in]", "x [micro-inches]"), "uin"),
    **dict.fromkeys(("x (thou)", "x [mils]"), "mil"),
    **dict.fromkeys(("T [deg C]", "T (deg. C)", "T [degrees Celsius]", "temp_C", "temperature C"), "degC"),
    **dict.fromkeys(("T [deg F]", "temp_F"), "degF"),
    **dict.fromkeys(("angle_degrees", "a (Deg)", "a_deg"), "deg"),
    **dict.fromkeys(("a [arc sec]", "a [arc-seconds]"), "arcsec"),
    "x [ft]": "ft",
    "x [MM]": "mm",
    "x [\N{LATIN CAPITAL LETTER A WITH RING ABOVE}]": "angstrom",
    "a [mdeg]": "mdeg",
    "a [gon]": "gon",
    "a [mas]": "mas",
    "gap (probe 1)": None,
    "x [target]": None,
    "AI (IN)": None,  # an input
    "motor (in use)": None,
    "diode_1_C": None,
    "temp_A": None,
    "clock_second": None,  # of a time of day
    "charge amp": None,  # an instrument
    "plate_v": None,  # an axis
}
UNKNOWN_UNITS = {
    "x [cubit]": "cubit",
    "a (grad)": "grad",  # gon, or the degree in German
    'a ["]': '"',  # an arc second or an inch
    "x [target]": "target",
    "x [1/100 mm]": "1/100 mm",
    **dict.fromkeys(("gap (probe 1)", "I (CH1)", "AI0 (Dev1/ai0)", "gap(:,2)", "x[3]", "x (+)", "AI0 (mV)", "AI0"), ""),
}


@pytest.mark.parametrize(("name", "unit"), UNITS_OF_NAMES.items())
def test_the_unit_in_the_name_of_a_column_is_found(name: str, unit: str | None) -> None:
    found = unit_in_name(name)
    assert (found and (found.si, found.factor)) == (unit and (UNITS[unit].si, UNITS[unit].factor))


@pytest.mark.parametrize(("name", "text"), UNKNOWN_UNITS.items())
def test_an_unknown_unit_in_the_name_of_a_column_is_found(name: str, text: str) -> None:
    assert unknown_unit_in_name(name) == text


def table_of_one_gap(folder: Path, header: str, unit: str = "", **entry: str) -> tuple[Path, Path]:
    """Write a table whose gap has a header, with a line of units below it, and its map in volts."""
    path = folder / "daq.csv"
    path.write_text(f"t,{header},u\n" + f"s,{unit},V\n" * bool(unit) + "0,1,1\n1,2,1\n", encoding="utf-8")
    gap = {"column": 2, "unit": "V", **entry}
    time = {"column": "t", "unit": "s", "start": START}
    changes: dict[str, Any] = {"file": {"data_line": 3}} if unit else {}
    joints = {"elbow": {"frame_id": "plate", "gap_voltages": [gap]}}
    return path, write_map(folder, time=time, joints=joints, **changes)


@pytest.mark.parametrize(
    ("header", "unit", "stated"),
    [
        ("gap [mVolt]", "", "mV"),
        ("gap [mV rms]", "", "mV"),
        ("gap (V/m)", "", "V/m"),
        ("gap [1/100 mV]", "", "1/100 mV"),
        ("gap", "counts", "counts"),
    ],
)
def test_a_unit_of_the_header_that_is_not_that_of_the_map_is_refused(
    header: str, unit: str, stated: str, tmp_path: Path
) -> None:
    with pytest.raises(DataFileError, match=f"'{re.escape(header)}' is in {re.escape(stated)} by the file, in V by "):
        read_table(*table_of_one_gap(tmp_path, header, unit))
    ignored = load_readings(*table_of_one_gap(tmp_path, header, unit, header_unit="ignored"))
    assert not any("known unit" in note for note in ignored.notes)


@pytest.mark.parametrize(("header", "notes"), [("gap [target]", 1), ("gap [cubit]", 1), ("gap (probe 1)", 0)])
def test_a_text_in_brackets_that_may_be_a_unit_is_noted(header: str, notes: int, tmp_path: Path) -> None:
    found = [note for note in load_readings(*table_of_one_gap(tmp_path, header)).notes if "known unit" in note]
    assert len(found) == notes
    assert all(f"in the name of column '{header}' is not a known unit: the map says V" in note for note in found)


def test_a_map_may_spell_a_unit_in_another_way(tmp_path: Path) -> None:
    path, table_map = table_of_one_gap(tmp_path, "gap (V)")
    table_map.write_text(edited(table_map.read_text(encoding="utf-8"), "unit: V", "unit: volts"), encoding="utf-8")
    assert len(read_table(path, table_map)) == 2
