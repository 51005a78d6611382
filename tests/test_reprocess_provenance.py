# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags that name the files they were recorded with, and damaged bags, reprocessed."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from posor.arm_names import find_arm
from posor.bags.bag_writer import BagWriter
from posor.bags.offline_pipeline import load_arm
from posor.bags.provenance import SOFTWARE, custom_data, provenance_of
from posor.bags.reprocess_command import main
from posor.bags.reprocess_task import JointSettings, Settings
from posor.chain.arm_file import load_arm_file
from posor.errors import BagError
from posor.messages.message_definitions import MessageTypes
from posor.ros_names import RAW_SCAN
from rosbags.rosbag2 import Reader

ROOT = Path(__file__).resolve().parents[1]
BAG = ROOT / "bags" / "five_axis"  # simulated


def write_bag(path: Path, hashes: Mapping[str, str], elbow_later_ns: int = 0) -> Path:
    """Write the first raw scans of the five-axis arm as the recorder would."""
    definition = MessageTypes().definition(RAW_SCAN)
    with BagWriter(path, hashes) as writer, Reader(BAG) as reader:
        topics = [connection for connection in reader.connections if connection.msgtype == RAW_SCAN]
        for topic in topics:
            writer.add_topic(topic.topic, RAW_SCAN, definition, [])
        for number, (topic, time_ns, data) in enumerate(islice(reader.messages(topics), 100)):
            writer.write(topic.topic, time_ns + (elbow_later_ns if "elbow" in topic.topic else 0), data)
            if number % 20 == 19:
                writer.flush()
    return path


def warnings(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[str]:
    assert main(list(arguments)) == 0
    return [line.removeprefix("warning: ") for line in capsys.readouterr().out.splitlines() if "warning" in line]


def test_files_that_differ_from_those_of_the_recording_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = find_arm("five_axis")
    arm = load_arm_file(path)
    hashes = provenance_of(Settings.of_arm(arm))
    bag = write_bag(tmp_path / "bag", hashes)
    assert custom_data(bag) == hashes
    assert [file.name for file in sorted(bag.iterdir())] == ["bag_0.mcap", "metadata.yaml"]
    assert warnings(capsys, str(bag), "--arm", str(path), "--output", str(tmp_path / "out")) == []
    assert custom_data(tmp_path / "out") == hashes
    # Comments do not change a calibration.
    elbow = tmp_path / "elbow.yaml"
    elbow.write_text("# a comment\n" + arm.calibrations["elbow"].read_text())
    changed = [str(bag), "--arm", str(path), "--calibration", f"elbow={elbow}"]
    assert warnings(capsys, *changed) == []
    elbow.write_text(elbow.read_text().replace("name: ", "name: other_", 1))
    assert arm.beams is not None
    beams = tmp_path / "beams.yaml"
    beams.write_text(arm.beams.read_text() + "# a comment\n")
    found = warnings(capsys, *changed, "--beams", str(beams))
    assert [line.split(": ")[0] for line in found] == [str(elbow), str(beams)]
    for line, key in zip(found, ("posor.calibration.elbow", "posor.beams"), strict=True):
        assert line.endswith(f"; the bag was recorded with {hashes[key]}")
        assert len(line.split("hash ")[1].split(";")[0]) == 64
        assert hashes[key] not in line.split(";")[0]


def test_a_beams_file_and_sessions_that_are_not_used_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = load_arm_file(find_arm("five_axis"))
    hashes = provenance_of(Settings.of_arm(arm)) | {"posor.session.elbow": "monday"}
    bag = str(write_bag(tmp_path / "bag", hashes))
    files = [f"--calibration={joint}={path}" for joint, path in arm.calibrations.items()]
    monday = {"elbow": JointSettings(arm.calibrations["elbow"], session="monday")}
    assert provenance_of(Settings(monday, None))["posor.session.elbow"] == "monday"
    session = "session of elbow: none; the bag was recorded with monday"
    assert warnings(capsys, bag, *files) == [session]
    beams = f"beams file: none; the bag was recorded with {hashes['posor.beams']}"
    assert warnings(capsys, bag, *files, "--urdf", str(arm.urdf)) == [session, beams]


def test_another_version_of_the_software_is_named_and_a_bag_without_hashes_is_not_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = str(find_arm("five_axis"))
    own = provenance_of(None)[SOFTWARE]
    bag = write_bag(tmp_path / "bag", {SOFTWARE: "posor 0.0.1"})
    assert warnings(capsys, str(bag), "--arm", arm) == [f"this software: {own}; the bag was recorded with posor 0.0.1"]
    assert warnings(capsys, str(write_bag(tmp_path / "plain", {})), "--arm", arm) == []
    assert warnings(capsys, str(bag / "bag_0.mcap"), "--arm", arm) == []


def test_a_joint_without_any_pose_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm = load_arm_file(find_arm("five_axis"))
    bag = write_bag(tmp_path / "bag", {})
    other = [str(bag), "--calibration", f"elbow={arm.calibrations['shoulder']}"]
    (note,) = warnings(capsys, *other)
    assert note.startswith("no scan of elbow has a usable pose: ")
    assert note.endswith("; the calibration may be that of another POSOR")


def test_a_joint_that_is_recorded_at_another_time_after_its_stamps_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = str(find_arm("five_axis"))
    for later_ns, count in ((0, 0), (3_000_000, 0), (20_000_000, 1), (-20_000_000, 1)):
        found = warnings(capsys, str(write_bag(tmp_path / str(later_ns), {}, later_ns)), "--arm", arm)
        assert len(found) == count
        assert all("elbow were recorded" in note for note in found)
        assert all(note.endswith("the stamps of one of them may be wrong by 20 ms") for note in found)


def test_results_name_files_that_differ(tmp_path: Path) -> None:
    arm = load_arm("five_axis")
    used = provenance_of(Settings.of_arm(arm))
    bag = write_bag(tmp_path / "bag", used | {"posor.beams": "0" * 64})
    *_, note = arm.estimate(bag).notes
    assert note == f"{arm.beams}: hash {used['posor.beams']}; the bag was recorded with {'0' * 64}"


@pytest.mark.long
@pytest.mark.timeout(900)
def test_no_flipped_bit_changes_results_without_an_error(tmp_path: Path) -> None:
    arm, bag = load_arm("five_axis"), write_bag(tmp_path / "bag", {})

    def results() -> bytes | str:
        try:
            estimates = arm.estimate(bag)
        except BagError as error:
            return str(error)
        arrays = [array for each in estimates.joints.values() for array in (each.poses, each.covariances())]
        arrays += [estimates.endpoint.poses, estimates.endpoint.covariances()]
        return b"".join(array.tobytes() for array in arrays)

    file, chance, refused = bag / "bag_0.mcap", np.random.default_rng(43), 0
    whole, known = file.read_bytes(), results()
    for _ in range(200):
        data = bytearray(whole)
        data[int(chance.integers(len(data)))] ^= 1 << int(chance.integers(8))
        file.write_bytes(data)
        found = results()
        refused += found != known
        assert found == known or str(found).startswith(f"{file}, byte ")
    print(f"{refused} of 200 files refused, {200 - refused} with the same results")
    assert refused > 100
    shutil.rmtree(bag)
