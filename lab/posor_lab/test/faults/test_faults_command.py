# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""faults: the quick part from end to end, the table, the judgement of poses, and refused options."""

from __future__ import annotations

import json
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor.errors import ParameterError
from posor.model.fault import State
from posor.uncertainty.protection_level import joint_protection_levels
from posor_drivers.simulator.pose_array import PoseArray
from posor_lab.faults.availability import OK_SHARE, START, arm_availability
from posor_lab.faults.cause_injection import inject
from posor_lab.faults.device_run import ACTIONS
from posor_lab.faults.fault_table import FAULT_TABLE, NAMING_LIMITS_S, FaultRow, RowResult
from posor_lab.faults.faults_command import PROGRAM, TITLES, describe_arms, describe_motion, describe_rest, main
from posor_lab.faults.levels_at_rest import AIMS, levels_at_rest
from posor_lab.faults.message_run import change_message
from posor_lab.faults.motion_coverage import LEAST, LevelCoverage, motion_coverage
from posor_lab.faults.offline_faults import run_ambient, run_slips
from posor_lab.faults.offline_time import OfflineArm, run_offline_times
from posor_lab.faults.pose_judge import SIGMAS, wrong_poses
from posor_lab.faults.storm import StormMaker, count_storm, estimate_storm, storm_calibrations
from posor_lab.reports.findings import Verdict
from posor_msgs.msg import JointTransform, RawScan

KEYS = {"fault", "kind", "observable", "expected", "seen", "naming_s", "wrong_ok", "lost", "covered", "failures"}
ROWS = 283
QUICK_ROWS = {row.title for row in FAULT_TABLE if row.quick}


def test_the_table_has_every_kind_stack_and_run_with_unique_names() -> None:
    assert len({row.title for row in FAULT_TABLE}) == len(FAULT_TABLE) == ROWS
    assert {row.kind for row in FAULT_TABLE} == {"off", "stuck", "garbage", "wrong", "slow", "clock", "network"}
    assert {row.arm for row in FAULT_TABLE} == {"six_axis", "five_axis", "test_rig", "quad_rig", "any stack"}
    assert {row.run for row in FAULT_TABLE} == set(TITLES)
    assert {row.name.removeprefix("device ") for row in FAULT_TABLE if row.run == "devices"} == set(ACTIONS)
    assert len(QUICK_ROWS) > 5


@pytest.mark.parametrize("row", [row for row in FAULT_TABLE if row.run == "messages"], ids=lambda row: row.name)
def test_every_message_fault_changes_its_message(row: FaultRow) -> None:
    message: Any = JointTransform() if row.inject["topic"] == "transform" else RawScan()
    message.header.stamp.sec = 10_000
    if isinstance(message, RawScan):
        message.gap_voltages, message.diode_currents, message.lit_sources = [1.0, 2.0], [1e-5] * 8, [0, 1]
    changed = deepcopy(message)
    change_message(changed, row.inject)
    assert changed != message
    if "covariance infinite" in row.name:
        assert np.flatnonzero(np.isinf(changed.covariance_random)).tolist() == [7]


@pytest.mark.usefixtures("ros_domain")
def test_the_quick_part_holds(tmp_path: Path) -> None:
    path = tmp_path / "faults.json"
    code = main(["faults", "--quick", "--output", str(path)])
    content = json.loads(path.read_text(encoding="utf-8"))
    assert {row["fault"] for row in content["faults"]} == QUICK_ROWS
    assert all(set(row) == KEYS for row in content["faults"])
    observable = [row for row in content["faults"] if row["observable"]]
    assert [row["fault"] for row in observable if row["wrong_ok"]] == []
    assert [row["fault"] for row in observable if row["naming_s"] is None] == []
    assert content["storm"]["uncovered"] == 0
    assert content["storm"]["injected"] > 0
    late = [row for row in observable if row["naming_s"] > NAMING_LIMITS_S[row["kind"]]]  # on a busy host
    assert code == 0 or late


@pytest.mark.parametrize("arguments", [["--rows", "no such row"], ["--seed", "-1"], ["--storm", "-1"]])
def test_wrong_options_are_refused(arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["faults", *arguments, "--output", str(tmp_path / "faults.json")]) != 0
    assert "expected" in capsys.readouterr().err


def test_quick_shortens_the_storm() -> None:
    options = PROGRAM.parse(["--quick"])
    assert 0 < options.storm < PROGRAM.parse([]).storm
    assert (options.node_storm, options.arms, options.motion) == (0, 0, 0)
    with pytest.raises(ParameterError):
        PROGRAM.parse(["--everything"])


def test_a_row_fails_for_each_missed_aim() -> None:
    row = FaultRow("a fault", "wrong", "test_rig", "LOST", ("RESIDUAL",))
    sound = RowResult(row, "LOST", 0.01, 0)
    assert sound.failures == []
    assert "1 wrong poses" in replace(sound, wrong_ok=1).failures[0]
    assert replace(sound, naming_s=None).failures == ["not named"]
    assert "limit 0.2 s" in replace(sound, naming_s=0.3).failures[0]
    assert replace(sound, row=replace(row, kind="off"), naming_s=0.3).failures == []
    assert replace(sound, problem="no pose before").failures == ["no pose before"]
    hidden = RowResult(replace(row, named_by=()), "", None, 5, covered=1.0)
    assert hidden.failures == []
    assert "98.0 %" in replace(hidden, covered=0.98).failures[0]
    assert replace(hidden, covered=float("nan")).failures
    timed = RowResult(
        replace(row, run="times", named_by=(), most_lost=1, least_usable=0.95), "", None, 0, lost=1, scans=25
    )
    assert timed.failures == []
    assert "2 scans lost, limit 1" in replace(timed, lost=2).failures[0]
    assert "limit 95 %" in replace(timed, scans=10).failures[0]
    assert replace(timed, wrong_ok=1).failures
    lucky = RowResult(replace(row, may_hide=True), "LOST", 0.01, 3, covered=1.0)
    assert lucky.failures == []
    assert "0.0 %" in replace(lucky, covered=0.0).failures[0]
    assert replace(lucky, naming_s=None).failures == ["not named"]


def test_faults_of_time_without_nodes(tmp_path: Path) -> None:
    words = "two ticks back while", "back by 0.5 s", "all joints 80 ms", "rms", "drawn at random"
    rows = [row for row in FAULT_TABLE if row.run == "offline_times" and row.arm == "quad_rig"]
    chosen = [row for row in rows if any(word in row.name for word in words)]
    assert len(chosen) == len(words) + 1
    results = run_offline_times(chosen, tmp_path, seed=3)
    assert [result.row.name for result in results if result.failures] == []


def test_content_that_is_older_than_stated_is_wrong(tmp_path: Path) -> None:
    arm = OfflineArm("test_rig", tmp_path / "arm", seed=3)
    faults = [{"aged": 0.04, "at": 0.0}]
    assert arm.run(arm.joints, faults, stamp_limit=0.04).wrong == 0
    assert arm.run(arm.joints, faults).wrong > 1000


def test_wrong_poses() -> None:
    count, sigma = 6, 1e-6
    poses = PoseArray(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))
    true = PoseArray(poses.rotations.copy(), poses.translations.copy())
    true.translations[1, 2] = 1.1 * SIGMAS * sigma
    true.translations[2, 0] = 0.9 * SIGMAS * sigma
    true.rotations[3] = np.diag([-1.0, -1.0, 1.0])  # half a turn, whose antisymmetric part is zero
    poses.translations[4, 1] = np.nan
    covariances = np.tile(sigma**2 * np.eye(6), (count, 1, 1))
    covariances[5, 5, 5] = -1.0
    assert wrong_poses(poses, covariances, true).tolist() == [False, True, False, True, True, True]


@pytest.fixture(scope="module")
def storm_maker() -> StormMaker:
    return StormMaker(storm_calibrations()["light_ring"])


def test_a_storm_is_seeded_and_nearly_a_third_is_faulty(storm_maker: StormMaker) -> None:
    one, same, other = (storm_maker.draw(seed) for seed in (1, 1, 2))
    assert one.scans._records.tobytes() == same.scans._records.tobytes()
    assert one.scans._records.tobytes() != other.scans._records.tobytes()
    assert 0.2 < np.mean(one.faults >= 0) < 0.4
    assert one.names[0] == "no scans"  # of which nothing is left
    assert set(one.faults.tolist()) == {-1, *range(1, len(one.names))}
    assert np.all(one.faults[one.acknowledgements] == -1)


def test_a_pose_that_is_wrong_counts(storm_maker: StormMaker) -> None:
    storm = storm_maker.draw(1)
    storm_maker.posor.reset()
    found = estimate_storm(storm_maker.posor, storm)
    covariances = found.covariances()
    poses = PoseArray(found.rotations, found.translations.copy())
    levels = joint_protection_levels(storm_maker.posor, found).levels
    sound = count_storm(storm, found.states, found.faults, poses, covariances, levels)
    first = int(np.flatnonzero(found.states == State.OK)[0])
    poses.translations[first, 0] += 1e-3
    wrong = count_storm(storm, found.states, found.faults, poses, covariances, levels)
    assert (wrong.wrong_ok, wrong.uncovered) == (sound.wrong_ok + 1, sound.uncovered + 1)
    assert sound.injected == np.count_nonzero(storm.faults >= 0)


@pytest.mark.parametrize(("run", "of_row"), [("slips", run_slips), ("ambient", run_ambient)])
def test_neither_a_slip_of_a_coded_ring_nor_ambient_light_gives_a_wrong_pose(run: str, of_row: Any) -> None:
    (row,) = (row for row in FAULT_TABLE if row.run == run)
    assert of_row(row, seed=1, positions=3).failures == []


def test_each_drawn_arm_counts_by_itself() -> None:
    found = arm_availability("six_axis", 2, 1985, lambda _: None, ticks=START + 100)
    assert found.shares == (1.0, 1.0)
    assert found.scans == 200  # the dark scan is among the first
    assert describe_arms(found).verdict is Verdict.HOLDS
    assert describe_arms(replace(found, shares=(1.0, OK_SHARE - 1e-3))).verdict is Verdict.FAILS


def test_the_level_covers_bounded_errors_in_fast_motion(tmp_path: Path) -> None:
    found = motion_coverage("five_axis_checked", 1, 1985, tmp_path, lambda _: None, cycle_s=4)
    assert (found.scans, found.share) == (800, 1.0)
    assert found.usable > 780
    assert 0.2 < found.largest < 1.0  # errors are not small against the level
    assert describe_motion(found).verdict is Verdict.HOLDS
    assert describe_motion(LevelCoverage("x", 1000, 1000, round(1000 * LEAST) - 1)).verdict is Verdict.FAILS


def test_a_fault_of_an_episode_has_one_size_direction_and_choice_of_readings(storm_maker: StormMaker) -> None:
    stack, scans = storm_maker.posor.stack, storm_maker.draw(1).scans.part(0, 10)
    for cause in storm_maker.posor.hypotheses.causes:
        if cause.unit == "m":
            moved = inject(cause, np.full(10, 1e-6), scans, stack, np.random.default_rng(2), alike=True)
            shifts = stack.linearise(moved).values - stack.linearise(scans).values
            np.testing.assert_allclose(shifts, np.tile(shifts[0], (10, 1)), rtol=0.0, atol=1e-12)
            assert np.abs(shifts).max() > 5e-7


@pytest.mark.parametrize("name", AIMS)
def test_an_arm_at_rest_with_known_temperatures_has_small_levels(name: str) -> None:
    found = levels_at_rest(name, 3)
    assert describe_rest(found).verdict is Verdict.HOLDS
    assert np.all(found.worst >= found.median)
    assert describe_rest(found._replace(worst=found.worst + 1e-4)).verdict is Verdict.FAILS
