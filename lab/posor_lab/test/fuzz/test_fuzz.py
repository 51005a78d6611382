# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Damaged messages and files, a seeded part of the program ``fuzz``."""

from __future__ import annotations

import os
import random
import subprocess
from pathlib import Path

import pytest
from posor_bringup.arms import load_checked_arm
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_lab.fuzz.fuzz_command import fuzz_files, main, readers
from posor_lab.fuzz.message_fuzz import (
    MUTATIONS,
    ScanFuzz,
    TransformFuzz,
    changed_readings,
    fuzz_simulation,
    mutate,
    record,
)
from posor_lab.fuzz.node_fuzz import NodeScanFuzz, NodeTransformFuzz
from posor_lab.harness.program import installed
from posor_ros.node_program import ros_context

SEED = 1985


@pytest.fixture(scope="module")
def simulation() -> ArmSimulation:
    return fuzz_simulation(load_checked_arm("six_axis"))


def test_every_kind_of_damage_changes_bytes() -> None:
    chance, data = random.Random(SEED), bytes(range(256))  # noqa: S311
    for damage in MUTATIONS:
        changed = bytearray(data)
        damage(changed, chance)
        assert changed != data
    assert len({mutate(data, chance) for _ in range(200)}) > 180
    assert mutate(b"", chance)


@pytest.mark.parametrize("joint", ["base_turn", "wrist_roll"])
def test_no_damaged_scan_gives_a_wrong_pose(simulation: ArmSimulation, joint: str) -> None:
    fuzz = ScanFuzz(simulation, joint, SEED)
    fuzz.run(2000)
    assert fuzz.outcomes["wrong"] == 0, fuzz.examples
    assert fuzz.outcomes.total() == 2000
    assert min(fuzz.outcomes["refused"], fuzz.outcomes["unharmed"]) > 100


def test_no_damaged_transform_gives_a_wrong_endpoint(simulation: ArmSimulation) -> None:
    fuzz = TransformFuzz(simulation, SEED)
    fuzz.run(2000)
    assert fuzz.outcomes["wrong"] == 0, fuzz.examples
    assert min(fuzz.outcomes["refused"], fuzz.outcomes["unharmed"]) > 200


def test_readings_that_differ_are_found(simulation: ArmSimulation) -> None:
    one, other = record(simulation, "elbow", 2).scans
    assert "gap_voltages[0]" in changed_readings(one, other)
    assert not changed_readings(one, one)


@pytest.mark.usefixtures("ros_domain")
def test_nodes_answer_every_sound_message_and_no_damaged_one_wrongly(
    simulation: ArmSimulation, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    done: list[int] = []
    with ros_context(["fuzz"]):
        for fuzz in (NodeScanFuzz(simulation, "wrist_roll", SEED), NodeTransformFuzz(simulation, SEED)):
            done.clear()
            fuzz.run(300, tmp_path, done.append)
            outcomes = fuzz.fuzz.outcomes
            assert len(done) == outcomes.total() == 300
            assert outcomes["wrong"] == 0, fuzz.fuzz.examples
            assert outcomes["refused"] > 100
            assert outcomes["unharmed"] > 20
    assert "Traceback" not in "".join(path.read_text() for path in tmp_path.glob("*.log"))
    assert not capfd.readouterr().err


@pytest.mark.long
@pytest.mark.timeout(900)
def test_kernels_stay_within_their_arrays() -> None:
    """Compiled kernels read past the end of an array in silence; with this setting of numba they raise IndexError."""
    environment = {**os.environ, "NUMBA_BOUNDSCHECK": "1", "POSOR_KERNELS": "numba"}
    command = [*installed("posor_lab", "fuzz"), "--scans", "60000", "--transforms", "60000"]
    run = [*command, "--nodes", "0", "--files", "0"]
    found = subprocess.run(run, env=environment, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout + found.stderr
    assert "transforms: 60000 damaged" in found.stdout


@pytest.mark.parametrize("name", readers())
def test_a_damaged_file_is_read_or_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    count = fuzz_files(name, 40, SEED, tmp_path)
    assert count.read + count.refused == 40
    assert count.refused > 10


@pytest.mark.long
def test_the_program_reports_what_it_found(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["fuzz", "--scans", "600", "--transforms", "100", "--nodes", "60", "--files", "5"]) == 0
    out = capfd.readouterr().out
    assert "transforms: 100 damaged" in out
    assert out.splitlines()[-1] == "Everything holds."
    assert main(["fuzz", "--scans", "-1"]) == 2
