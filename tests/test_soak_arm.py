# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""An arm in one process: nothing is lost, and nothing grows."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from posor_lab.soak.soak_command import MOST_GROWTH_MB, main

FULL_S = 120.0  # after which the limit of the growth holds; it is proportional to the time


@pytest.mark.timeout(400)
@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize(
    ("arm", "seconds"), [("test_rig", 15.0), pytest.param("five_axis", FULL_S, marks=pytest.mark.long)]
)
def test_the_running_arm_loses_nothing(tmp_path: Path, arm: str, seconds: float) -> None:
    path = tmp_path / "soak.json"
    assert main(["soak", "--arm", arm, "--seconds", str(seconds), "--warm-up", "10", "--output", str(path)]) == 0
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["lost"] == 0
    assert content["growth_mb"] < MOST_GROWTH_MB * seconds / FULL_S
    assert content["poses"] > 0.5 * content["states"] > 0  # drivers of a busy host miss ticks
    assert len(content["samples"]) > seconds / 6.0
