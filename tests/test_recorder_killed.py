# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The recorder killed by SIGKILL: all but the last second of its bag is recovered, and what it knew of the arm."""

from __future__ import annotations

import signal
import time
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np
import pytest
from posor.arm_names import find_arm
from posor.bags.provenance import custom_data, provenance_of
from posor.bags.recover_command import recover
from posor.bags.reprocess_task import Settings
from posor.chain.arm_file import load_arm_file
from posor.errors import BagError
from posor_lab.harness.graph import Graph
from posor_lab.harness.program import Program, installed
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import UInt64

from tests.rig_messages import read_bag_messages

pytestmark = pytest.mark.usefixtures("ros_domain")

ROOT = Path(__file__).resolve().parents[1]
TOPICS = ("/one", "/other")
PERIOD_S = 0.005
LOST_S = 1.0  # time before the kill whose messages may be missing
QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)


def record_and_kill(bag: Path, after_s: float, *options: str) -> list[float]:
    """Record a stream of numbers, kill the recorder; return the times of publication, counted from the kill [s]."""
    command = [*installed("posor_drivers", "record"), "--output", str(bag), *options, "--topics", *TOPICS]
    with Graph() as graph, Program(command) as program:
        publishers = [graph.publisher(UInt64, topic, QOS) for topic in TOPICS]
        program.wait_for_line("ready: ")
        published: list[float] = []
        begin = time.monotonic()
        while (now := time.monotonic()) < begin + after_s:
            for publisher in publishers:
                publisher.publish(UInt64(data=len(published)))
            published.append(now)
            time.sleep(PERIOD_S)  # the pace of the stream
        assert not program.ended
        killed = time.monotonic()
        assert program.end(signal.SIGKILL) == -signal.SIGKILL
    return [at - killed for at in published]


def check_recovered(folder: Path, published: list[float]) -> float:
    """Check that all but the last second is recovered, in order; return the time that is missing [s]."""
    due = sum(at < -LOST_S for at in published)
    with nullcontext() if due else suppress(BagError):  # nothing need be there yet
        recover(folder / "bag", folder / "recovered")
    if not (folder / "recovered").exists():
        return -published[0]
    received = read_bag_messages(folder / "recovered")
    missing_s = 0.0
    for topic in TOPICS:
        numbers = [deserialize_message(data, UInt64).data for data in received.get(topic, [])]
        assert numbers == list(range(len(numbers)))
        assert len(numbers) >= due
        missing_s = max(missing_s, *(-at for at in published[len(numbers) :]), 0.0)
    return missing_s


def test_a_killed_recorder_leaves_all_but_the_last_second_and_the_hashes_of_the_arm(tmp_path: Path) -> None:
    arm = find_arm("five_axis")
    check_recovered(tmp_path, record_and_kill(tmp_path / "bag", 2.2, "--arm", str(arm)))
    hashes = provenance_of(Settings.of_arm(load_arm_file(arm)))
    assert len(hashes) == 13  # the software, URDF, beams, five calibrations and their sessions
    assert custom_data(tmp_path / "bag") == custom_data(tmp_path / "recovered") == hashes


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_recorder_killed_at_20_random_times_leaves_all_but_the_last_second(tmp_path: Path) -> None:
    missing = []
    for number, after_s in enumerate(np.random.default_rng(41).uniform(0.1, 4.0, size=20)):
        folder = tmp_path / str(number)
        missing.append(check_recovered(folder, record_and_kill(folder / "bag", float(after_s))))
    print(f"missing before the kill [s]: {', '.join(f'{each:.2f}' for each in sorted(missing))}")
    assert max(missing) <= LOST_S
