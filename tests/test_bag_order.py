# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The order in which every reader reads a bag: split, overlapping and late recordings of the five-axis arm."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from posor.arm_names import find_arm
from posor.bags import chunk_reader, ordered_reader
from posor.bags.calibration_recording import load_recording, read_scans
from posor.bags.offline_pipeline import load_arm
from posor.bags.read_order import WINDOW_S
from posor.bags.recorded_topics import METADATA
from posor.bags.reprocess_command import main as reprocess
from posor.errors import BagError
from posor.messages.estimate_arrays import ArmEstimates
from posor.messages.message_definitions import MessageTypes
from posor.messages.raw_scan import ScanTemplate, scan_of
from posor.numerics.stamps import NS
from posor_bringup.arms import load_checked_arm
from posor_bringup.view_messages import BagTopics
from posor_calibration.arm.arm_poses import recorded_poses
from posor_drivers.sources.bag_source import BagParameters, BagSource
from posor_drivers.sources.looped_source import LoopedParameters, LoopedSource
from posor_lab.harness.graph import Graph
from posor_lab.harness.program import Program, installed
from posor_lab.harness.recorded_messages import read_bag
from posor_msgs.msg import RawScan
from posor_ros.ros_arguments import ros_arguments
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

BAG = Path(__file__).resolve().parents[1] / "bags/five_axis"
ELBOW = "/five_axis/elbow/raw"
Record = tuple[str, int, bytes]  # topic, log time [ns], message
Files = dict[str, list[Record]]  # in the order in which metadata.yaml lists them


@pytest.fixture(scope="module")
def records() -> list[Record]:
    """Return the raw scans and the endpoint of the first half of the bag."""
    return [each for each in read_bag(BAG) if each[0].endswith(("/raw", "/endpoint/pose"))][:6000]


@pytest.fixture(scope="module")
def recorded(records: list[Record], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bag of these records in one file, as they were logged."""
    return write(tmp_path_factory.mktemp("recorded") / "bag", {"x": records})


def write(folder: Path, files: Mapping[str, Sequence[Record]], storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
    """Write a bag of several files."""
    with Reader(BAG) as reader:
        topics = list(reader.connections)
    suffix, parts = {StoragePlugin.MCAP: ".mcap", StoragePlugin.SQLITE3: ".db3"}[storage], []
    folder.mkdir(parents=True)
    for name, messages in files.items():
        part = folder / name
        with Writer(part, version=9, storage_plugin=storage) as writer:
            to = {
                each.topic: writer.add_connection(each.topic, each.msgtype, msgdef=each.msgdef.data, rihs01=each.digest)
                for each in topics
            }
            for topic, time_ns, data in messages:
                writer.write(to[topic], time_ns, data)
        (part / f"{name}{suffix}").rename(folder / f"{name}{suffix}")
        parts.append(yaml.safe_load((part / METADATA).read_text())["rosbag2_bagfile_information"])
        shutil.rmtree(part)
    whole = parts[0] | {"relative_file_paths": [f"{name}{suffix}" for name in files], "files": []}
    whole["message_count"] = sum(part["message_count"] for part in parts)
    for n, topic in enumerate(whole["topics_with_message_count"]):
        topic["message_count"] = sum(part["topics_with_message_count"][n]["message_count"] for part in parts)
    (folder / METADATA).write_text(yaml.safe_dump({"rosbag2_bagfile_information": whole}))
    return folder


def split(records: Sequence[Record], count: int) -> list[list[Record]]:
    ends = [len(records) * n // count for n in range(count + 1)]
    return [list(records[begin:end]) for begin, end in pairwise(ends)]


def late(records: Iterable[Record], which: Callable[[int], bool], delay_ns: Callable[[int], int]) -> list[Record]:
    """Return the records by log time, some of them logged late."""
    delayed = [
        (topic, time_ns + (delay_ns(n) if which(n) else 0), data) for n, (topic, time_ns, data) in enumerate(records)
    ]
    return sorted(delayed, key=itemgetter(1))


def two_percent_late(records: Sequence[Record]) -> Files:
    chance = np.random.default_rng(3)
    lates = set(chance.choice(len(records), len(records) // 50, replace=False).tolist())
    delays = chance.integers(NS // 1000, round(0.99 * WINDOW_S) * NS, len(records)).tolist()
    return {f"x_{n}": part for n, part in enumerate(split(late(records, lates.__contains__, delays.__getitem__), 3))}


ARRANGEMENTS: dict[str, Callable[[Sequence[Record]], Files]] = {
    "lexical": lambda records: dict(sorted((f"x_{n}", part) for n, part in enumerate(split(records, 12)))),
    "overlapping": lambda records: {
        "x_0": list(records[1::2]),
        "x_1": list(records[:3000:2]),
        "x_2": list(records[3000::2]),
    },
    "an empty file": lambda records: {"x_0": [], "x_1": list(records)},
    "exchanged neighbours": lambda records: {"x": late(records, lambda n: n % 40 < 10, lambda _: 5_000_001)},
    "2 % late": two_percent_late,
    "log clock 2 % slow": lambda records: {
        f"x_{n}": [
            (topic, records[0][1] + (time_ns - records[0][1]) * 98 // 100, data) for topic, time_ns, data in part
        ]
        for n, part in enumerate(split(records, 3))
    },
}


def read_bag_source(bag: Path) -> list[Any]:
    source = BagSource(BagParameters(path=str(bag), topic=ELBOW), MessageTypes())
    source.open()
    return [message.data for message in source.read_messages()]


def read_looped_source(bag: Path) -> list[Any]:
    source = LoopedSource(LoopedParameters(path=str(bag), topic=ELBOW, rate=100), MessageTypes())
    source.open()
    return [source.read_tick(2 * tick)[0].data for tick in range(len(source._scans) // 2)]


READERS: dict[str, Callable[[Path], list[Any]]] = {
    "bag source": read_bag_source,
    "looped source": read_looped_source,
    "calibration": lambda bag: load_recording(bag, topic=ELBOW).scans.numbers.tolist(),
    "read_scans": lambda bag: read_scans(bag, ELBOW).numbers.tolist(),
}


@pytest.fixture(scope="module")
def as_recorded(recorded: Path) -> tuple[dict[str, list[Any]], ArmEstimates]:
    """Return what each reader finds in the bag, and the estimates."""
    return {name: read(recorded) for name, read in READERS.items()}, load_arm("five_axis").estimate(recorded)


@pytest.mark.parametrize(
    ("arrangement", "storage"),
    [(name, StoragePlugin.MCAP) for name in ARRANGEMENTS]
    + [(name, StoragePlugin.SQLITE3) for name in ("lexical", "overlapping", "2 % late")],
)
def test_no_arrangement_of_a_recording_costs_anything(
    arrangement: str,
    storage: StoragePlugin,
    records: list[Record],
    as_recorded: tuple[dict[str, list[Any]], ArmEstimates],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(chunk_reader, "BLOCK_BYTES", 150_000)
    monkeypatch.setattr(ordered_reader, "BLOCK_MESSAGES", 350)
    bag = write(tmp_path / "bag", ARRANGEMENTS[arrangement](records), storage)
    readings, expected = as_recorded
    for name, read in READERS.items():
        assert read(bag) == readings[name], name
    found = load_arm("five_axis").estimate(bag)
    np.testing.assert_array_equal(found.endpoint.poses, expected.endpoint.poses)
    for joint, estimates in expected.joints.items():
        np.testing.assert_array_equal(found.joints[joint].poses, estimates.poses)
        assert np.all(np.diff(found.joints[joint].log_times_ns) >= 0)


def test_the_live_page_shows_the_same_pose_of_a_split_bag(
    records: list[Record], recorded: Path, tmp_path: Path
) -> None:
    bags = {"split": write(tmp_path / "bag", ARRANGEMENTS["lexical"](records)), "whole": recorded}
    shown = [BagTopics(bag, load_checked_arm("five_axis"), tmp_path / name) for name, bag in bags.items()]
    for topics in shown:
        topics.seek(3.5)
    found, expected = ([each.stamp_ns for each in page.store.messages(page.topics.endpoint)] for page in shown)
    assert found == expected


@cache
def template_of(data: bytes) -> tuple[ScanTemplate, int, int]:
    """Return a raw scan to send again, its stamp [ns] and its number; reading all of a bag takes seconds."""
    scan = scan_of(data)
    return ScanTemplate(data), scan.stamp_ns, scan.number


def shifted(
    records: Iterable[Record], *, logged_s: float = 0.0, stamped_s: float = 0.0, number: int = 0
) -> list[Record]:
    """Return records whose log times, stamps and scan numbers are moved."""
    moved = []
    for topic, time_ns, data in records:
        if topic.endswith("/raw"):
            template, stamp_ns, old = template_of(data)
            data = template.at(stamp_ns + round(stamped_s * NS), old + number)  # noqa: PLW2901
        moved.append((topic, time_ns + round(logged_s * NS), data))
    return moved


STARTED_OVER: dict[str, Callable[[Sequence[Record]], Files]] = {
    "replayed again": lambda records: {"x_0": list(records), "x_1": shifted(records, logged_s=20.0)},
    "replayed from the third scan on": lambda records: {"x": [*records, *shifted(records[20:], logged_s=20.0)]},
    "a short replay in a loop": lambda records: {"x": [*records[:900], *shifted(records[:900], logged_s=1.0)]},
    "an earlier day": lambda records: {
        "x": [*records[500:2500], *shifted(records, logged_s=20.0, stamped_s=-86400, number=-7)]
    },
    "a driver that was restarted": lambda records: {
        "x": [*shifted(records[:2500], number=9000), *shifted(records[2500:], number=-990)]
    },
    "a late recorder of simulated time": lambda records: {"x": [*records[3000:], *shifted(records, logged_s=20.0)]},
}


@pytest.mark.parametrize("make", STARTED_OVER.values(), ids=STARTED_OVER.keys())
def test_a_recording_that_starts_over_is_read_as_it_was_logged(
    make: Callable[[Sequence[Record]], Files], records: list[Record], tmp_path: Path
) -> None:
    files = make(records)
    logged = [data for part in files.values() for topic, _, data in part if topic == ELBOW]
    assert read_bag_source(write(tmp_path / "bag", files)) == logged


def test_scans_that_are_read_twice_are_noted(records: list[Record], tmp_path: Path) -> None:
    arm = load_arm("five_axis")
    twice = write(tmp_path / "bag", {"x": [*records[:900], *shifted(records[:900], logged_s=1.0)]})
    whole, found = arm.estimate(BAG), arm.estimate(twice)
    assert [note.partition(" of base_swivel")[0] for note in whole.notes] == [
        "scans without a usable pose: 5 of 2,000",
        "stamps without a transform of each joint: 4; missing 1 of elbow, 1 of wrist_roll, 2 of wrist_yaw",
    ]
    assert found.notes[0].startswith("scans without a usable pose: 12 of 302 of base_swivel (the first UNCOUNTED), ")
    assert [note.partition(", as")[0] for note in found.notes[1:]] == [
        f"stamps of {joint} that are not after the one before: 1" for joint in arm.calibrations
    ]
    whole.endpoint_of_one_run("bag")
    with pytest.raises(BagError, match=r"bag: poses of base_swivel at \d+ ns are followed by those at \d+ ns"):
        found.endpoint_of_one_run("bag")
    with pytest.raises(BagError, match=r"bag: poses of base_swivel at"):
        recorded_poses(found, arm.chain(), found.endpoint.stamps_ns[:1], np.array([1]), 0.1, "bag")


@pytest.mark.parametrize("step_s", [0.02, 0.5, 3.0])
def test_scans_of_a_clock_that_is_set_back_are_read_in_the_order_of_their_numbers(
    step_s: float, records: list[Record], tmp_path: Path
) -> None:
    after = shifted(records[4500:], logged_s=-step_s, stamped_s=-step_s)
    made = [*records[:4500], *after]
    bag = write(tmp_path / "bag", {"x": made})
    assert read_bag_source(bag) == [data for topic, _, data in made if topic == ELBOW]


REFUSED: dict[str, tuple[Callable[[Sequence[Record]], Files], str]] = {
    "log times that contradict the numbers": (
        lambda records: {"x_0": shifted(records[:2500], logged_s=30.0), "x_1": list(records[2500:])},
        r"scan \d+ of \S+/raw in x_0.mcap is logged after scan \d+ in x_1.mcap; expected .* at most 5 s late\.",
    ),
    "a file between that was logged last": (
        lambda records: {
            "x_0": list(records[:1500]),
            "x_1": shifted(records[1500:3000], logged_s=30.0),
            "x_2": list(records[3000:]),
        },
        r"scan \d+ of .* in x_1.mcap is logged after scan \d+ in x_2.mcap; .*",
    ),
    "one scan beyond the window": (
        lambda records: {
            "x_0": list(records[:2000]),
            "x_1": [*records[2010:], *shifted(records[2000:2010], logged_s=9.0)],
        },
        r"scan \d+ of .* in x_1.mcap is logged after scan \d+ in x_1.mcap; .*",
    ),
    "scans in two files": (
        lambda records: {"x_0": list(records[:2510]), "x_1": list(records[2500:])},
        r"scan \d+ of .* is in x_0.mcap and in x_1.mcap; expected every scan in one file\.",
    ),
    "a copied file": (
        lambda records: {"x_0": list(records[:2500]), "x_1": list(records[2500:]), "x_2": list(records[2000:3000])},
        r"scan \d+ of .* is in x_0.mcap and in x_2.mcap; .*",
    ),
    "files without log times": (
        lambda records: {"x_0": [(topic, 0, data) for topic, _, data in records[:2500]], "x_1": list(records[2500:])},
        r"messages of x_0.mcap have no log time, so that they are neither before nor after x_1.mcap; expected files .*",
    ),
}


@pytest.mark.parametrize(("make", "sentence"), REFUSED.values(), ids=REFUSED.keys())
def test_a_bag_of_unknown_order_is_refused_with_both_files(
    make: Callable[[Sequence[Record]], Files],
    sentence: str,
    records: list[Record],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bag = write(tmp_path / "bag", make(records))
    for read in READERS.values():
        with pytest.raises(BagError):
            read(bag)
    options = ["--arm", str(find_arm("five_axis")), "--output", str(tmp_path / "out")]
    assert reprocess([str(bag), *options]) == 1
    assert re.fullmatch(f"{bag}: {sentence}\n", capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("ros_domain")
def test_driver_node_replays_a_split_bag_in_order_and_refuses_one_of_unknown_order(
    records: list[Record], tmp_path: Path
) -> None:
    def driver(bag: Path, **parameters: object) -> Program:
        own = {"source": "bag", "bag.path": str(bag), "bag.topic": ELBOW, "lossless": True}
        return Program([*installed("posor_drivers", "driver_node"), *ros_arguments(own | parameters, "/joint1")])

    parts = {f"x_{n}": part for n, part in enumerate(split(records[:1200], 3))}
    late_parts = {"x_0": shifted(parts["x_0"], logged_s=30.0), "x_1": parts["x_1"]}
    with Graph() as graph:
        raw = graph.collect(RawScan, "/joint1/raw", raw=True)
        with driver(write(tmp_path / "bag", dict(reversed(parts.items())))) as program:
            expected = [data for topic, _, data in records[:1200] if topic == ELBOW]
            graph.wait_until(lambda: len(raw) == len(expected), "all scans")
            assert program.wait() == 0
    assert raw == expected
    with driver(write(tmp_path / "unknown", late_parts), wait_for_subscribers=0) as program:
        assert program.wait() == 1
        assert "x_0.mcap is logged after scan" in program.errors[-1]


def test_a_file_that_metadata_do_not_list_is_refused(records: list[Record], tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", {"x_0": records})
    shutil.copy(bag / "x_0.mcap", bag / "x_1.mcap")
    with pytest.raises(BagError, match=r"metadata.yaml does not list x_1.mcap, but x_0.mcap; expected all files of"):
        read_scans(bag, ELBOW)


def test_a_scan_that_is_twice_in_one_file_is_read_twice(records: list[Record], tmp_path: Path) -> None:
    elbow = [record for record in records if record[0] == ELBOW]
    bag = write(tmp_path / "bag", {"x": sorted([*elbow, *shifted(elbow[7::500], logged_s=0.1)], key=itemgetter(1))})
    numbers = [scan_of(data).number for data in read_bag_source(bag)]
    assert numbers == sorted(numbers)
    assert len(numbers) == len(elbow) + len(elbow[7::500])
