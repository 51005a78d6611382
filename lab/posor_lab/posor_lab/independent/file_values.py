# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files read by PyYAML alone, and their quantities in SI units."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

FACTORS = {"mm": ("m", 1e-3), "um": ("m", 1e-6), "deg": ("rad", math.pi / 180.0)}
"""Units of files besides those of SI: the SI unit, and how much of it they are."""
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_NUMBER = re.compile(r"\s*([-+.0-9eE]+)\s*([A-Za-z]*)\s*")


def read_file(path: Path | str) -> Any:
    """Return the content of a YAML file."""
    with open(path, encoding="utf-8") as file:  # noqa: PTH123  a path or the text of one
        return yaml.load(file, Loader=_LOADER)  # noqa: S506  safe, and faster with libyaml


def si_values(entry: dict[str, Any], unit: str) -> NDArray[np.float64]:
    """Return the value of a quantity ``{value, unit}`` in an SI unit.

    Raises ValueError: the quantity has another unit.
    """
    own, factor = FACTORS.get(entry["unit"], (entry["unit"], 1.0))
    if own != unit:
        what = f"quantity {entry} has the unit '{entry['unit']}'; expected '{unit}'"
        raise ValueError(what)
    return np.array(_convert(entry["value"], unit, factor), dtype=float)


def _convert(raw: Any, unit: str, factor: float) -> Any:
    """Return numbers, lists of numbers, and texts such as ``20 mm`` or ``1e-3``, in an SI unit."""
    if isinstance(raw, list):
        return [_convert(each, unit, factor) for each in raw]
    if not isinstance(raw, str):
        return raw * factor
    match = _NUMBER.fullmatch(raw)
    if match is None or (match[2] and FACTORS.get(match[2], (match[2], 1.0))[0] != unit):
        what = f"'{raw}' is not a number in '{unit}'"
        raise ValueError(what)
    return float(match[1]) * (FACTORS.get(match[2], ("", 1.0))[1] if match[2] else factor)
