# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Programs as files, their place in a recording, and their correction."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.arm_file import load_arm_file
from posor.correction.correct_command import main
from posor.correction.joint_correction import CorrectionLimits
from posor.correction.joint_path import JointPath, read_path
from posor.correction.nominal_robot import NominalRobot
from posor.correction.program_correction import MeasuredRun, begin_of_program, correct_path
from posor.errors import DataFileError, PosorError

ARM = Path(__file__).resolve().parents[3] / "posor_bringup" / "arms" / "five_axis"
CSV = "time [s],b [deg],a [rad]\n0,10,0.5\n0.5,20,0.75\n"
YAML = """joint_names: [b, a]
points:
- {positions: [0.1, 0.5], velocities: [0.0, 0.0], time_from_start: {sec: 0, nanosec: 0}}
- {positions: [0.3, 0.7], velocities: [0.0, 0.0], time_from_start: {sec: 1, nanosec: 500000000}}
"""
LIMITS = CorrectionLimits(max_rate=0.1)


def written(folder: Path, text: str, name: str = "program.csv") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


@pytest.mark.parametrize(
    ("output", "code"), [("bag/corrected.csv", 1), ("arm.yaml", 2), ("program.csv", 2), ("corrected.json", 2)]
)
def test_an_output_that_would_replace_what_is_read_or_of_another_format_is_refused(
    tmp_path: Path, output: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(ARM, tmp_path, dirs_exist_ok=True)
    (tmp_path / "bag").mkdir()
    place = tmp_path / output
    arguments = [str(tmp_path), str(written(tmp_path, CSV)), "--bag", str(tmp_path / "bag"), "--output", str(place)]
    assert main([*arguments, "--force"]) == code
    assert str(place) in capsys.readouterr().err


def test_csv_in_any_unit_and_order_is_read_and_written(tmp_path: Path) -> None:
    path = read_path(written(tmp_path, CSV)).of_joints(("a", "b"))
    np.testing.assert_allclose(path.angles, [[0.5, np.radians(10.0)], [0.75, np.radians(20.0)]])
    np.testing.assert_allclose(path.sampler()([-1.0, 0.25, 9.0])[:, 0], [0.5, 0.625, 0.75])
    again = read_path(written(tmp_path, path.text(as_yaml=False)))
    np.testing.assert_allclose(again.angles, path.angles, atol=1e-12)
    assert again.joints == ("a", "b")
    late = JointPath(path.joints, 1.7e9 + path.times_s / 1e3, path.angles)
    np.testing.assert_array_equal(read_path(written(tmp_path, late.text(as_yaml=False))).times_s, late.times_s)
    np.testing.assert_allclose(path.at_period(0.1).times_s, np.linspace(0.0, 0.5, 6))


@pytest.mark.parametrize("period_s", [0.11, 0.3, 0.7])
def test_rows_are_at_the_period_and_the_last_one_is_where_the_program_ends(tmp_path: Path, period_s: float) -> None:
    path = read_path(written(tmp_path, CSV))
    found = path.at_period(period_s)
    np.testing.assert_allclose(np.diff(found.times_s), period_s)
    assert 0.5 <= found.times_s[-1] < 0.5 + period_s
    np.testing.assert_array_equal(found.angles[[0, -1]], path.angles)


def test_velocities_that_a_csv_file_would_lose_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    joints = NominalRobot(load_arm_file("five_axis").chain()).joints
    zeros = np.zeros((2, len(joints)))
    program = written(tmp_path, JointPath(joints, np.arange(2.0), zeros, zeros).text(as_yaml=True), "program.yaml")
    output = tmp_path / "corrected.csv"
    assert main([str(ARM), str(program), "--bag", str(tmp_path / "bag"), "--output", str(output)]) == 2
    assert f"has velocities, which {output} cannot hold; expected an --output in YAML" in capsys.readouterr().err


def test_yaml_of_a_trajectory_keeps_its_velocities(tmp_path: Path) -> None:
    path = read_path(written(tmp_path, YAML, "program.yaml"))
    np.testing.assert_allclose(path.times_s, [0.0, 1.5])
    assert path.sampler()(0.75)[0] == pytest.approx(0.2)
    assert path.sampler()(0.15)[0] < 0.1 + 0.2 * 0.1  # slow at its begin, not on a straight line
    moved = path.moved(np.array([[0.0, 0.0], [0.03, 0.0]]))
    again = read_path(written(tmp_path, moved.text(as_yaml=True), "moved.yaml"))
    np.testing.assert_allclose(again.angles, [[0.1, 0.5], [0.33, 0.7]])
    assert again.velocities is not None
    np.testing.assert_allclose(again.velocities[:, 0], 0.02)


@pytest.mark.parametrize(
    ("text", "name", "place"),
    [
        ("", "a.csv", "a.csv"),
        ("0,1\n", "a.csv", "line 1"),
        ("time,a [rad]\n0,1\n", "a.csv", "'time'"),
        ("time [s],a\n0,1\n", "a.csv", "column 2 is 'a'"),
        ("time [s],a [mm]\n0,1\n", "a.csv", "column 2"),
        ("t [s],a [rad]\n0,1\n", "a.csv", "column 1"),
        ("time [s],a [rad]\n0,x\n", "a.csv", "line 2, column 'a [rad]'"),
        ("time [s],a [rad]\n0,1\n1\n2,1\n", "a.csv", "line 3"),
        ("time [s],a [rad]\n1,1\n0,1\n", "a.csv", "row 2"),
        ("time [s],a [rad]\n", "a.csv", "a.csv"),
        ("points: []\n", "a.yaml", "joint_names"),
        ("joint_names: [a]\npoints: []\n", "a.yaml", "points"),
        ("joint_names: [a]\npoints:\n- {positions: [1, 2]}\n", "a.yaml", "line 3, key points[0]"),
        ("joint_names: [a]\npoints:\n- {positions: [1], accelerations: [0]}\n", "a.yaml", "accelerations"),
        ("joint_names: [a]\npoints:\n- {positions: [true]}\n", "a.yaml", "points[0].positions[0]"),
        ("joint_names: [a]\npoints:\n- {positions: ['1']}\n", "a.yaml", "points[0].positions[0]"),
        ("joint_names: [a]\npoints:\n- {positions: [.nan]}\n", "a.yaml", "row 1: the angle of a is nan"),
        ("joint_names: [a]\npoints:\n- {positions: [1], velocities: [0]}\n- {positions: [1]}\n", "a.yaml", "points[1]"),
    ],
)
def test_an_invalid_program_is_refused_with_its_place(tmp_path: Path, text: str, name: str, place: str) -> None:
    with pytest.raises(PosorError) as error:
        read_path(written(tmp_path, text, name))
    assert place in str(error.value)


def test_other_joints_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataFileError, match="has the joints b, a; expected a, c"):
        read_path(written(tmp_path, CSV)).of_joints(("a", "c"))


@pytest.fixture(scope="module")
def robot() -> NominalRobot:
    return NominalRobot(load_arm_file("six_axis").chain())


def motion(robot: NominalRobot) -> JointPath:
    """Return a motion of 2 s away from singular poses."""
    times_s = np.linspace(0.0, 2.0, 201)
    start = np.array([0.3, -0.6, 0.9, 0.4, 0.7, 0.5])
    return JointPath(robot.joints, times_s, start + 0.2 * np.sin(np.outer(times_s, np.arange(1, 7) / 2.0)))


def wrong_run(robot: NominalRobot, path: JointPath, errors: float) -> MeasuredRun:
    """Return the run of a robot whose joints are beyond their angles."""
    poses = [pin.SE3ToXYZQUAT(robot.endpoint(row + errors)) for row in path.angles]
    return MeasuredRun(path.times_s, path.angles, np.array(poses))


def test_the_begin_of_a_program_is_found_in_a_recording(robot: NominalRobot) -> None:
    path = motion(robot)
    times_s = np.arange(0.0, 5.0, 0.005)
    angles = path.sampler()(times_s - 1.2345) + 1e-4
    assert begin_of_program(path, times_s, angles) == pytest.approx(1.2345, abs=1e-4)
    with pytest.raises(DataFileError, match="the measured angles last"):
        begin_of_program(path, times_s[: len(times_s) // 4], angles[: len(times_s) // 4])
    long = JointPath(path.joints, path.times_s * 1e9, path.angles)
    with pytest.raises(DataFileError, match=r"last 4.995 s, the program 2e\+09 s"):
        begin_of_program(long, times_s, angles)
    with pytest.raises(DataFileError, match="rad rms"):
        begin_of_program(path, times_s, angles[::-1])


@pytest.mark.parametrize("change", ["in milliseconds", "a spike"])
def test_a_program_that_another_motion_ran_is_refused(robot: NominalRobot, change: str) -> None:
    """One joint is off for so short a time, or the program ends so soon where it began, that the mean is small."""
    open_path = motion(robot)
    there_and_back = 0.2 * np.sin(0.5 * np.pi * open_path.times_s)[:, None] ** 2
    path = JointPath(open_path.joints, open_path.times_s, open_path.angles[0] + there_and_back)
    times_s, angles = path.times_s.copy(), path.angles.copy()
    if change == "a spike":
        angles[98:103, 2] += 0.25
    else:
        times_s /= 1000.0
    run_s = np.arange(0.0, 5.0, 0.005)
    run = path.sampler()(run_s - 1.2345)
    assert begin_of_program(path, run_s, run) == pytest.approx(1.2345, abs=1e-4)
    with pytest.raises(DataFileError, match="the measured angles: "):
        begin_of_program(JointPath(path.joints, times_s, angles), run_s, run)


def test_a_corrected_program_brings_the_endpoint_onto_the_plan(robot: NominalRobot) -> None:
    path = motion(robot)
    corrected = correct_path(path, wrong_run(robot, path, 3e-4), robot, LIMITS, 0.005)
    for planned, commanded in zip(path.angles, corrected.angles, strict=True):
        assert np.linalg.norm(robot.endpoint(commanded + 3e-4).translation - robot.endpoint(planned).translation) < 2e-5
        assert np.linalg.norm(robot.endpoint(planned + 3e-4).translation - robot.endpoint(planned).translation) > 2e-4


@pytest.mark.parametrize(
    ("errors", "kept", "limits", "text"),
    [
        (8e-3, slice(None), LIMITS, "needs -0.0"),
        (3e-4, slice(0, 100), LIMITS, "no usable endpoint within 0.1 s of 1.08 s"),
        (3e-4, [*range(40), *range(80, 201)], LIMITS, "no usable endpoint within 0.1 s of 0.4 s"),
        (3e-4, slice(None), CorrectionLimits(max_rate=1e-6), "rad/s at "),
        (3e-4, slice(0, 1), LIMITS, "1 usable endpoints"),
    ],
)
def test_a_correction_beyond_its_limits_or_without_endpoints_is_refused(
    robot: NominalRobot, errors: float, kept: slice, limits: CorrectionLimits, text: str
) -> None:
    path = motion(robot)
    run = wrong_run(robot, path, errors)
    part = MeasuredRun(run.times_s[kept], run.angles[kept], run.poses[kept])
    with pytest.raises(DataFileError) as error:
        correct_path(path, part, robot, limits)
    assert text in str(error.value)


def test_rows_after_the_end_of_a_program_have_its_last_offsets(robot: NominalRobot) -> None:
    path = motion(robot)
    run, rows = wrong_run(robot, path, 1e-4), path.at_period(0.6)
    assert rows.times_s[-1] > path.duration_s + LIMITS.max_age
    with pytest.raises(DataFileError, match="no usable endpoint within"):
        correct_path(rows, run, robot, LIMITS)
    corrected = correct_path(rows, run, robot, LIMITS, end_s=path.duration_s)
    at_end = (correct_path(path, run, robot, LIMITS).angles - path.angles)[-1]
    np.testing.assert_allclose((corrected.angles - rows.angles)[-1], at_end, rtol=1e-9)
