"""The one sentence for each mistake in a calibration file: file, line, key and what is expected."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
import yaml
from posor.calibration.calibration_file import load_calibration
from posor.errors import CalibrationError

from .calibration_content import DIODES, PROBE, Key, drop, put, refusal, write, written
from .calibration_mistakes import WRONG

if TYPE_CHECKING:
    from pathlib import Path


def line_of(text: str, key: Key) -> int:
    """Return the line in which a key (or an entry of a list) begins."""
    node: Any = yaml.compose(text, Loader=yaml.CSafeLoader)
    line = 1
    for part in key:
        if isinstance(part, int):
            node = node.value[part]
            line = node.start_mark.line + 1
        else:
            [(name, node)] = [entry for entry in node.value if entry[0].value == part]
            line = name.start_mark.line + 1
    return line


@pytest.mark.parametrize("mistake", WRONG)
def test_a_mistake_is_named_with_file_line_key_and_what_is_expected(mistake: str, content: Any, file: Path) -> None:
    wrong = WRONG[mistake]
    wrong.edit(content)
    text = write(file, content)
    key = f", key {written(wrong.key)}" if wrong.key else ""
    line = line_of(text, wrong.key)
    assert refusal(file) == f"{file}, line {line}{key}: {wrong.says}."


@pytest.mark.parametrize("where", [(), ("sessions",), PROBE], ids=["top", "sessions", "probe"])
def test_a_key_that_is_not_text_is_refused(where: Key, content: Any, file: Path) -> None:
    """A session of the year 1985, say, needs quotes."""
    put({"note": "x"}, *where, 1985)(content)
    lines = write(file, content).splitlines()
    [line] = [number for number, text in enumerate(lines, 1) if text.strip() == "1985:"]
    assert refusal(file) == (
        f"{file}, line {line}, key {written((*where, '1985'))}: key 1985 is not text; "
        "expected text, in quotes where YAML would read something else."
    )


def test_the_first_of_several_mistakes_is_named(content: Any, file: Path) -> None:
    put("mV", *PROBE, "noise", "unit")(content)
    drop(*PROBE, "tip")(content)
    put("C", *DIODES, "map")(content)
    write(file, content)
    assert refusal(file).startswith(f"{file}, line ")


def test_errors_keep_their_parts(content: Any, file: Path) -> None:
    put("mV", *PROBE, "zero_shift", "unit")(content)
    write(file, content)
    with pytest.raises(CalibrationError) as caught:
        load_calibration(file)
    error = caught.value
    assert (error.what, error.expected) == ("unit 'mV'", "'V'")
    assert error.where.startswith(f"{file}, line ")
