"""Calibration files as YAML: what is none and is refused, and the ways in which a number may be written."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import pytest
from posor.calibration.calibration_file import load_calibration

from .calibration_content import PROBE, refusal, write, written, zero_shifts

if TYPE_CHECKING:
    from pathlib import Path

ALIAS_BOMB = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 10))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "line 1: is not a mapping; expected format, version, name, provenance, frames, sensors."),
        ("# a comment\n", "line 1: is not a mapping; expected format, version, name, provenance, frames, sensors."),
        ("- 1\n- 2\n", "line 1: is not a mapping; expected format, version, name, provenance, frames, sensors."),
        ("just text\n", "line 1: is not a mapping; expected format, version, name, provenance, frames, sensors."),
        (
            "format: [posor_calibration\nversion: 1\n",
            "line 2: is not YAML: while parsing a flow sequence, expected ',' or ']', but got ':'.",
        ),
        (
            "format: x\nversion:\n\t1\n",
            (
                "line 3: is not YAML: while scanning for the next token, "
                "found character '\\t' that cannot start any token."
            ),
        ),
        (
            "version: 1\n---\nversion: 1\n",
            "line 2: is not YAML: expected a single document in the stream, but found another document.",
        ),
        ("format: x\nversion: 1\nname: a\x00b\n", "line 3: is not YAML: it contains the control character 0x00."),
        ("format: x\nformat: y\n", "line 2: is not YAML: duplicate key 'format', also in line 1."),
        ("version: 1\nname: &a [*a]\n", "line 2: is not YAML: alias 'a' is inside its own anchor."),
        ("version: !!bool maybe\n", "line 1: is not YAML: 'maybe' does not fit the tag tag:yaml.org,2002:bool."),
        ("name: !!python/name:os.system\n", "line 1: is not YAML: could not determine a constructor for the tag"),
        ("? [a, b]\n: c\n", "line 1: is not YAML: while constructing a mapping, found unhashable key."),
        ("date: 2020-99-99\n", "line 1: is not YAML: month must be in 1..12."),
        ("[" * 5000, "line 1: is not YAML: it is nested too deeply."),
        (ALIAS_BOMB, "line 6: is not YAML: with its aliases expanded it has more than 200000 entries."),
    ],
    ids=[
        *("empty", "comment only", "list", "text", "open bracket", "tab", "two documents", "control character"),
        *("key twice", "endless", "text that its tag does not allow", "Python object", "list as a key"),
        *("impossible date", "very deep", "alias bomb"),
    ],
)
def test_text_that_is_not_a_yaml_mapping_is_refused(text: str, says: str, file: Path) -> None:
    file.write_text(text, encoding="utf-8")
    sentence = refusal(file)
    assert sentence.startswith(f"{file}")
    assert says in sentence


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("name: slocum1985_printed\n", "name: another\n"),
        ("zero_shift: {value: 0.0, unit: V}\n", "zero_shift: {value: 9.0, unit: V}\n"),
    ],
    ids=["at the top", "in a probe"],
)
def test_a_duplicate_key_is_refused(key: str, text: str, rig_calibrations: dict[str, Path], file: Path) -> None:
    """YAML readers take the last one without a word: the first may be the one that its author looks at."""
    original = rig_calibrations["printed"].read_text(encoding="utf-8")
    before, line, after = original.partition(key)
    assert line
    indent = before.rpartition("\n")[2]
    file.write_text(before + line + indent + text + after, encoding="utf-8")
    first = before.count("\n") + 1
    name = key.partition(":")[0]
    assert refusal(file) == f"{file}, line {first + 1}: is not YAML: duplicate key '{name}', also in line {first}."


@pytest.mark.parametrize("number", ["010", "1:30", "0x1F", "1_000", "1e5e5"])
def test_ambiguous_numbers_are_refused(number: str, rig_calibrations: dict[str, Path], file: Path) -> None:
    """YAML 1.1 reads 010 as 8 and 1:30 as 90."""
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    shift = "zero_shift: {value: 0.0, unit: V}"
    line = text.partition(shift)[0].count("\n") + 1
    file.write_text(text.replace(shift, f"zero_shift: {{value: {number}, unit: V}}", 1), encoding="utf-8")
    key = written((*PROBE, "zero_shift", "value"))
    assert refusal(file) == f"{file}, line {line}, key {key}: '{number}'; expected a number."


@pytest.mark.parametrize("number", ["1", "+1", "1.", "1.0", "1e0", "0.1e+1", "10E-1", ".1e1"])
def test_all_notations_of_decimals_are_read(number: str, rig_calibrations: dict[str, Path], file: Path) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    shift = "zero_shift: {value: 0.0, unit: V}"
    file.write_text(text.replace(shift, f"zero_shift: {{value: {number}, unit: V}}", 1), encoding="utf-8")
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
    "rubbish",
    [bytes(range(256)), b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", "format: posor_calibration\n".encode("utf-16")],
    ids=["every byte", "a picture", "UTF-16"],
)
def test_binary_data_is_refused(rubbish: bytes, file: Path) -> None:
    file.write_bytes(rubbish)
    assert refusal(file) == (
        f"calibration file {file}: cannot be read: not UTF-8 text; expected a YAML calibration file."
    )


def test_a_byte_order_mark_is_accepted(rig_calibrations: dict[str, Path], file: Path) -> None:
    file.write_bytes(b"\xef\xbb\xbf" + rig_calibrations["printed"].read_bytes())
    assert load_calibration(file).content_hash == load_calibration(rig_calibrations["printed"]).content_hash


def test_a_missing_file_is_refused(file: Path) -> None:
    assert refusal(file) == (
        f"calibration file {file}: cannot be read: No such file or directory; expected a YAML calibration file."
    )


def test_a_folder_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path) == (
        f"calibration file {tmp_path}: cannot be read: Is a directory; expected a YAML calibration file."
    )


def test_a_pipe_is_refused_at_once(file: Path) -> None:
    os.mkfifo(file)
    assert refusal(file) == (
        f"calibration file {file}: cannot be read: a pipe or device, not a file; expected a YAML calibration file."
    )
