# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reprocessed bags against the core, scan by scan; formats, summary and complaints of the program.

``test_bag_five_axis`` compares them with the live graph.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from geometry_msgs.msg import PoseStamped
from posor.arm_names import find_arm
from posor.bags.bag_writer import BagWriter
from posor.bags.reprocess_command import main
from posor.messages.message_definitions import Definition
from posor.model.fault import State
from posor.ros_names import RAW_SCAN
from posor_bringup.arms import load_checked_arm
from posor_lab.harness.full_disk import full_disk_changes_nothing
from posor_lab.harness.message_conversion import pose_from_message
from posor_lab.harness.rig_files import calibration_path, urdf_path
from posor_msgs.msg import JointTransform
from rclpy.serialization import deserialize_message
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from tests.rig_messages import (
    all_message_bits,
    estimate_endpoints,
    estimate_transforms,
    make_plan,
    message_bits,
    read_bag_messages,
)

BAGS = Path(__file__).resolve().parents[1] / "bags"
BAG = BAGS / "five_axis"
JOINTS = ("base_swivel", "shoulder", "elbow", "wrist_roll", "wrist_yaw")
ARM = ["--arm", str(find_arm("five_axis"))]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Reprocess the bag of the five-axis arm into each format."""
    folder = tmp_path_factory.mktemp("made")
    for kind in ("bag", "parquet", "csv"):
        assert main([str(BAG), *ARM, "--output", str(folder / kind), "--format", kind]) == 0
    assert sorted(path.name for path in folder.iterdir()) == ["bag", "csv", "parquet"]
    return folder


@pytest.mark.parametrize("calibration", ["printed", "section84"])
@pytest.mark.parametrize("test", ["ymo", "yzmo", "zmo"])
def test_the_1985_bags_give_the_results_of_the_replays(test: Any, calibration: Any, tmp_path: Path) -> None:
    plan = make_plan(tmp_path / "rig", test, calibration)
    options = ["--calibration", f"joint1={calibration_path(calibration)}", "--session", f"joint1={test}"]
    assert main([str(plan.bag), *options, "--urdf", str(urdf_path()), "--output", str(tmp_path / "out")]) == 0
    found = read_bag_messages(tmp_path / "out")
    transforms = estimate_transforms(plan, read_bag_messages(plan.bag)["/joint1/raw"])
    assert all_message_bits(JointTransform, found["/joint1/transform"]) == [message_bits(each) for each in transforms]
    poses: Any = all_message_bits(PoseStamped, found["/endpoint/pose"])
    assert [pose["pose"] for pose in poses] == [message_bits(pose) for pose in estimate_endpoints(plan, transforms)]


def test_messages_keep_the_log_time_and_quality_of_service_of_the_scans(made: Path) -> None:
    def read(bag: Path) -> tuple[dict[str, list[int]], dict[str, Any]]:
        times: dict[str, list[int]] = {}
        with Reader(bag) as reader:
            for connection, time_ns, _ in reader.messages():
                times.setdefault(connection.topic, []).append(time_ns)
            return times, {connection.topic: connection.ext for connection in reader.connections}

    (times, offered), (found, given) = read(BAG), read(made / "bag")
    for joint in JOINTS:
        assert found[f"/five_axis/{joint}/transform"] == times[f"/five_axis/{joint}/raw"]
        assert given[f"/five_axis/{joint}/transform"] == offered[f"/five_axis/{joint}/raw"]
    assert set(found["/five_axis/endpoint/pose"]) <= set(times["/five_axis/elbow/raw"])
    assert given["/five_axis/endpoint/pose"].offered_qos_profiles[0].reliability.name == "RELIABLE"


@pytest.mark.long
def test_tables_and_bag_hold_the_same_numbers(made: Path) -> None:
    messages = read_bag_messages(made / "bag")
    for joint in JOINTS:
        tables = [
            pa.parquet.read_table(made / "parquet" / f"{joint}.parquet"),
            pa.csv.read_csv(made / "csv" / f"{joint}.csv"),
        ]
        fields: Any = all_message_bits(JointTransform, messages[f"/five_axis/{joint}/transform"])
        for table in tables:
            columns = {name: table[name].to_numpy() for name in table.column_names}
            assert len(columns["scan"]) == len(fields)
            lost = columns["state"] == State.LOST
            assert np.isnan(columns["x"][lost].astype(float)).all()
            for n, field in enumerate(fields):
                position, native = field["pose"]["position"], np.frombuffer(field["native"])
                assert columns["scan"][n] == np.frombuffer(field["scan"], dtype=np.int64)[0]
                for axis in "xyz":
                    np.testing.assert_array_equal(float(columns[axis][n]), np.frombuffer(position[axis])[0])
                np.testing.assert_array_equal(float(columns["native_theta"][n]), native[5])
                for part in ("random", "systematic"):
                    covariance = np.frombuffer(field[f"covariance_{part}"]).reshape(6, 6)
                    np.testing.assert_array_equal(float(columns[f"cov_{part}_y_rz"][n]), covariance[1, 5])
    poses: Any = all_message_bits(PoseStamped, messages["/five_axis/endpoint/pose"])
    table = pa.parquet.read_table(made / "parquet" / "endpoint.parquet")
    assert table["qw"].to_numpy().tobytes() == b"".join(pose["pose"]["orientation"]["w"] for pose in poses)


def test_home_is_the_first_pose(made: Path, tmp_path: Path) -> None:
    assert main([str(BAG), *ARM, "--reference", "home", "--output", str(tmp_path / "out")]) == 0
    topic = "/five_axis/endpoint/pose"
    relative, absolute = (
        [deserialize_message(data, PoseStamped) for data in read_bag_messages(bag)[topic]]
        for bag in (tmp_path / "out", made / "bag")
    )
    assert {pose.header.frame_id for pose in relative} == {"endpoint_home"}
    home = pose_from_message(absolute[0].pose)
    for one, other in zip(relative, absolute, strict=True):
        expected = home.inverse() * pose_from_message(other.pose)
        np.testing.assert_allclose(pose_from_message(one.pose).homogeneous, expected.homogeneous, rtol=0.0, atol=1e-12)


def test_the_summary_counts_lost_scans(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(BAG), *ARM, "--false-alarm", "0.1"]) == 0
    said = capsys.readouterr().out
    assert "│ elbow       │ 1,999 │    4 │       1 │           9 │ residual 4" in said
    assert "endpoint: 1,986 poses, 0 of them degraded; no pose at 10 complete stamps, and 4 incomplete ones" in said
    assert "no --output: nothing is written" in said


@pytest.mark.long
def test_several_bags_at_a_time_give_the_same_bytes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bags = [str(BAGS / name) for name in ("ymo", "yzmo", "zmo")]
    options = ["--calibration", f"joint1={calibration_path('printed')}", "--format", "csv", "--output"]
    for jobs in ("1", "2"):
        assert main([*bags, *options, str(tmp_path / jobs), "--jobs", jobs]) == 0
    for name in ("ymo", "yzmo", "zmo"):
        one, two = (tmp_path / jobs / name / "joint1.csv" for jobs in "12")
        assert one.read_bytes() == two.read_bytes()
    assert capsys.readouterr().out.count("scans/s per core") == 6


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(list(arguments)) != 0
    said = capsys.readouterr().err.removesuffix("\n")
    assert said
    assert "\n" not in said
    return said


CALIBRATION = ["--calibration", f"joint1={calibration_path('printed')}"]
YMO = str(BAGS / "ymo")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere", *CALIBRATION], "nowhere: does not exist; expected a rosbag2 bag"),
        ([YMO], "reprocess: no joint is named; expected --arm FILE, or --calibration JOINT=FILE."),
        (
            [YMO, *ARM],
            "ymo: there are no scans of joint base_swivel on .../base_swivel/raw; expected one of /joint1/raw.",
        ),
        ([YMO, "--calibration", "joint1=nowhere.yaml"], "nowhere.yaml"),
        ([YMO, "--calibration", "joint1"], "option --calibration: 'joint1'; expected JOINT=..., such as elbow=..."),
        ([YMO, *CALIBRATION, *CALIBRATION], "option --calibration: joint joint1 is named twice; expected once."),
        (
            [YMO, *CALIBRATION, "--session", "elbow=ymo"],
            "option --session: there is no joint elbow; expected one of joint1.",
        ),
        ([YMO, *CALIBRATION, "--session", "joint1=none"], "none"),
        ([YMO, *CALIBRATION, "--topic", "joint1=/truth/machining_centre"], "is of type geometry_msgs/msg/PointStamped"),
        ([YMO, *CALIBRATION, "--topic", "joint1=/elbow/raw"], "there is no topic /elbow/raw; expected one of"),
        (
            [YMO, *CALIBRATION, "--beams", "beams.yaml"],
            "option --beams: there is no robot description; expected --urdf too.",
        ),
        ([YMO, *CALIBRATION, "--false-alarm", "2"], "false_alarm: 2; expected between 0 and 1."),
        ([YMO, *CALIBRATION, "--jobs", "0"], "argument --jobs: "),
        (
            [YMO, YMO, *CALIBRATION, "--output", "out"],
            "option --output: two bags are called ymo; expected bags of different",
        ),
        (
            [YMO, *CALIBRATION, "--scheduler", "tcp://127.0.0.1:9"],
            "option --scheduler: no Dask scheduler answers at tcp://127.0.0.1:9; expected an address such as tls://host:87",
        ),
        *(
            (
                [YMO, *CALIBRATION, "--scheduler", each],
                f"--scheduler: '{each}'; expected an address such as tls://host:8",
            )
            for each in (
                "localhost",
                "localhost:8786",
                "tcp://host",
                "tcp://:8786",
                "http://host:8786",
                "tcp://host:99999",
            )
        ),
        *(
            (
                [YMO, *CALIBRATION, "--scheduler", each],
                f"{each} is on another machine and not encrypted: whoever reaches it runs code on its workers; exp",
            )
            for each in ("tcp://host:8786", "ws://192.168.0.1:8786", "tcp://[fe80::1]:8786")
        ),
        (
            [YMO, *CALIBRATION, "--scheduler", f"tcp://{socket.gethostname()}:9", "--unencrypted"],
            f"option --scheduler: no Dask scheduler answers at tcp://{socket.gethostname()}:9; ",
        ),
        (
            [YMO, *CALIBRATION, "--scheduler", "tls://127.0.0.1:9"],
            "option --scheduler: there are no certificates for TLS; expected 'distributed.comm.tls' in Dask's",
        ),
        ([str(BAG), *ARM, *CALIBRATION], "there are no scans of joint joint1"),
    ],
    ids=lambda value: "" if isinstance(value, list) else value[:40],
)
def test_an_invalid_command_line_is_refused_in_one_sentence(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posor.bags.executors.CONNECT_WITHIN_S", 1)
    assert said in refused(capsys, *arguments)


def test_a_server_that_does_not_answer_is_no_scheduler(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posor.bags.executors.CONNECT_WITHIN_S", 1)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        said = refused(capsys, YMO, *CALIBRATION, "--scheduler", address)
    assert said.startswith(f"option --scheduler: no Dask scheduler answers at {address}; expected an address such as")


def test_a_bag_of_results_holds_no_raw_scans(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert refused(capsys, str(made / "bag"), *ARM) == (
        f"{made / 'bag'}: there are no raw scans of joint base_swivel, nor of any other; "
        "expected a bag of recorded raw scans."
    )


def test_a_calibration_between_other_frames_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    elbow = load_checked_arm("five_axis").calibrations["elbow"]
    said = refused(capsys, str(BAG), *ARM, "--calibration", f"shoulder={elbow}")
    assert (
        "the calibration of shoulder is from 'elbow_receiving' to 'elbow_target'; expected 'shoulder_receiving'" in said
    )


def test_a_full_disk_keeps_the_former_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "out"
    assert main([YMO, *CALIBRATION, "--output", str(output)]) == 0
    with full_disk_changes_nothing(output, 100_000):
        said = refused(capsys, str(BAG), *ARM, "--output", str(output), "--force")
    assert said == f"{output}: cannot be written, File too large."
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def without_stamp(bag: Path, topic: str, number: int, stamp: Callable[[bytes], bytes], folder: Path) -> Path:
    """Return a copy of a bag in which one message of a topic has another stamp, made of its own."""
    with Reader(bag) as reader, Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        to = {
            each.id: writer.add_connection(each.topic, each.msgtype, msgdef=each.msgdef.data, rihs01=each.digest)
            for each in reader.connections
        }
        seen = 0
        for each, time_ns, data in reader.messages():
            seen += each.topic == topic
            unstamped = each.topic == topic and seen == number
            writer.write(to[each.id], time_ns, data[:4] + stamp(data[4:12]) + data[12:] if unstamped else data)
    return folder


@pytest.mark.parametrize(
    "stamp", [lambda _own: bytes(8), lambda own: own[:4] + struct.pack("<I", 1_000_000_000)], ids=["zero", "no time"]
)
def test_a_scan_without_a_stamp_costs_its_own_pose_only(
    made: Path, stamp: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    bag = without_stamp(BAG, "/five_axis/elbow/raw", 500, stamp, tmp_path / "bag")
    assert main([str(bag), *ARM, "--output", str(tmp_path / "out")]) == 0
    topic = "/five_axis/endpoint/pose"
    whole, found = (len(read_bag_messages(each)[topic]) for each in (made / "bag", tmp_path / "out"))
    assert found == whole - 1


def test_a_topic_that_holds_another_type_too_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with (
        Reader(BAGS / "ymo") as reader,
        Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        for each in reader.connections:
            to = writer.add_connection("/joint1/raw", each.msgtype, msgdef=each.msgdef.data, rihs01=each.digest)
            for _, time_ns, data in reader.messages([each]):
                writer.write(to, time_ns, data)
    assert refused(capsys, str(tmp_path / "bag"), *CALIBRATION) == (
        f"{tmp_path / 'bag'}: topic /joint1/raw holds messages of several types, geometry_msgs/msg/PointStamped, "
        "posor_msgs/msg/RawScan; expected only posor_msgs/msg/RawScan."
    )


def cut_short(bag: Path, folder: Path) -> Path:
    """Return a copy of a bag whose last messages are not there, as its index still says."""
    whole = (bag / "five_axis_0.mcap").read_bytes()
    folder.mkdir()
    (folder / "metadata.yaml").write_bytes((bag / "metadata.yaml").read_bytes())
    (folder / "five_axis_0.mcap").write_bytes(whole[: len(whole) // 2])
    return folder


def test_a_bag_that_is_cut_short_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = cut_short(BAG, tmp_path / "cut")
    said = refused(capsys, str(bag), *ARM, "--output", str(tmp_path / "out"))
    assert "the file was not closed or is cut short; expected an undamaged file; 'recover'" in said
    assert [path.name for path in tmp_path.iterdir()] == ["cut"]


COARSE_NS = 10_000_000
Logged = tuple[str, int, bytes]  # topic, log time [ns], message


def raw_scans(bag: Path) -> tuple[list[Connection], list[Logged]]:
    """Return the topics of raw scans, and the scans in the order of a replay."""
    with Reader(bag) as reader:
        topics = [connection for connection in reader.connections if connection.topic.endswith("/raw")]
        return topics, [(each.topic, time_ns, bytes(data)) for each, time_ns, data in reader.messages(topics)]


def write_chunks(folder: Path, topics: Sequence[Connection], chunks: Sequence[Sequence[Logged]]) -> Path:
    with BagWriter(folder) as writer:
        for each in topics:
            writer.add_topic(each.topic, each.msgtype, Definition(each.msgdef.data, each.digest))
        for chunk in chunks:
            for topic, time_ns, data in chunk:
                writer.write(topic, time_ns, data)
            writer.flush()
    return folder


def test_scans_of_one_log_time_in_chunks_that_overlap_are_taken_as_a_replay_takes_them(tmp_path: Path) -> None:
    """Two scans a tick of 10 ms; a tick is split between two chunks, of which the second one begins first."""
    topics, (first, *scans) = raw_scans(BAG)
    coarse = [(topic, time_ns // COARSE_NS * COARSE_NS, data) for topic, time_ns, data in scans]
    logged = [scan[:2] for scan in coarse]
    middle = next(n for n in range(len(logged) // 2, len(logged)) if logged[n] in logged[n - len(topics) : n])
    chunks = [coarse[:middle], [*coarse[middle:], (first[0], coarse[0][1] - 1, first[2])]]
    bag = write_chunks(tmp_path / "bag", topics, chunks)
    replayed = write_chunks(tmp_path / "replayed", topics, [raw_scans(bag)[1]])
    for each in (bag, replayed):
        assert main([str(each), *ARM, "--output", str(tmp_path / "out" / each.name)]) == 0
    found, expected = (read_bag_messages(tmp_path / "out" / each.name) for each in (bag, replayed))
    assert len(expected["/five_axis/endpoint/pose"]) == len(read_bag_messages(BAG)["/five_axis/endpoint/pose"])
    assert found == expected


def changed_bag(path: Path, joint: str, change: Callable[[Connection, bytes], tuple[Connection, bytes]]) -> Path:
    """Write the first scans of the bag, those of a joint changed."""
    with Reader(BAG) as reader:
        logged = [
            change(each, data) if each.topic.endswith(f"/{joint}/raw") else (each, data)
            for each, _, data in islice(reader.messages([c for c in reader.connections if c.msgtype == RAW_SCAN]), 200)
        ]
    topics = {each.topic: each for each, _ in logged}
    return write_chunks(path, list(topics.values()), [[(each.topic, 1, data) for each, data in logged]])


def test_a_topic_of_the_right_name_and_another_type_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Reader(BAG) as reader:
        pose = next(each for each in reader.connections if each.msgtype == "geometry_msgs/msg/PoseStamped")
    bag = changed_bag(tmp_path / "bag", "elbow", lambda scan, data: (pose._replace(topic=scan.topic), data))
    assert refused(capsys, str(bag), *ARM) == (
        f"{bag}: topic /five_axis/elbow/raw has the type geometry_msgs/msg/PoseStamped; "
        "expected posor_msgs/msg/RawScan, or --topic elbow=TOPIC."
    )


def test_joints_without_a_common_stamp_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def shift(scan: Connection, data: bytes) -> tuple[Connection, bytes]:
        return scan, data[:8] + struct.pack("<I", struct.unpack("<I", data[8:12])[0] + 1) + data[12:]

    bag = changed_bag(tmp_path / "bag", "elbow", shift)
    assert main([str(bag), *ARM]) == 0
    assert "warning: the joints have no stamp in common, which an endpoint needs\n" in capsys.readouterr().out
