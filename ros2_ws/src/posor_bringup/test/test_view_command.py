# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
import socket
from pathlib import Path

import numpy as np
import pytest
from posor_bringup.arms import load_checked_arm
from posor_bringup.view_command import main, read_record
from posor_bringup.view_events import SEVERITY
from posor_bringup.view_geometry import ArmGeometry
from posor_bringup.view_messages import BLOCK_S, BagTopics
from posor_bringup.view_observation import Observer
from posor_lab.harness.rig_files import bag_path

BAG = Path(__file__).resolve().parents[4] / "bags" / "five_axis_checked"
JOINTS = ["base_swivel", "shoulder", "elbow", "wrist_roll", "wrist_yaw"]


def refusal(capfd: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    code = main(["view", *map(str, arguments)])
    return code, capfd.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["six_fingers"], r"arm 'six_fingers': no such arm; expected the path of an arm file, or one of .*\."),
        (["test_rig", "--port", "-1"], r"view: argument --port: '-1' is not .*\."),
        (
            ["five_axis", "--bag", bag_path("ymo")],
            r".*ymo: there is no endpoint of arm five_axis; expected messages on one of /five_axis/endpoint/.*\.",
        ),
        (["six_axis", "--bag", BAG], r".*five_axis_checked: there is no endpoint of arm six_axis; expected .*\."),
    ],
)
def test_wrong_option_is_refused_with_one_sentence(
    arguments: list[object], sentence: str, capfd: pytest.CaptureFixture[str]
) -> None:
    code, error = refusal(capfd, *arguments)
    assert code == 2
    assert re.fullmatch(sentence + "\n", error)


def test_missing_bag_is_refused_with_one_sentence(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    code, error = refusal(capfd, "five_axis", "--bag", tmp_path / "none")
    assert code == 1
    assert error.startswith(f"{tmp_path / 'none'}: does not exist; expected a rosbag2 bag")


@pytest.mark.usefixtures("ros_domain")
def test_port_in_use_is_refused_with_one_sentence(capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        code, error = refusal(capfd, "test_rig", "--port", port)
    assert code == 2
    assert error == (
        f"option --port: port {port} cannot be used: address already in use; "
        "expected a free port, or 0; perhaps another 'view' uses it.\n"
    )


def test_positions_of_a_bag_forth_and_back(tmp_path: Path) -> None:
    arm = load_checked_arm(BAG.name)
    bag = BagTopics(BAG, arm, tmp_path)
    observer = Observer(bag.topics, bag.store, JOINTS, arm)
    assert 9.8 < bag.duration_s < BLOCK_S + 0.1
    stamps = []
    for position_s, state in ((1.0, "OK"), (1.25, "OK"), (9.0, "LOST"), (5.75, "UNCOUNTED"), (1.0, "OK")):
        bag.seek(position_s)
        seen = observer.observe(position_s, bag.begin_ns + round(position_s * 1e9))
        assert seen.is_fresh
        assert seen.state == state
        assert seen.endpoint is not None
        stamps.append(seen.endpoint.stamp_ns)
    bag.seek(9.0, 0.0)
    seen = observer.observe(9.0, bag.begin_ns + 9_000_000_000)
    assert seen.endpoint is not None
    assert seen.endpoint.stamp_ns == stamps[2]
    assert stamps[0] == stamps[-1]
    assert stamps[1] - stamps[0] == 250_000_000
    assert stamps[2] - stamps[0] == 8_000_000_000


def test_record_of_a_bag_holds_its_events_and_its_charts(tmp_path: Path) -> None:
    arm = load_checked_arm(BAG.name)
    bag = BagTopics(BAG, arm, tmp_path)
    record = read_record(bag, Observer(bag.topics, bag.store, JOINTS, arm), ArmGeometry(arm))
    found = [
        (event.cause.state, event.cause.joints) for event in record.log.events() if event.lasted_s(bag.end_ns) > 1.0
    ]
    assert ("LOST", tuple(JOINTS)) in found
    assert ("LOST", ("elbow",)) in found
    assert ("UNCOUNTED", ("elbow", "wrist_roll")) in found
    points = record.history.points(0)
    assert points.times_s[-1] - points.times_s[0] == pytest.approx(bag.duration_s, abs=0.2)
    states = points.high[:, record.state_column]
    assert {SEVERITY["OK"], SEVERITY["LOST"], SEVERITY["UNCOUNTED"]} <= set(states)
    assert np.isfinite(points.high[states == SEVERITY["OK"], :3]).all()
    assert np.isnan(points.high[-1, :3]).all()
