# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from posor.errors import CalibrationError, ParameterError
from posor_drivers.simulator.motion_phases import Circle, Dither, Rest, Spline
from posor_drivers.simulator.scenario import load_scenario
from posor_lab.harness.case_tables import refusal

from ..three_joint_arm import SCENARIO, scenario


def load(folder: Path, content: object) -> Any:
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return load_scenario(path)


def test_another_rate_changes_the_ticks_and_not_the_duration() -> None:
    scenario = load_scenario(SCENARIO).at_rate(250)
    assert (scenario.ticks_per_second, scenario.cycle_ticks) == (250, 2000)


def test_rate_without_a_whole_number_of_ticks_is_refused(tmp_path: Path) -> None:
    changed = load(tmp_path, scenario({"duration.value": 8.01, "motion.0.duration.value": 0.41}))
    with pytest.raises(ParameterError, match=r"parameter 'simulated.rate': 50 Hz does not fit .* ticks in 8.01 s"):
        changed.at_rate(50)


def test_scenario_is_read_as_written() -> None:
    read = load_scenario(SCENARIO)
    assert (read.seed, read.ticks_per_second, read.cycle_ticks) == (1985, 100, 800)
    assert [type(phase) for phase in read.motion] == [Rest, Spline, Dither, Circle]
    assert read.joints["base"].gear is not None
    assert read.joints["base"].gear.backlash.number == 4e-5
    assert read.joints["base"].start.number == 0.0
    assert read.payload.mass.number == 3.0
    assert read.stage is not None
    assert read.stage.command_age.number == 0.5
    assert read.electronics.contamination[0].begin.number == 1.0


def test_missing_entries_are_perfect(tmp_path: Path) -> None:
    none = dict.fromkeys(("stage", "payload", "electronics.latency"))
    read = load(tmp_path, scenario({**none, "joints.elbow": {}}))
    assert read.stage is None
    assert read.payload.mass.number == 0.0
    assert read.joints["elbow"].structure is None
    assert read.electronics.latency is None


INVALID_ENTRIES = """
rate = {value: 99.5, unit: Hz} | rate.value | 99.5 Hz | a whole number from 1 to 10000
rate = {value: 100, unit: kHz} | rate.unit | unit 'kHz' | 'Hz'
duration = {value: 8.005, unit: s} | duration.value | duration 8.005 s | a whole number of ticks of 0.01 s
seed = -1 | seed | -1 | at least 0
motion.0.duration = {value: 0.5, unit: s} | motion | the phases take 8.1 s | 8 s, the duration of the scenario
motion.1.through.value = [[0.1, 0, 0], [0.2, 0, 0], [0, 0, 0.25]] | motion[1].through \
    | the motion ends with joint 'elbow' at 0.25 rad | 0 rad, its angle at the start
joints.base.start = {value: 0.1, unit: rad} | motion[1].through \
    | the motion ends with joint 'base' at 0 rad | 0.1 rad, its angle at the start
motion.2.joints = [base, knee, elbow] | motion[2].joints[1] | joint 'knee' | one of base, shoulder, elbow
motion.1.joints = [base, base, elbow] | motion[1].joints[1] | joint 'base' is listed twice | each joint once
motion.1.joints = [base, elbow] | motion[1].through.value | through has 3 numbers | 2, one for each joint
motion.1.at.value = [1.0, 0.9, 3.2] | motion[1].at.value \
    | at [1.0, 0.9, 3.2] s | ascending times from more than 0 s to 3.2 s, the duration
motion.1.at.value = [1.0, 2.0, 3.0] | motion[1].at.value \
    | at [1.0, 2.0, 3.0] s | ascending times from more than 0 s to 3.2 s, the duration
motion.2.frequency.value = [3.0, 7.0] | motion[2].frequency.value \
    | frequency has 2 numbers | 3, one for each entry of joints
motion.0.kind = jump | motion[0].kind | kind 'jump' | one of 'circle', 'dither', 'rest', 'spline'
motion.3.axis.value = [0.0, 0.0, 2.0] | motion[3].axis | axis [0.0, 0.0, 2.0] has length 2 | a unit vector
motion.3.approach.value = 1.75 | motion[3].approach.value | approach 1.75 s | less than 1.75 s, half the duration
motion.3.posture = null | motion[3].joints | joints and posture do not go together | both or neither
joints.elbow.bearing.tilt.value = [1.0e-5] | joints.elbow.bearing.tilt.value \
    | tilt has 1 amplitudes | 2, one for each of orders
joints.elbow.gear.backlash.value = -1.0e-5 | joints.elbow.gear.backlash.value | -1e-05 rad | 0 or more
joints.elbow.encoder.resolution.value = 0.0 | joints.elbow.encoder.resolution.value | 0.0 rad | more than 0
joints.elbow.structure.inner_diameter.value = 0.2 | joints.elbow.structure.inner_diameter \
    | inner_diameter 0.2 m | 0 to less than 0.12 m, the outer
joints.elbow.gears = {} | joints.elbow.gears | unknown key 'gears' | a key of the format
electronics.converter = null | electronics | key 'converter' is missing |
electronics.converter.bits = 26 | electronics.converter.bits | 26 | at most 24
electronics.converter.probes.value = [5.0, -5.0] \
    | electronics.converter.probes.value | [5.0, -5.0] V | [lowest, highest]
electronics.contamination.0.joint = knee | electronics.contamination[0].joint \
    | joint 'knee' | one of base, shoulder, elbow
electronics.contamination.0.until.value = 1.0 | electronics.contamination[0].until.value \
    | until 1 s | more than 1 s, where it begins
electronics.contamination.0.until.value = 9.0 | electronics.contamination[0].until.value \
    | until 9 s | at most 8 s, the duration of the scenario
electronics.contamination.1.size.unit = V | electronics.contamination[1].size | size -0.05 'V' | one number, unit '1'
electronics.contamination.1.size.value = -1.0 | electronics.contamination[1].size.value \
    | size -1 | more than -1, which leaves no current
electronics.dropouts.probability.value = 1.0 | electronics.dropouts.probability.value \
    | 1.0 | a probability of 0 or more, less than 1
electronics.latency.mean.value = 20 | electronics.latency.mean.value | 20.0 s | 0 to 5 s (milliseconds?)
electronics.latency.jitter.value = 0.1 | electronics.latency.jitter.value | jitter 0.1 s | at most 0.001 s, the mean
electronics.supply.measured = "yes" | electronics.supply.measured | 'yes' | true or false
stage.stroke.value = 0.0 | stage.stroke.value | 0.0 m | more than 0
"""
"""Key = new value (null: removed) | key of the error | what is wrong | what is expected."""


@pytest.mark.parametrize("case", INVALID_ENTRIES.strip().splitlines())
def test_invalid_entry_is_refused_with_file_line_and_key(tmp_path: Path, case: str) -> None:
    change, key, what, expected = (cell.strip() for cell in case.split("|"))
    path, _, text = change.partition(" = ")
    error = refusal(CalibrationError, load, tmp_path, scenario({path: yaml.safe_load(text)}))
    assert error.where.startswith(f"{tmp_path / 'scenario.yaml'}, line ")
    assert error.where.endswith(f"key {key}")
    assert (error.what, error.expected) == (what, expected)
