# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Corrected robots: the begin of the path in CI, ``make correction`` runs all of it; and the program ``correct``."""

from __future__ import annotations

import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from posor.chain.arm_file import load_arm_file
from posor.correction import encoder_errors
from posor.correction.correct_command import main
from posor.correction.joint_path import JointPath, read_path
from posor.correction.nominal_robot import LeastSquares, NominalRobot
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_lab.correction.correction_command import STOP_S, findings, least_gains, stop_times, study_robot
from posor_lab.correction.correction_study import PathErrors
from posor_lab.correction.simulated_robot import SimulatedRobot
from posor_lab.harness.full_disk import full_disk_changes_nothing
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

BAG = Path(__file__).resolve().parents[4] / "bags" / "five_axis"
ROWS, ROWS_OF_STOPS = 500, 550


@pytest.mark.timeout(600)
def test_a_corrected_robot_is_near_its_path() -> None:
    assert not findings(least_gains([study_robot(7, ROWS)]), {})


@pytest.mark.timeout(600)
def test_each_failure_stops_the_correction() -> None:
    stops = stop_times(7, ROWS_OF_STOPS)
    assert len(stops) == 3
    assert max(stops.values()) < STOP_S


def test_the_program_finds_gains_that_are_too_small_and_late_stops() -> None:
    robot = {
        "uncorrected": PathErrors(1.0, 1.0, 1.0),
        "program after run 2": PathErrors(0.06, 0.3, 1.0),
        "loop, dead time 0.12 s": PathErrors(0.1, 0.1, 1.0),
    }
    assert len(findings(least_gains([robot]), {"lost": 0.1})) == 2
    assert len(findings(least_gains([robot]), {"lost": 0.3, "frozen": float("inf")})) == 4


@pytest.fixture(scope="module")
def planned() -> JointPath:
    """Return the begin of the motion of the bag."""
    robot, rows = SimulatedRobot(load_arm_file("five_axis"), 200, 1985), 1000
    return JointPath(tuple(joint.name for joint in robot.chain.joints), np.arange(rows) / 200.0, robot.planned[:rows])


def write_late_encoders(late: Path, topic: str, lateness_ms: int) -> None:
    """Copy the bag with other stamps of the encoders."""
    with Reader(BAG) as reader, Writer(late, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        to = {
            each.topic: writer.add_connection(each.topic, each.msgtype, msgdef=each.msgdef.data, rihs01=each.digest)
            for each in reader.connections
        }
        for connection, time_ns, data in reader.messages():
            own = bytes(data)
            if connection.topic == topic:  # CDR begins with four bytes of encoding; then come seconds and nanoseconds
                seconds, rest = struct.unpack_from("<iI", own, 4)
                stamp_ns = seconds * 10**9 + rest + lateness_ms * 10**6
                own = own[:4] + struct.pack("<iI", *divmod(stamp_ns, 10**9)) + own[12:]
            writer.write(to[connection.topic], time_ns, own)


def test_encoders_whose_stamps_are_wrong_correct_nothing(
    planned: JointPath, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    topic, program = "/five_axis/encoders", tmp_path / "program.csv"
    program.write_text(planned.text(as_yaml=False), encoding="utf-8")
    output = tmp_path / "corrected.yaml"
    for lateness_ms, word in ((-2, "early"), (2, "late")):
        write_late_encoders(tmp_path / word, topic, lateness_ms)
        arguments = ["five_axis", str(program), "--bag", str(tmp_path / word), "--output", str(output)]
        assert main([*arguments, "--encoders", topic]) == 1
        assert re.search(rf"the encoder of joint \w+: its readings are \S+ ms {word}", capsys.readouterr().err)
        assert not output.exists()
    assert main(arguments) == 0
    capsys.readouterr()
    monkeypatch.setattr(encoder_errors, "LEAST_CHANGE", math.inf)
    assert main([*arguments, "--encoders", topic, "--force"]) == 0
    assert capsys.readouterr().out.startswith("not known how late the encoder is")


def test_a_recorded_program_is_corrected_by_the_errors_of_the_true_arm(
    planned: JointPath, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program, output = tmp_path / "program.csv", tmp_path / "corrected.yaml"
    program.write_text(planned.text(as_yaml=False), encoding="utf-8")
    arguments = ["five_axis", str(program), "--bag", str(BAG), "--output", str(output), "--rotation-length", "0.01"]
    assert main([*arguments, "--encoders", "/five_axis/encoders"]) == 0
    corrected, printed = read_path(output), capsys.readouterr().out
    assert " endpoints used; the first one " in printed
    arm = load_arm_file("five_axis")
    truth = ArmSimulation(arm).truth(np.arange(len(planned.times_s))).endpoint
    robot = NominalRobot(arm.chain(), LeastSquares(rotation_length=0.01))
    targets = [robot.endpoint(row).translation for row in planned.angles]
    offsets = corrected.of_joints(robot.joints).angles - planned.angles
    moved = [robot.jacobian(row)[:3] @ each for row, each in zip(planned.angles, offsets, strict=True)]
    before = np.linalg.norm(truth.translations - targets, axis=1)
    after = np.linalg.norm(truth.translations + moved - targets, axis=1)
    assert np.median(after) < 0.05 * np.median(before)

    assert main(arguments) == 2
    assert "exists; expected a new file, or --force" in capsys.readouterr().err
    with full_disk_changes_nothing(tmp_path, 1000):
        assert main([*arguments, "--force"]) == 1
    assert capsys.readouterr().err == f"{output}: cannot be written, File too large.\n"
    assert main([*arguments, "--force", "--max-offset", "1e-5"]) == 1
    assert "expected at most 1e-05 rad" in capsys.readouterr().err
    assert main([*arguments, "--force", "--period", "4"]) == 2  # in ms
    assert re.match(r"option --period: 4 s: .* leave the program by 0\.\d+ rad; expected", capsys.readouterr().err)
    assert main([*arguments, "--force", "--smoothing", "10"]) == 2
    assert "--smoothing: '10' is not" in capsys.readouterr().err
    assert main([*arguments, "--force", "--max-rate", "-1"]) == 2
    assert "'-1' is wrong; expected a number greater than 0" in capsys.readouterr().err
    program.write_text(planned.at_period(0.1).text(as_yaml=False).replace("elbow", "knee"), encoding="utf-8")
    assert main([*arguments, "--force"]) == 1
    assert "knee" in capsys.readouterr().err
