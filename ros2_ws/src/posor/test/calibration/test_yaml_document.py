# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibration files as YAML: what is none and is refused, and the ways in which a number may be written."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import yaml
from posor.calibration.calibration_file import load_calibration
from posor.calibration.document_text import document_text
from posor.calibration.file_model import TEXT, FrozenModel
from posor.calibration.yaml_document import load_document, parse_yaml
from posor.errors import CalibrationError
from posor_lab.harness.case_tables import cases, edited, refusal
from pydantic import Field

from .calibration_content import PROBE, write, zero_shifts

ALIAS_BOMB = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 10))
SHIFT = "zero_shift: {value: 0.0, unit: V}"


@pytest.mark.parametrize(**cases(__file__, "not_yaml.yaml"))
def test_text_that_is_not_a_yaml_mapping_is_refused(text: str, line: int, says: str, file: Path) -> None:
    file.write_text(text, encoding="utf-8")
    error = refusal(CalibrationError, load_calibration, file)
    assert str(error).startswith(f"{file}, line {line}: {says}")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("[" * 5000, "is not YAML: it is nested too deeply"),
        (ALIAS_BOMB, "is not YAML: with its aliases expanded it has more than 200000 entries"),
    ],
    ids=["very deep", "alias bomb"],
)
def test_text_that_would_fill_the_memory_is_refused(text: str, what: str, file: Path) -> None:
    file.write_text(text, encoding="utf-8")
    assert refusal(CalibrationError, load_calibration, file).what == what


@pytest.mark.parametrize("key", ["name: slocum1985_printed\n", f"{SHIFT}\n"], ids=["at the top", "in a probe"])
def test_a_duplicate_key_is_refused(key: str, rig_calibrations: dict[str, Path], file: Path) -> None:
    """YAML readers take the last one without a word: the first may be the one that its author looks at."""
    before, line, after = rig_calibrations["printed"].read_text(encoding="utf-8").partition(key)
    indent = before.rpartition("\n")[2]
    file.write_text(before + line + indent + line + after, encoding="utf-8")
    first, name = before.count("\n") + 1, key.partition(":")[0]
    error = refusal(CalibrationError, load_calibration, file)
    assert error.where == f"{file}, line {first + 1}"
    assert error.what == f"is not YAML: duplicate key '{name}', also in line {first}"


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        ("010", "a number, without leading zeros, octal as 0o17"),
        ("1:30", "a number, without colons, which YAML 1.1 reads as base 60"),
        ("1e5e5", "a number"),
        ("'0x1F'", "a number"),
    ],
)
def test_ambiguous_numbers_are_refused(
    number: str, expected: str, rig_calibrations: dict[str, Path], file: Path
) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    file.write_text(edited(text, SHIFT, SHIFT.replace("0.0", number)), encoding="utf-8")
    error = refusal(CalibrationError, load_calibration, file)
    line = text.partition(SHIFT)[0].count("\n") + 1
    assert error.where == f"{file}, line {line}, key {PROBE}.zero_shift.value"
    assert error.what.strip("'") == number.strip("'")
    assert error.expected == expected


@pytest.mark.parametrize(
    ("number", "hint"),
    [
        *(
            (text, "decimal point")
            for text in ("1,5", "'1,5'", "'1,5 mm'", "|\n    1,5\n    2,5", ">-\n    -1,5", "'[1,5, 2]'")
        ),
        *((text, "hexadecimal as 0x1F") for text in ("0XAA55", "AA55h", "0AA55H", "$AA55")),
        *[("1 000", "underscores"), ("\N{MINUS SIGN}1", "minus sign")],
    ],
)
def test_a_number_of_other_notations_is_refused_with_the_right_one(number: str, hint: str, file: Path) -> None:
    file.write_text(f"format: x\nversion: 1\nnumber:\n  {number}\n", encoding="utf-8")

    class OneNumber(FrozenModel):
        format: str
        version: int
        number: Annotated[float, Field(strict=True)]

    error = refusal(CalibrationError, load_document, file, "file", "number", 1, OneNumber.model_validate)
    assert error.where == f"{file}, line 3, key number"
    assert hint in error.expected


def test_a_document_of_another_format_is_named_before_its_version(file: Path) -> None:
    class Document(FrozenModel):
        format: Literal["posor_scenario"]
        version: int

    file.write_text("format: posor_beams\nversion: 2\n", encoding="utf-8")
    error = refusal(CalibrationError, load_document, file, "file", "format", 1, Document.model_validate)
    assert (error.where, "posor_scenario" in error.expected) == (f"{file}, line 1, key format", True)
    file.write_text("format: posor_scenario\nversion: 2\n", encoding="utf-8")
    error = refusal(CalibrationError, load_document, file, "file", "format", 1, Document.model_validate)
    assert error.where == f"{file}, line 2, key version"


@pytest.mark.parametrize(
    ("text", "content"),
    [
        ("[0,5]", [0, 5]),
        ("[1,2,3, 4,5,6]", [1, 2, 3, 4, 5, 6]),
        ("[1, 2,\n 3]", [1, 2, 3]),
        ("[a,b, 0.5,1]", ["a", "b", 0.5, 1]),
        ("[[1,2], [3,4]]", [[1, 2], [3, 4]]),
        ("{a: 1, 5: , b: }", {"a": 1, "5": None, "b": None}),
    ],
)
def test_lists_and_mappings_without_decimal_commas_are_read(text: str, content: object) -> None:
    assert parse_yaml(text, "text")[1] == content


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("0xaa55", 0xAA55),
        ("-0x1f", -0x1F),
        ("0x12_34", 0x1234),
        ("0o17", 0o17),
        ("0b1_01", 0b101),
        ("1_000", 1000),
        ("1_000.5", 1000.5),
        ("+1.5", 1.5),
        (".5", 0.5),
        ("1e-6", 1e-6),
        ("1E-6", 1e-6),
        ("-.INF", -math.inf),
        *((text, True) for text in ("true", "True", "yes", "on", "ON")),
        *((text, False) for text in ("false", "no", "Off")),
        *((text, text) for text in ("y", "n", "=", "010", "12:30:00", "1__0", "2026-11-25", "2026-11-25 12:00:00")),
    ],
)
def test_scalars_mean_what_their_author_expects(written: str, read: object) -> None:
    content = parse_yaml(f"a: {written}", "text")[1]
    assert content == {"a": read}
    assert isinstance(content, dict)
    assert type(content["a"]) is type(read)
    assert yaml.safe_load(document_text({"a": written}, "")) == {"a": written}, "text stays text for other readers"
    assert parse_yaml(document_text({"a": written}, ""), "text")[1] == {"a": written}


def test_keys_are_text() -> None:
    text = "on: 1\n1985: 2\n2026-11-25: 3\n<<: {no: 4}\n"
    assert parse_yaml(text, "text")[1] == {"no": 4, "on": 1, "1985": 2, "2026-11-25": 3}


def test_a_truth_value_for_text_is_named_as_it_is_written(rig_calibrations: dict[str, Path], file: Path) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    file.write_text(edited(text, "name: slocum1985_printed", "name: no"), encoding="utf-8")
    error = refusal(CalibrationError, load_calibration, file)
    assert (error.what, error.expected) == ("no without quotes", TEXT)


def test_a_date_needs_no_quotes(rig_calibrations: dict[str, Path], file: Path) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    file.write_text(re.sub(r"(?m)^  date: .*$", "  date: 2026-11-25", text), encoding="utf-8")
    assert load_calibration(file).provenance.date == "2026-11-25"


@pytest.mark.parametrize("number", ["1", "+1", "1.", "1.0", "1e0", "0.1e+1", "10E-1", ".1e1", "0x1", "0o1", "0b1"])
def test_all_notations_of_decimals_are_read(number: str, rig_calibrations: dict[str, Path], file: Path) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    file.write_text(edited(text, SHIFT, SHIFT.replace("0.0", number)), encoding="utf-8")
    assert zero_shifts(load_calibration(file))[0] == 1.0


def test_an_anchor_gives_one_value_to_several_keys(rig_calibrations: dict[str, Path], file: Path) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    span = "range: {value: [-0.6, 1.2], unit: V}"
    assert text.count(span) > 1
    first, _, rest = text.partition(span)
    named = first + "range: &span {value: [-0.6, 1.2], unit: V}" + rest.replace(span, "range: *span")
    file.write_text(named, encoding="utf-8")
    assert load_calibration(file).content_hash == load_calibration(rig_calibrations["printed"]).content_hash


def test_a_power_of_ten_without_a_point_is_a_number(content: Any, file: Path) -> None:
    text = write(file, content).replace("value: 2.0e-05", "value: 2e-5")
    assert "value: 2e-5" in text
    file.write_text(text, encoding="utf-8")
    assert load_calibration(file).sensors[1].diodes[0].minimum_sum.number == 2e-5  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("bytes_", "what"),
    [
        (bytes(range(256)), "not UTF-8 text"),
        (b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", "not UTF-8 text"),
        ("format: posor_calibration\n".encode("utf-16"), "not UTF-8 text"),
        (None, "No such file or directory"),
    ],
    ids=["every byte", "a picture", "UTF-16", "missing"],
)
def test_a_file_that_cannot_be_read_is_refused(bytes_: bytes | None, what: str, file: Path) -> None:
    if bytes_ is not None:
        file.write_bytes(bytes_)
    assert str(refusal(CalibrationError, load_calibration, file)) == (
        f"calibration file {file}: cannot be read: {what}; expected a YAML calibration file."
    )


def test_folders_and_pipes_are_refused_at_once(file: Path) -> None:
    os.mkfifo(file)
    for path, what in ((file, "a pipe or device, not a file"), (file.parent, "Is a directory")):
        assert refusal(CalibrationError, load_calibration, path).what == f"cannot be read: {what}"


def test_a_byte_order_mark_is_accepted(rig_calibrations: dict[str, Path], file: Path) -> None:
    file.write_bytes(b"\xef\xbb\xbf" + rig_calibrations["printed"].read_bytes())
    assert load_calibration(file).content_hash == load_calibration(rig_calibrations["printed"]).content_hash
