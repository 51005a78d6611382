# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The examples of docs/reference/sensors.md and docs/how_to/adding_a_sensor.md are valid, and the named files exist."""

from __future__ import annotations

import re
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest
import yaml
from posor.calibration.calibration_file import calibration_from
from posor.estimation.sensor_stack import Stack
from posor.sensors.bumpy_ring import BumpyRing
from posor.sensors.registry import sensor_types

ROOT = Path(__file__).resolve().parents[1]
SENSORS = (ROOT / "docs" / "reference" / "sensors.md").read_text(encoding="utf-8")
ADDING = (ROOT / "docs" / "how_to" / "adding_a_sensor.md").read_text(encoding="utf-8")
EXAMPLE = ROOT / "examples" / "posor_draw_wire"


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


EXAMPLES = [block for block in blocks(SENSORS, "yaml") if "- type: " in block]


def stack_of(block: str, **changes: object) -> Stack:
    [sensor] = yaml.safe_load(block)
    calibration = calibration_from(
        {
            "format": "posor_calibration",
            "version": 1,
            "name": "docs",
            "provenance": {"source": "docs/reference/sensors.md", "method": "example", "date": "none"},
            "frames": {"parent": "receiving", "child": "target"},
            "sensors": [{**sensor, **changes}],
        }
    )
    return Stack([part.build() for part in calibration.sensors])


def test_every_built_in_type_has_an_example() -> None:
    shown = [yaml.safe_load(block)[0]["type"] for block in EXAMPLES]
    ours = [name for name, found in sensor_types().items() if found.__module__.startswith("posor.")]
    assert sorted(shown) == sorted(ours)
    for name in shown:
        assert f": `{name}`\n" in SENSORS  # the heading


@pytest.mark.parametrize(
    ("number", "changes"), [(0, {}), (1, {"map": "factory"}), (1, {"map": "local"}), (1, {"map": "of_1985"}), (2, {})]
)
def test_examples_are_calibrations(number: int, changes: dict[str, str]) -> None:
    [sensor] = stack_of(EXAMPLES[number], **changes).sensors
    assert number != 1 or sensor.reading_names == ("spot x diode_1", "spot y diode_1")


def test_four_probes_of_the_example_have_equal_sensitivity_at_every_phase() -> None:
    [ring] = stack_of(EXAMPLES[2]).sensors
    assert isinstance(ring, BumpyRing)
    seen = ring.observability(np.linspace(0.0, 2.0 * np.pi, 73))
    assert seen.min() > 0.8 * seen.max()


def test_excerpts_occur_in_the_example() -> None:
    shown = blocks(ADDING, "python")
    assert len(shown) == 3
    files = [path.read_text(encoding="utf-8") for path in sorted(EXAMPLE.rglob("*.py"))]
    for excerpt in shown:
        assert any(excerpt.removeprefix("# excerpt\n") in text for text in files), dedent(excerpt)


def test_files_named_in_the_page_exist() -> None:
    package = ROOT / "ros2_ws/src/posor"
    names = re.findall(r"`([\w./]+\.py|[\w]+/[\w./]+)`", ADDING)
    assert len(names) > 5
    for name in names:
        if name != "posor_msgs/RawScan":
            assert any((folder / name).exists() for folder in (ROOT, package, EXAMPLE)), name
