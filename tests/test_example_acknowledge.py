# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The example that releases a latched joint, with a real posor_node and without one."""

from __future__ import annotations

from pathlib import Path

import pytest
from posor_lab.harness.program import Program, script

from tests.composed_rig import COMPOSE, RIG, write_composition

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "acknowledge.py"

pytestmark = pytest.mark.usefixtures("ros_domain")


def test_a_joint_answers(tmp_path: Path) -> None:
    with Program([*COMPOSE, str(write_composition(tmp_path, RIG))]) as rig:
        rig.wait_for_line("calibration")
        with Program([*script(EXAMPLE), "/rig/joint1", "inspected"]) as example:
            assert (example.wait(), example.stdout) == (0, ["there is no latched fault"])
        assert rig.end() == 0


def test_a_joint_that_is_not_there_is_named() -> None:
    with Program([*script(EXAMPLE), "/rig/joint1", "inspected"]) as example:
        assert example.wait() == 1
        assert example.stderr == [
            "no service /rig/joint1/posor_node/acknowledge within 5 s; expected a posor_node with 'allow_changes'"
        ]
