"""A calibration file as plain data: where its parts stand, how a test changes them, and the refusal that follows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
import yaml
from posor.calibration.calibration_file import load_calibration
from posor.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

Key = tuple[str | int, ...]

PROBE: Key = ("sensors", 0, "probes", 0)
DIODES: Key = ("sensors", 1)
SESSION: Key = ("sessions", "ymo")


def at(content: Any, key: Key) -> Any:
    for part in key:
        content = content[part]
    return content


def put(value: Any, *key: str | int) -> Callable[[Any], None]:
    def edit(content: Any) -> None:
        at(content, key[:-1])[key[-1]] = value

    return edit


def drop(*key: str | int) -> Callable[[Any], None]:
    def edit(content: Any) -> None:
        del at(content, key[:-1])[key[-1]]

    return edit


def rename(new: str, *key: str | int) -> Callable[[Any], None]:
    """Return the edit that gives a key another name and leaves it where it is."""

    def edit(content: Any) -> None:
        mapping = at(content, key[:-1])
        entries = [(new if name == key[-1] else name, value) for name, value in mapping.items()]
        mapping.clear()
        mapping.update(entries)

    return edit


def written(key: Key) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in key).lstrip(".")


def write(file: Path, content: Any) -> str:
    text: str = yaml.dump(content, Dumper=yaml.CSafeDumper, sort_keys=False)
    file.write_text(text, encoding="utf-8")
    return text


def refusal(file: Path) -> str:
    with pytest.raises(CalibrationError) as caught:
        load_calibration(file)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert sentence.endswith(".")
    return sentence


def zero_shifts(calibration: Any) -> list[float]:
    return [probe.zero_shift.number for probe in calibration.sensors[0].probes]
