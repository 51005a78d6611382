# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A driver that switches its light sources off once a second, by real nodes and by their bag."""

from __future__ import annotations

import shutil
import signal
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseStamped
from posor.arm_names import find_arm
from posor.estimation.posor import Posor
from posor.model.fault import State
from posor.model.scan import NO_SOURCE
from posor.node_parameters import RECORDING
from posor_bringup.arms import load_checked_arm
from posor_lab.harness.graph import Graph, wait_for_value
from posor_lab.harness.message_conversion import pose_from_message, scan_from_message, stamp_ns
from posor_lab.harness.program import Program, installed
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.ros_arguments import ros_arguments

pytestmark = pytest.mark.usefixtures("ros_domain")

RATE, JOINT = 50, "/six_axis/elbow"
RAW, TRANSFORM = f"{JOINT}/raw", f"{JOINT}/transform"
AMBIENT = JointTransform.FAULT_AMBIENT


def program(package: str, executable: str, **parameters: object) -> Program:
    names = {name.replace("__", "."): value for name, value in parameters.items()} | {"lossless": True}
    return Program([*installed(package, executable), *ros_arguments(names, JOINT)])


def estimator() -> Program:
    calibration = find_arm("six_axis").parent / "calibrations" / "elbow.yaml"
    return program("posor_estimator", "posor_node", calibration=str(calibration), **RECORDING)


def wait_for_transform_listeners(graph: Graph, count: int) -> None:
    """Wait until posor_node, which answers the first scan once, knows the subscriptions to its answers."""
    graph.watch_diagnostics()
    wait_for_value(graph, f"{JOINT}/posor_node: listeners", "transform", str(count))


def is_dark(scan: Any) -> bool:
    return all(lit == NO_SOURCE for lit in scan.lit_sources)


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """Return the file of an arm with a dark scan each second, with ambient light of 2 % of a source's."""
    folder = shutil.copytree(find_arm("six_axis").parent, tmp_path / "arm")
    path = folder / "scenario.yaml"
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    content["electronics"]["ambient"] = {
        "current": {"value": 1e-6, "unit": "A"},
        "interval": {"value": 1.0, "unit": "s"},
    }
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return folder / "arm.yaml"


def test_ambient_light_is_removed_from_the_first_dark_scan_on_and_in_a_replay(arm: Path, tmp_path: Path) -> None:
    simulated: dict[str, object] = {"source": "simulated", "simulated__arm": str(arm), "simulated__joint": "elbow"}
    simulated |= {"simulated__rate": RATE, "simulated__dropouts": False, "simulated__zero_drift": False}
    bag, topics = tmp_path / "bag", [RAW, TRANSFORM]
    record = Program([*installed("posor_drivers", "record"), "--output", str(bag), "--topics", *topics])
    with Graph() as graph, estimator(), record:
        scans, found = graph.collect(RawScan, RAW), graph.collect(JointTransform, TRANSFORM)
        truths = graph.collect(PoseStamped, "/six_axis/truth/elbow")
        wait_for_transform_listeners(graph, 2)
        with program("posor_drivers", "driver_node", wait_for_subscribers=3, **simulated):
            graph.wait_until(lambda: len(found) > 6 * RATE, "six seconds of transforms")
        assert record.end(signal.SIGINT) == 0
    dark = {scan.scan for scan in scans if is_dark(scan)}
    light = {scan.scan for scan in scans} - dark  # the last transforms may come before their scans
    assert is_dark(scans[0])
    assert found[0].state == JointTransform.STATE_LOST
    assert found[0].faults == AMBIENT
    # a busy host may take no scan until long after the last pose, and the dark scan that is due then has none
    later = [each for before, each in pairwise(found) if each.scan in dark and each.scan == before.scan + 1]
    assert len(later) >= 3
    assert {each.state for each in later} == {JointTransform.STATE_DEGRADED}
    assert all(each.faults & AMBIENT for each in later)
    lit = [each for each in found if each.scan in light]
    assert np.mean([each.state == JointTransform.STATE_OK for each in lit]) > 0.99
    true = {stamp_ns(truth): pose_from_message(truth.pose) for truth in truths}
    for each in lit:
        if each.state == JointTransform.STATE_OK and stamp_ns(each) in true:
            error = pose_from_message(each.pose).translation - true[stamp_ns(each)].translation
            variances = np.reshape(np.add(each.covariance_random, each.covariance_systematic), (6, 6)).diagonal()[:3]
            assert np.all(np.abs(error) < 5.0 * np.sqrt(variances))
    posor = Posor(load_checked_arm("six_axis").calibration("elbow"))
    offline = [posor.estimate(scan_from_message(scan)).state for scan in scans[: len(found)]]
    assert [State(each.state) for each in found[: len(offline)]] == offline
    with Graph() as graph, estimator():
        again = graph.collect(JointTransform, TRANSFORM)
        wait_for_transform_listeners(graph, 1)
        replay = {"source": "bag", "bag__path": str(bag), "bag__topic": RAW, "rate": 500.0}
        with program("posor_drivers", "driver_node", wait_for_subscribers=1, **replay) as driver:
            assert driver.wait() == 0
            graph.wait_until(lambda: len(again) >= len(found), "the transforms of the bag")
    begin = sorted(dark)[1]  # a node that missed the first scan removes the light from the second dark scan on
    sound = [
        {each.scan: each.pose for each in run if each.scan >= begin and each.state != JointTransform.STATE_LOST}
        for run in (found, again)
    ]
    both = sound[0].keys() & sound[1].keys()
    assert len(both) > 2 * RATE
    assert [sound[0][scan] for scan in both] == [sound[1][scan] for scan in both]
