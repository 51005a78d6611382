# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a calibration that are in another unit, or contradict one another."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from posor.calibration.calibration_file import load_calibration
from posor.errors import CalibrationError

RIG = Path(__file__).resolve().parents[3] / "posor_bringup/arms/test_rig/calibrations/joint1.yaml"
PROBE = ("sensors", 0, "probes", 1)
MISTAKES: list[tuple[tuple[Any, ...], Any, str]] = [
    ((*PROBE, "temperature", "reference", "value"), 20.0, "in degrees Celsius"),
    ((*PROBE, "temperature", "reference", "value"), 350.0, "expected 283.15 to 303.15, the range of 'environment'"),
    ((*PROBE, "supply", "reference", "value"), 15000.0, "expected 14.5 to 15.5, the range of 'environment'"),
    ((*PROBE, "supply", "sensitivity", "value"), 20.0, "in um/V"),
    ((*PROBE, "temperature", "sensitivity", "value"), 0.2, "in um/K"),
    (("environment", "temperature", "range", "value"), [10.0, 30.0], "in degrees Celsius"),
    (("environment", "temperature", "spread", "value"), 293.15, "expected at most the width of the range, 20 K"),
    ((*PROBE, "tip", "value"), [0.0, 38.1, 0.0], "tip 38.1 m; expected -1 to 1 m (in mm or "),
    ((*PROBE, "tip", "value"), [0.0, 1.5, 0.0], "(in mm or in inches?)"),
    ((*PROBE, "volts_to_gap", "value"), [0.735, -0.1, 0.0, 0.0, 0.0], "volts_to_gap is 1.335 m at -6 V; expected "),
    (("sensors", 0, "target_plane", "point", "value"), [0.0, 0.0, 5.0], "point 5 m; expected -1 to 1 m (in mm"),
    (("sensors", 1, "diodes", 0, "origin", "value"), [-25.4, 38.1, -2.0], "origin -25.4 m; expected "),
    (("sensors", 1, "light_sources", 1, "origin", "value"), [-25.4, 38.1, 0.4], "origin -25.4 m; expected "),
]


@pytest.mark.parametrize(("key", "value", "sentence"), MISTAKES)
def test_a_number_that_cannot_be_in_its_unit_is_refused(
    tmp_path: Path, key: tuple[Any, ...], value: float, sentence: str
) -> None:
    content = yaml.safe_load(RIG.read_text(encoding="utf-8"))
    place = content
    for part in key[:-1]:
        place = place[part]
    place[key[-1]] = value
    path = tmp_path / "joint1.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(CalibrationError) as caught:
        load_calibration(path)
    assert sentence in str(caught.value)
