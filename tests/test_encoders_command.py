# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor encoders: the backlash of the simulated arm in its bag, and inputs that are refused."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from posor.bags.recorded_encoders import RecordedEncoders, read_encoders
from posor.chain.arm_file import load_arm_file
from posor.correction import encoder_errors
from posor.errors import BagError, ParameterError
from posor.numerics.array_types import FloatArray, IntArray
from posor_bringup.encoders_command import HEADER, find_errors, main, parse_options
from posor_drivers.simulator.scenario import load_scenario
from posor_lab.harness.full_disk import full_disk_changes_nothing
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

BAG = Path(__file__).resolve().parents[1] / "bags" / "five_axis"
OPTIONS = ["five_axis", "--bag", str(BAG), "--topic", "/five_axis/encoders"]


def test_the_backlash_of_the_recorded_arm_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = load_scenario(load_arm_file("five_axis").scenario or Path())
    output = tmp_path / "new" / "encoders.csv"
    assert main([*OPTIONS, "--output", str(output), "--bins", "12"]) == 0
    text = capsys.readouterr().out
    assert all(joint in text for joint in scenario.joints)
    header, *rows = csv.reader(output.open(encoding="utf-8"))
    assert tuple(header) == HEADER
    assert {row[0] for row in rows} == set(scenario.joints)
    assert {row[1] for row in rows} == {"1", "-1"}
    found = find_errors(parse_options(OPTIONS))
    for name, joint in scenario.joints.items():
        assert joint.gear is not None
        assert found[name].backlash == pytest.approx(joint.gear.backlash.number, rel=0.02)
        assert found[name].rest < 1e-5


def test_a_full_disk_keeps_the_former_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "encoders.csv"
    output.write_text(",".join(HEADER) + "\n", encoding="utf-8")
    with full_disk_changes_nothing(tmp_path, 1000):
        assert main([*OPTIONS, "--output", str(output)]) == 1
    assert capsys.readouterr().err == f"{output}: cannot be written, File too large.\n"


def test_a_file_that_is_no_table_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "arm.yaml"
    output.write_text("format: posor_arm\n", encoding="utf-8")
    assert main([*OPTIONS, "--output", str(output)]) == 1
    assert capsys.readouterr().err == f"{output}: is no table of this program; expected another name.\n"
    assert output.read_text(encoding="utf-8") == "format: posor_arm\n"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--topic", "/five_axis/joint_states"], "holds the angles that the POSORs have measured"),
        (["--topic", "/five_axis/target/endpoint"], "is of type geometry_msgs/msg/PoseStamped"),
        (["--names", "a,b"], "2 names"),
        (["--names", "a,b,c,d,e"], "no reading of a, b, c, d, e"),
        (["--bins", "0"], "argument --bins: "),
        (
            ["--names", "base_swivel,elbow,shoulder,wrist_roll,wrist_yaw"],
            "the encoder of joint shoulder follows the POSOR of 'elbow': readings of another joint; expected its own",
        ),
    ],
)
def test_an_input_that_cannot_be_used_is_one_sentence(
    options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*OPTIONS, *options]) != 0
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "clause"),
    [
        (lambda x: -x, "turns against its POSOR: wrong sign"),
        (np.degrees, "reads degrees; expected rad"),
        (lambda x: 2.0 * x, "turns 2 times as far as its POSOR: wrong scale"),
        (lambda x: x + 0.006 * (np.arange(len(x)) > 700), "has jumped by +0.00"),
        (lambda x: np.where(np.arange(len(x)) > 700, x[700], x), "does not follow its POSOR"),
    ],
)
def test_an_encoder_with_another_sign_scale_or_tooth_is_refused(
    change: Callable[[FloatArray], FloatArray], clause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(self: RecordedEncoders, joint: int, stamps_ns: IntArray) -> FloatArray:
        found = sound(self, joint, stamps_ns)
        return np.column_stack([change(found[:, 0]), found[:, 1]]) if joint == 1 else found

    sound = RecordedEncoders.at
    monkeypatch.setattr(RecordedEncoders, "at", wrong)
    with pytest.raises(ParameterError) as caught:
        find_errors(parse_options(OPTIONS))
    assert caught.value.what.startswith(f"the encoder of joint shoulder {clause}")


def read_late(monkeypatch: pytest.MonkeyPatch, lateness_ms: int) -> None:
    """Let all readings have the angles of a time before."""

    def late(self: RecordedEncoders, joint: int, stamps_ns: IntArray) -> FloatArray:
        return sound(self, joint, stamps_ns - lateness_ms * 1_000_000)

    sound = RecordedEncoders.at
    monkeypatch.setattr(RecordedEncoders, "at", late)


@pytest.mark.parametrize("lateness_ms", [-2, 2])
def test_late_readings_are_no_backlash(lateness_ms: int, monkeypatch: pytest.MonkeyPatch) -> None:
    sound = find_errors(parse_options(OPTIONS))
    read_late(monkeypatch, lateness_ms)
    for joint, found in find_errors(parse_options(OPTIONS)).items():
        assert found.lateness - sound[joint].lateness == pytest.approx(1e-3 * lateness_ms, abs=1e-5)
        assert found.backlash == pytest.approx(sound[joint].backlash, abs=2e-6)


@pytest.mark.parametrize(("lateness_ms", "word"), [(-20, "early"), (20, "late")])
def test_readings_that_are_too_late_are_refused(lateness_ms: int, word: str, monkeypatch: pytest.MonkeyPatch) -> None:
    read_late(monkeypatch, lateness_ms)
    with pytest.raises(ParameterError, match=rf"the encoder of joint base_swivel: its readings are \S+ ms {word}"):
        find_errors(parse_options(OPTIONS))


def test_late_readings_at_one_speed_are_refused_by_their_negative_backlash(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(encoder_errors, "LEAST_CHANGE", math.inf)
    read_late(monkeypatch, 20)
    with pytest.raises(ParameterError, match=r"base_swivel: the backlash would be -\d+ µrad: its readings are late"):
        find_errors(parse_options(OPTIONS))


def test_results_have_the_whole_name_of_their_bag(tmp_path: Path) -> None:
    dated = tmp_path / "run.2026.11"
    dated.symlink_to(BAG)
    assert parse_options([*OPTIONS[:2], str(dated), *OPTIONS[3:]]).output == Path("build/encoders/five_axis.csv")
    shutil.copytree(BAG, tmp_path / "run.2026.12")
    options = parse_options([*OPTIONS[:2], str(tmp_path / "run.2026.12"), *OPTIONS[3:]])
    assert options.output == Path("build/encoders/run.2026.12.csv")


def test_readings_that_are_too_far_apart_are_refused(tmp_path: Path) -> None:
    """Without it no angle lies between two of them, and no joint seems to move."""
    slow = tmp_path / "bag"
    with Reader(BAG) as reader, Writer(slow, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        (topic,) = (each for each in reader.connections if each.topic == OPTIONS[-1])
        to = writer.add_connection(topic.topic, topic.msgtype, msgdef=topic.msgdef.data, rihs01=topic.digest)
        for _, time_ns, data in islice(reader.messages([topic]), 0, None, 20):
            writer.write(to, time_ns, data)
    with pytest.raises(BagError, match=r"readings of elbow are \S+ s apart; expected at most 0.05 s"):
        read_encoders(slow, OPTIONS[-1], ("elbow",), "/five_axis")


def test_readings_are_found_by_name() -> None:
    both, one = (
        read_encoders(BAG, OPTIONS[-1], names, "/five_axis") for names in (("elbow", "shoulder"), ("shoulder",))
    )
    assert (both.positions[:, 1] == one.positions[:, 0]).all()
    assert (both.positions[:, 0] != both.positions[:, 1]).any()
