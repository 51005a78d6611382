# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags for the live page: raw scans alone give the states and transforms; the shipped bag is that of its script."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from posor.bags.bag_reader import opened_bag
from posor_bringup.arms import load_checked_arm
from posor_bringup.view_messages import BagTopics
from posor_msgs.msg import EndpointState, JointTransform
from rclpy.serialization import deserialize_message

BAGS = Path(__file__).resolve().parents[4] / "bags"
STATE, ELBOW = "/five_axis/endpoint/state", "/five_axis/elbow/transform"


def test_bag_of_raw_scans_is_estimated(tmp_path: Path) -> None:
    bag = BagTopics(BAGS / "five_axis", load_checked_arm("five_axis"), tmp_path)
    assert bag.topics.endpoint == STATE
    poses, states, transforms = {}, {}, {}
    with opened_bag(BAGS / "five_axis") as reader:
        recorded = [each for each in reader.connections if each.topic == "/five_axis/endpoint/pose"]
        poses = {time_ns: bytes(data) for _, time_ns, data in reader.messages(recorded)}
    with opened_bag(tmp_path / "five_axis") as reader:
        for connection, time_ns, data in reader.messages():
            if connection.topic == STATE:
                states[time_ns] = deserialize_message(bytes(data), EndpointState)
            elif connection.topic == ELBOW:
                transforms[time_ns] = deserialize_message(bytes(data), JointTransform)
    counts = Counter(state.state for state in states.values())
    usable = [time_ns for time_ns, state in states.items() if state.state <= EndpointState.STATE_DEGRADED]
    assert len(states) == len({*states, *transforms})  # one for every stamp of any joint
    assert abs(len(usable) - len(poses)) <= 10  # the recorded poses are those of another probability of a false alarm
    assert counts[EndpointState.STATE_LOST] > 0  # the scenario drops scans
    for time_ns in usable:
        assert np.isfinite(states[time_ns].covariance_random).all()
        assert states[time_ns].protection_causes
    missing = [state for state in states.values() if state.state == EndpointState.STATE_LOST]
    assert all("transform missing" in state.reason or "is lost" in state.reason for state in missing)
    assert np.isnan([state.pose.position.x for state in missing]).all()


@pytest.mark.long
def test_the_script_makes_the_committed_bag(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(BAGS / "make_view_bag.py"), str(tmp_path)], check=True)
    made, committed = (counts_and_states(folder / "five_axis_checked") for folder in (tmp_path, BAGS))
    assert made == committed


def counts_and_states(bag: Path) -> tuple[dict[str, int], list[tuple[int, str]]]:
    with opened_bag(bag) as reader:
        counts = Counter(connection.topic for connection, _, _ in reader.messages())
        states = [each for each in reader.connections if each.topic.endswith("endpoint/state")]
        found = [deserialize_message(bytes(data), EndpointState) for _, _, data in reader.messages(states)]
    return dict(counts), [(state.state, state.reason) for state in found]
