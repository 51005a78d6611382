# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor iso9283: figures of a simulated motion against an independent script on the same points, and refusals."""

from __future__ import annotations

import csv
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseStamped
from posor.bags.bag_writer import replace_bag
from posor.chain.arm_file import load_arm_file
from posor.messages.message_definitions import MessageTypes
from posor.numerics.stamps import NS
from posor.ros_names import POSE_STAMPED
from posor_bringup.iso9283_command import OUTPUT_FILES, main
from posor_lab.harness.beams import quantity
from posor_lab.harness.full_disk import full_disk_changes_nothing
from posor_lab.harness.iso9283_by_hand import figures_of
from posor_ros.qos import RELIABLE_QOS
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation

from bags.make_arm_bag import ArmBag

RIG = Path(__file__).resolve().parents[1] / "ros2_ws" / "src" / "posor_bringup" / "arms" / "test_rig"
REFERENCE = "/test_rig/truth/endpoint"
LATER = (4 * 10**18, 4 * 10**18 + NS)  # a dwell after the recording
CYCLES, ANGLES = 3, (0.02, -0.01, 0.0)
REST_S, MOVE_S, RATE_HZ = 0.3, 0.25, 100


def motion() -> list[Any]:
    """Rest at zero, then in turn at each angle."""
    still = {"kind": "rest", "duration": quantity(REST_S, "s")}
    phases: list[Any] = [still]
    for angle in ANGLES * CYCLES:
        through = quantity([[angle]], "rad")
        move = {"kind": "spline", "duration": quantity(MOVE_S, "s"), "joints": ["joint1"], "through": through}
        phases += [move, still]
    return phases


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    scenario = yaml.safe_load((RIG / "scenario.yaml").read_text(encoding="utf-8"))
    duration = REST_S + len(ANGLES) * CYCLES * (REST_S + MOVE_S)
    scenario |= {"motion": motion(), "duration": quantity(round(duration, 6), "s")}
    scenario["rate"]["value"] = RATE_HZ
    del scenario["electronics"]["zero_drift"], scenario["electronics"]["dropouts"]
    del scenario["electronics"]["supply"]
    (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario), encoding="utf-8")
    content = yaml.safe_load((RIG / "arm.yaml").read_text(encoding="utf-8"))
    content |= {"urdf": str(RIG / content["urdf"]), "beams": str(RIG / content["beams"])}
    for joint in content["joints"].values():
        joint["calibration"] = str(RIG / joint["calibration"])
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def write_bag(
    arm: Path, folder: Path, unit: float = 1.0, lead_ns: int = 0, turn: float = 0.0, least_ns: int = 0
) -> Path:
    """Write a recording; its reference is in a unit [m], ahead of the arm as a command is, and turned about X [rad].

    ``least_ns``: between two of its readings.
    """
    types, last_ns = MessageTypes(), -NS
    made = ArmBag(load_arm_file(arm), types)
    with replace_bag(folder) as writer:
        for topic in made.topics():
            writer.add_topic(topic.name, topic.type_name, types.definition(topic.type_name), [RELIABLE_QOS])
        for message in made.messages():
            data = message.data
            if message.topic == REFERENCE:
                if message.time_ns - last_ns < least_ns:
                    continue
                last_ns = message.time_ns
                pose: PoseStamped = deserialize_message(data, PoseStamped)
                at = pose.pose.position
                at.x, at.y, at.z = at.x / unit, at.y / unit, at.z / unit
                q = pose.pose.orientation
                turned = Rotation.from_quat([q.x, q.y, q.z, q.w]) * Rotation.from_rotvec([turn, 0.0, 0.0])
                q.x, q.y, q.z, q.w = turned.as_quat().tolist()
                stamp_ns = pose.header.stamp.sec * NS + pose.header.stamp.nanosec - lead_ns
                pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(stamp_ns, NS)
                data = serialize_message(pose)
            writer.write(message.topic, message.time_ns, data)
        assert (REFERENCE, POSE_STAMPED) in [(topic.name, topic.type_name) for topic in made.topics()]
    return folder


@pytest.fixture(scope="module")
def bag(arm: Path) -> Path:
    return write_bag(arm, arm.parent / "bag")


@pytest.fixture(scope="module")
def made(arm: Path, bag: Path) -> Path:
    folder = arm.parent / "figures"
    assert main([str(arm), "--bag", str(bag), "--reference", REFERENCE, "--output", str(folder)]) == 0
    return folder


def test_the_figures_are_those_of_an_independent_script_on_the_same_points(made: Path) -> None:
    assert sorted(path.name for path in made.iterdir()) == sorted(OUTPUT_FILES)
    found = json.loads((made / "iso9283.json").read_text(encoding="utf-8"))
    expected = figures_of(made / "points.csv")
    for what in ("poses", "distances", "paths"):
        own = {name.split(",")[0]: figures for name, figures in found[what].items()}
        assert set(own) == set(expected[what])
        for name, figures in expected[what].items():
            assert own[name] == pytest.approx(figures, rel=1e-12, abs=1e-12), f"{what} {name}"
            assert set(own[name]) == set(figures)


def test_poses_distances_and_paths_are_found_with_all_their_cycles(made: Path) -> None:
    found = json.loads((made / "iso9283.json").read_text(encoding="utf-8"))
    assert list(found["poses"]) == ["P1, 4 cycles", "P2, 3 cycles", "P3, 3 cycles"]
    assert list(found["distances"]) == ["P1 to P2", "P2 to P3"]
    assert list(found["paths"]) == [f"{name}, 3 cycles" for name in ("P1 to P2", "P2 to P3", "P3 to P1")]
    for figures in (*found["poses"].values(), *found["paths"].values()):
        accuracy = figures.get("AP_p", figures.get("AT_p"))
        assert 0.0 < accuracy < 300e-6


def test_a_full_disk_keeps_all_former_files(
    arm: Path, bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in OUTPUT_FILES:
        (tmp_path / name).write_text("former", encoding="utf-8")
    with full_disk_changes_nothing(tmp_path, 20_000):  # the table of points is larger
        assert main([str(arm), "--bag", str(bag), "--reference", REFERENCE, "--output", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"{tmp_path / 'points.csv'}: cannot be written, File too large.\n"


def test_stated_dwells_replace_those_that_are_found(made: Path, arm: Path, bag: Path, tmp_path: Path) -> None:
    with (made / "points.csv").open(encoding="utf-8", newline="") as file:
        first = next(row for row in csv.DictReader(file) if row["cycle"] == "1")
    content = json.loads((made / "iso9283.json").read_text(encoding="utf-8"))
    dwells = content["dwells"]
    assert not [note for note in content["notes"] if "dwells" in note.lower()]
    table = tmp_path / "dwells.csv"
    table.write_text(
        "begin_ns,end_ns\n" + "".join(f"{begin},{end}\n" for begin, end in (dwells[0], dwells[3], LATER)),
        encoding="utf-8-sig",
    )
    options = [str(arm), "--bag", str(bag), "--reference", REFERENCE, "--dwells", str(table), "--output", str(tmp_path)]
    assert main(options) == 0
    found = json.loads((tmp_path / "iso9283.json").read_text(encoding="utf-8"))
    assert list(found["poses"]) == ["P1, 2 cycles"]
    assert "Dwells without an endpoint, left out: 1." in found["notes"]
    with (tmp_path / "points.csv").open(encoding="utf-8", newline="") as file:
        again = next(row for row in csv.DictReader(file) if row["cycle"] == "1")
    np.testing.assert_allclose([float(again[k]) for k in "xyz"], [float(first[k]) for k in "xyz"], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        ("--reference /none", 1, "BAG: there is no topic /none"),
        ("--reference /test_rig/joint1/raw", 1, "BAG: topic /test_rig/joint1/raw is of type posor_msgs/msg/RawScan"),
        (
            "--reference /test_rig/endpoint/pose",
            1,
            "BAG: topic /test_rig/endpoint/pose is the endpoint that the POSORs",
        ),
        ("--reference REF --still 0", 2, "iso9283: argument --still: '0' is not "),
        (
            "--reference REF --dwells NONE",
            1,
            "NONE: cannot be read: No such file or directory; expected a table (CSV).",
        ),
        (
            "--reference REF --dwells BACK",
            1,
            "BACK, line 3: dwell from 5 to 6; expected begin_ns before end_ns, in order.",
        ),
        ("--reference REF --dwells EARLY", 1, "EARLY: dwells from 1 to 9 ns, none of them in the recording; expected"),
        ("--reference REF --dwells LATE", 1, f"LATE: dwells from {LATER[0]} to {LATER[1]} ns, none of them in the"),
        ("--reference REF --dwells MOVING", 1, "BAG, topic REF: moves by 0.0"),
        ("--reference REF --same-turn 4", 2, "iso9283: argument --same-turn: '4' is not a number of more than 0 and"),
        ("--reference REF --least 1e300", 2, "iso9283: argument --least: '1e300' is not a number"),
        ("--reference REF --dwells BACK --still 1", 2, "iso9283, --still: is for dwells that are found; expected"),
        ("--reference REF --dwells OWN", 2, "iso9283, --output OUT: the table of --dwells would be replaced;"),
        ("--reference REF --settle 0.2 --least 0.2", 2, "iso9283, --settle: 0.2 s; expected less than --least."),
        ("--reference REF --least 60", 1, "BAG, topic REF: 0 dwells of the reference, none of them at the same pose"),
    ],
)
def test_refusals(
    options: str, code: int, message: str, arm: Path, bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    back = tmp_path / "back.csv"
    back.write_text("begin_ns,end_ns\n1,9\n5,6\n", encoding="utf-8")
    early = tmp_path / "early.csv"
    early.write_text("begin_ns,end_ns\n1,5\n6,9\n", encoding="utf-8")
    late = tmp_path / "late.csv"
    late.write_text(f"begin_ns,end_ns\n{LATER[0]},{LATER[1]}\n", encoding="utf-8")
    moving = tmp_path / "moving.csv"
    moving.write_text(f"begin_ns,end_ns\n1,{4 * 10**18}\n", encoding="utf-8")
    names = {
        "REF": REFERENCE,
        "NONE": str(tmp_path / "none.csv"),
        "BACK": str(back),
        "EARLY": str(early),
        "LATE": str(late),
        "BAG": str(bag),
        "MOVING": str(moving),
    }
    names |= {"OUT": str(tmp_path / "out"), "OWN": str(tmp_path / "out" / "points.csv")}
    given = [names.get(word, word) for word in shlex.split(options)]
    assert main([str(arm), "--bag", str(bag), *given, "--output", str(tmp_path / "out")]) == code
    for name, text in names.items():
        message = message.replace(name, text)
    assert capsys.readouterr().err.startswith(message)


@pytest.mark.parametrize(
    ("options", "note"),
    [
        ({"lead_ns": -round((REST_S + MOVE_S) * NS)}, "Dwells whose endpoint is nearer to another pose"),
        ({"least_ns": NS // 20}, "Between two readings of the reference a path may be"),
    ],
)
def test_stamps_off_by_a_dwell_and_rare_readings_are_named(
    options: dict[str, int], note: str, arm: Path, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posor_bringup.iso9283_command.MOST_INTERPOLATION", 1e-3)  # this path is nearly straight
    for recording, expected in (bag, 0), (write_bag(arm, tmp_path / "bag", **options), 1):
        assert main([str(arm), "--bag", str(recording), "--reference", REFERENCE, "--output", str(tmp_path)]) == 0
        notes = json.loads((tmp_path / "iso9283.json").read_text(encoding="utf-8"))["notes"]
        assert len([each for each in notes if each.startswith(note)]) == expected


def test_an_arm_that_follows_its_command_late_is_named_until_it_may_settle(arm: Path, tmp_path: Path) -> None:
    late = write_bag(arm, tmp_path / "late", lead_ns=-50_000_000)  # the stamps of an instrument with a latency
    assert main([str(arm), "--bag", str(late), "--reference", REFERENCE, "--output", str(tmp_path)]) == 0
    notes = json.loads((tmp_path / "iso9283.json").read_text(encoding="utf-8"))["notes"]
    assert any("still moves against the reference" in note for note in notes)
    bag, figures = write_bag(arm, tmp_path / "bag", lead_ns=60_000_000), []
    for settle in ([], ["--settle", "0.12"]):
        folder = tmp_path / f"out{len(settle)}"
        options = ["--bag", str(bag), "--reference", REFERENCE, "--least", "0.25", "--output", str(folder)]
        assert main([str(arm), *options, *settle]) == 0
        content = json.loads((folder / "iso9283.json").read_text(encoding="utf-8"))
        assert any("still moves against the reference" in note for note in content["notes"]) is not bool(settle)
        figures.append(content["poses"]["P2, 3 cycles"]["AP_p"])
    assert figures[0] > 2.0 * figures[1]


@pytest.mark.parametrize(
    ("unit", "turn", "sentence"),
    [
        (1e-3, 0.0, " m from the endpoint; expected the same point in metres"),
        (1.0, 3.0, "is turned by 3 rad from the endpoint; expected axes of 'base' and of the endpoint, or points."),
    ],
)
def test_a_reference_in_another_unit_or_turned_is_refused(
    unit: float, turn: float, sentence: str, arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(arm, tmp_path / "bag", unit=unit, turn=turn)
    assert main([str(arm), "--bag", str(bag), "--reference", REFERENCE, "--output", str(tmp_path / "out")]) == 1
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
