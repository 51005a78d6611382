# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Files of every version of every format: they load with the same numbers, or say what to change."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from posor.bags.calibration_recording import read_scans
from posor.bags.recover_command import recover
from posor.bags.reprocess_command import main as reprocess
from posor.calibration import calibration_file
from posor.calibration.calibration_file import load_calibration
from posor.chain import arm_file, beams_file
from posor.chain.arm_file import load_arm_file
from posor.chain.beams_file import load_beams
from posor.errors import BagError, CalibrationError
from posor.messages.message_definitions import MessageTypes
from posor.ros_names import RAW_SCAN
from posor_bringup.arms import load_checked_arm
from posor_drivers.simulator.scenario import load_scenario
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.rig_files import calibration_path
from rosbags.rosbag2 import StoragePlugin, Writer

from tests.rig_messages import read_bag_messages

FORMATS = Path(__file__).parent / "formats"
ROOT = Path(__file__).resolve().parents[1]
CONTENT_HASHES = {  # bags and fit records name calibrations by these hashes, so they must not change
    1: "166c0215cec86f9be92629bfb9c688ea19d3085ffa04b3a35cc8487e4df46bc2",
    2: "a75597768bc59c0641c2bdba171e4df15e40b49074751698cd99858cbeedadfc",
    3: "9a94d6c1fe4bbcdda9b8e80c3a19e214641e4cde503da95401d50548eece49f2",
}


def test_there_is_a_file_of_every_version() -> None:
    assert sorted(CONTENT_HASHES) == [*calibration_file.FORMER_VERSIONS, calibration_file.VERSION]
    for version in (*beams_file.FORMER_VERSIONS, beams_file.VERSION):
        assert f"version: {version}\n" in (FORMATS / f"version_{version}/beams.yaml").read_text()
    assert arm_file.VERSION == 1


@pytest.mark.parametrize("version", CONTENT_HASHES)
def test_calibrations_of_every_version_keep_their_content_hash(version: int) -> None:
    calibration = load_calibration(FORMATS / f"version_{version}/calibration.yaml")
    assert (calibration.version, calibration.content_hash) == (version, CONTENT_HASHES[version])
    assert len(calibration.fits) == (version == 2)
    assert (calibration.environment is not None) == (version == 3)


def test_an_arm_of_the_first_version_is_read_with_all_its_files() -> None:
    arm = load_checked_arm(str(FORMATS / "version_1/arm.yaml"))
    assert [joint.name for joint in arm.chain().joints] == ["joint1"]
    assert arm.scenario is not None
    assert load_scenario(arm.scenario).name == "test_rig"
    assert load_calibration(arm.calibrations["joint1"]).version == 1


def test_beams_of_all_versions_are_the_same_but_for_temperature_and_vibration() -> None:
    one, *others = (load_beams(FORMATS / f"version_{version}/beams.yaml").beams[0] for version in (1, 2, 3, 4))
    assert one.temperature is None
    for version, other in enumerate(others, start=2):
        assert other.temperature is not None
        assert (other.thermometer is not None) == (version >= 3)
        assert (other.vibration is not None) == (version == 4)
        rest = other.model_copy(update={"temperature": None, "vibration": None})
        assert one.model_dump(mode="json") == rest.model_dump(mode="json")


def test_a_bag_of_the_first_version_gives_the_same_results_as_that_of_today(tmp_path: Path) -> None:
    old, new = FORMATS / "version_1", ROOT / "bags/ymo"
    assert read_scans(old / "ymo")._records.tobytes() == read_scans(new)._records.tobytes()
    for bag, calibration, name in (
        (old / "ymo", old / "calibration.yaml", "old"),
        (new, calibration_path("printed"), "new"),
    ):
        options = ["--calibration", f"joint1={calibration}", "--session", "joint1=ymo"]
        assert reprocess([str(bag), *options, "--output", str(tmp_path / name)]) == 0
    assert read_bag_messages(tmp_path / "old") == read_bag_messages(tmp_path / "new")
    recover(old / "ymo", tmp_path / "recovered")
    assert read_bag_messages(tmp_path / "recovered") == read_bag_messages(old / "ymo")


def test_a_calibration_from_before_the_kinds_of_maps_says_what_to_add() -> None:
    error = refusal(CalibrationError, load_calibration, FORMATS / "version_1/calibration_without_kinds.yaml")
    assert ", line 75, " in error.where
    assert error.what.startswith("key 'kind' is missing ")
    assert "'polynomial'" in error.expected


@pytest.mark.parametrize(
    ("name", "load", "newest"),
    [
        ("version_3/calibration.yaml", load_calibration, 3),
        ("version_4/beams.yaml", load_beams, 4),
        ("version_1/arm.yaml", load_arm_file, 1),
        ("version_1/scenario.yaml", load_scenario, 1),
    ],
)
def test_a_file_of_a_later_version_says_what_reads_it(
    tmp_path: Path, name: str, load: Callable[[Path], Any], newest: int
) -> None:
    path = tmp_path / "later.yaml"
    path.write_text((FORMATS / name).read_text().replace(f"version: {newest}\n", f"version: {newest + 1}\n", 1))
    error = refusal(CalibrationError, load, path)
    assert error.where.endswith(", key version")
    assert error.expected.endswith(f"or a later release of this software, which reads version {newest + 1}")


def test_a_bag_whose_scans_lack_a_field_names_the_field(tmp_path: Path) -> None:
    text, type_hash = MessageTypes().definition(RAW_SCAN)
    lines = [line for line in text.splitlines() if not line.startswith("float64 supply_voltage")]
    assert len(lines) == len(text.splitlines()) - 1
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/joint1/raw", RAW_SCAN, msgdef="\n".join(lines), rihs01=type_hash)
        writer.write(topic, 1, bytes(200))
    error = refusal(BagError, read_scans, tmp_path / "bag")
    assert error.what == "field supply_voltage of the recorded RawScan is missing"


def test_every_metadata_version_of_rosbag2_that_rosbags_writes_is_read(tmp_path: Path) -> None:
    records = read_bag_messages(ROOT / "bags/ymo")["/joint1/raw"]
    text, type_hash = MessageTypes().definition(RAW_SCAN)
    known = read_scans(ROOT / "bags/ymo", "/joint1/raw")._records.tobytes()
    for version in (8, 9):
        with Writer(tmp_path / f"bag{version}", version=version, storage_plugin=StoragePlugin.SQLITE3) as writer:
            topic = writer.add_connection("/joint1/raw", RAW_SCAN, msgdef=text, rihs01=type_hash)
            for number, data in enumerate(records):
                writer.write(topic, number, data)
        assert read_scans(tmp_path / f"bag{version}")._records.tobytes() == known
