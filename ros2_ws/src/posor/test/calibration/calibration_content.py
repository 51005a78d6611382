# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A calibration file as plain data: its parts by key path, and its text."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from posor.calibration.edit import parse_key_path

PROBE = "sensors[0].probes[0]"


def at(content: Any, key: str) -> Any:
    for part in parse_key_path(key):
        content = content[part]
    return content


def write(file: Path, content: Any) -> str:
    text: str = yaml.dump(content, Dumper=yaml.CSafeDumper, sort_keys=False)
    file.write_text(text, encoding="utf-8")
    return text


def zero_shifts(calibration: Any) -> list[float]:
    return [probe.zero_shift.number for probe in calibration.sensors[0].probes]
