# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The one sentence for each mistake in a calibration file: file, line, key and what is expected."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from posor.calibration.calibration_file import calibration_from, load_calibration
from posor.calibration.edit import parse_key_path
from posor.calibration.file_model import first_problem
from posor.errors import CalibrationError
from posor_lab.harness.case_tables import cases, refusal
from pydantic import ValidationError

from .calibration_content import PROBE, at, write


def line_of(text: str, key: str) -> int:
    """Return the line in which a key (or an entry of a list) begins."""
    node: Any = yaml.compose(text, Loader=yaml.CSafeLoader)
    line = 1
    for part in parse_key_path(key) if key else ():
        if isinstance(part, int):
            node = node.value[part]
            line = node.start_mark.line + 1
        else:
            [(name, node)] = [entry for entry in node.value if entry[0].value == part]
            line = name.start_mark.line + 1
    return line


def change(content: Any, edit: str, key: str, value: Any) -> None:
    """Put a value, drop an entry, or rename an entry in its place."""
    *way, last = parse_key_path(key)
    for part in way:
        content = content[part]
    if edit == "put":
        content[last] = value
    elif edit == "drop":
        del content[last]
    else:
        entries = [(value if name == last else name, entry) for name, entry in content.items()]
        content.clear()
        content.update(entries)


@pytest.mark.parametrize(**cases(__file__, "mistakes.yaml"))
def test_a_mistake_is_named_with_file_line_key_and_what_is_expected(
    edit: str, place: str, value: Any, key: str, says: str, content: Any, file: Path
) -> None:
    change(content, edit, place, value)
    text = write(file, content)
    error = refusal(CalibrationError, load_calibration, file)
    assert error.where == f"{file}, line {line_of(text, key)}{f', key {key}' if key else ''}"
    assert str(error) == f"{error.where}: {says}."


@pytest.mark.parametrize("where", ["", "sessions", PROBE])
def test_a_key_that_is_not_text_is_refused(where: str, content: Any) -> None:
    """The keys of a file are text, but not those of a mapping in memory."""
    (at(content, where) if where else content)[1985] = {"note": "x"}
    with pytest.raises(ValidationError) as caught:
        calibration_from(content)
    problem = first_problem(caught.value)
    assert (problem.what, problem.location[-1]) == ("key 1985 is not text", 1985)


def test_the_first_of_several_mistakes_is_named(content: Any, file: Path) -> None:
    for edit, key, value in (("put", "noise.unit", "mV"), ("drop", "tip", None)):
        change(content, edit, f"{PROBE}.{key}", value)
    text = write(file, content)
    error = refusal(CalibrationError, load_calibration, file)
    assert error.where.startswith(f"{file}, line ")
    assert error.where in {f"{file}, line {line_of(text, key)}, key {key}" for key in (PROBE, f"{PROBE}.noise.unit")}
