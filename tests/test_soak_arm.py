"""Two minutes of an arm in one process: nothing is lost, and nothing grows."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from posor_lab.soak.soak_command import main

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.timeout(400)
@pytest.mark.usefixtures("ros_domain")
def test_two_minutes_of_the_arm_lose_nothing(tmp_path: Path) -> None:
    path = tmp_path / "soak.json"
    assert main(["soak", "--seconds", "120", "--warm-up", "20", "--output", str(path)]) == 0
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["lost"] == 0
    assert content["poses"] > 0.5 * content["states"] > 0  # drivers of a busy host miss ticks
    assert len(content["samples"]) > 20
