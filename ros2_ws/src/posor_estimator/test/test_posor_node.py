# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor_node as a program: its transforms, refusals and diagnostics."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from functools import reduce
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from posor.calibration.calibration_file import load_calibration
from posor.estimation.digital_zero import MIN_SCANS
from posor.node_parameters import MIN_ZERO_SCANS
from posor_estimator.posor_node import PosorEstimatorNode
from posor_lab.harness.case_tables import edited
from posor_lab.harness.graph import Graph, set_stamp, values_of, wait_for_value
from posor_lab.harness.in_process_nodes import run_refused_node
from posor_lab.harness.program import HAND_FED, Program, installed
from posor_lab.thesis_data import read_table
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.intra_process import PUBLISH_TIMEOUT_S
from posor_ros.qos import KEEP_ALL_QOS
from posor_ros.ros_arguments import ros_arguments

pytestmark = pytest.mark.usefixtures("ros_domain")

ROOT = Path(__file__).resolve().parents[4]
BRINGUP = ROOT / "ros2_ws" / "src" / "posor_bringup"
CALIBRATION = BRINGUP / "config" / "slocum1985_printed.yaml"
YMO = ROOT / "data" / "slocum1985" / "ymo_input.csv"

PLATES = ("posor_receiving", "posor_target")
TOTAL_A = 1e-4
LOSSLESS = {"lossless": True, "alarm_count": 1, **HAND_FED}


def posor_node(**parameters: object) -> Program:
    return Program([*installed("posor_estimator", "posor_node"), *ros_arguments(parameters)])


@pytest.fixture(scope="module")
def recorded() -> dict[str, float]:
    """The readings of the first step of test YMO."""
    row = read_table(YMO, ())[0]
    return {name: float(cell) for name, cell in row.items() if name not in ("step", "repaired")}


@pytest.fixture
def sound(recorded: dict[str, float]) -> Callable[[int], Any]:
    """Return a function that makes sound scans of a number, which is also the second of their stamp."""

    def make(number: int) -> Any:
        scan = set_stamp(RawScan(scan=number, samples=1, supply_voltage=math.nan, temperature=math.nan), number)
        scan.header.frame_id = PLATES[0]
        scan.gap_voltages = [recorded[f"l{k}_v"] for k in (1, 2, 3)]
        half = TOTAL_A / 2.0
        for k in (1, 2):
            x, y = recorded[f"dx{k}"], recorded[f"dy{k}"]
            scan.diode_currents += type(scan.diode_currents)("d", [half * (1.0 + r) for r in (x, y, -x, -y)])
        scan.lit_sources = [0, 1]
        return scan

    return make


INVALID_SCANS: list[tuple[str, Any, int, tuple[str, ...]]] = [
    ("gap_voltages", {1: math.nan}, JointTransform.FAULT_BAD_READING, ("probe_2", "nan")),
    ("diode_currents", {6: math.inf}, JointTransform.FAULT_BAD_READING, ("diode_2", "inf")),
    ("gap_voltages", [0.1, 0.2], JointTransform.FAULT_BAD_READING, ("2 gap", "expected 3")),
    ("diode_currents", [1e-5] * 10, JointTransform.FAULT_BAD_READING, ("10 contact currents", "expected 8")),
    ("diode_currents", {4: 1e-6, 6: 1e-6}, JointTransform.FAULT_DARK_DIODE, ("diode_2", "2e-06 A", "2e-05 A")),
    ("gap_voltages", {2: 2.5}, JointTransform.FAULT_OUT_OF_RANGE, ("probe_3", "2.8 V", "-0.6 to 1.2 V")),
    (
        *("diode_currents", {0: 0.2 * TOTAL_A, 2: 0.8 * TOTAL_A}, JointTransform.FAULT_OUT_OF_RANGE),
        ("diode_1", "-0.6", "0.502 to 0.526"),
    ),
    ("lit_sources", {0: RawScan.NO_SOURCE}, JointTransform.FAULT_SOURCE, ("diode_1",)),
    ("lit_sources", {1: 7}, JointTransform.FAULT_SOURCE, ("diode_2", "light source 7", "0 to 1")),
    ("header.frame_id", "elbow_receiving", JointTransform.FAULT_BAD_READING, ("'elbow_receiving'", PLATES[0])),
    ("header.stamp", Time(), JointTransform.FAULT_BAD_READING, ("the stamp is zero",)),
]
"""Field of the scan; its new value, or new entries by index; the fault, and words of the reason."""


def spoil(scan: Any, path: str, value: Any) -> None:
    *way, name = path.split(".")
    part = reduce(getattr, way, scan)
    if isinstance(value, dict):
        for index, entry in value.items():
            getattr(part, name)[index] = entry
    else:
        setattr(part, name, value)


def test_the_smallest_number_of_scans_is_that_of_the_digital_zero() -> None:
    assert MIN_ZERO_SCANS == MIN_SCANS


def test_a_missing_parameter_ends_the_program_with_one_sentence() -> None:
    with posor_node() as node:
        assert (node.wait(), node.stdout) == (2, [])
        (sentence,) = node.stderr
        assert sentence.startswith("node /posor_node, parameter 'calibration': is not set; expected a string: path of ")


def test_an_invalid_calibration_or_parameter_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    missing, wrong = tmp_path / "none.yaml", tmp_path / "wrong.yaml"
    wrong.write_text(edited(CALIBRATION.read_text(encoding="utf-8"), "unit: V}", "unit: mV}"), encoding="utf-8")
    for parameters, code, said in (
        ({"calibration": str(missing)}, 1, f"calibration file {missing}: cannot be read: "),
        ({"calibration": str(wrong)}, 1, f"{wrong}, line "),
        ({"calibration": str(CALIBRATION), "session": "ymx"}, 1, "calibration 'slocum1985_printed': session 'ymx'"),
        ({"calibration": str(CALIBRATION), "covariance": "total"}, 2, "node /posor_node, parameter 'covariance': "),
    ):
        found, (sentence,) = run_refused_node(PosorEstimatorNode, parameters, capfd)
        assert found == code
        assert sentence.startswith(said)


class NodeRig:
    """A posor_node shared by several tests, and its topics."""

    def __init__(self, node: Program, graph: Graph) -> None:
        self.node, self.graph = node, graph
        self.transforms: list[Any] = graph.collect(JointTransform, "transform")
        graph.watch_diagnostics()
        self.raw = graph.publisher(RawScan, "raw")
        wait_for_value(graph, "/posor_node: listeners", "transform", "1")


@pytest.fixture(scope="module")
def running() -> Iterator[NodeRig]:
    with posor_node(calibration=str(CALIBRATION), session="ymo", **LOSSLESS) as node, Graph() as graph:
        yield NodeRig(node, graph)
        assert node.end() == 0


@pytest.fixture
def rig(running: NodeRig) -> NodeRig:
    """Return the shared node without received messages."""
    running.transforms.clear()
    running.graph.diagnostics.clear()
    return running


def test_a_sound_scan_becomes_a_transform_of_its_own_time_and_frames(rig: NodeRig, sound: Callable[[int], Any]) -> None:
    graph, raw, transforms = rig.graph, rig.raw, rig.transforms
    scan = sound(5)
    scan.status = RawScan.STATUS_OUTLIERS_DROPPED
    raw.publish(scan)
    graph.wait_until(lambda: len(transforms) == 1, "a transform")
    [transform] = transforms
    assert transform.header.stamp == scan.header.stamp
    assert (transform.header.frame_id, transform.child_frame_id) == PLATES
    assert (transform.scan, transform.scan_status) == (5, RawScan.STATUS_OUTLIERS_DROPPED)
    assert (transform.state, transform.faults) == (JointTransform.STATE_OK, JointTransform.FAULT_NONE)
    assert transform.redundancy == 1
    for part in (transform.covariance_random, transform.covariance_systematic):
        covariance = np.reshape(part, (6, 6))
        np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9)
        assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    position = transform.pose.position
    assert list(transform.native[:3]) == [position.x, position.y, position.z]
    # The calibration's home is this step: level, about zero theta as far as the diodes' maps know.
    assert abs(transform.native[5]) < 1e-4
    status = graph.wait_for_status("/posor_node: estimate", "ok: none")
    assert values_of(status)["last_scan"] == "5"


def test_the_diagnostics_and_the_log_name_the_calibration() -> None:
    digest = load_calibration(CALIBRATION).content_hash
    with posor_node(calibration=str(CALIBRATION), session="zmo", **HAND_FED) as node, Graph() as graph:
        graph.watch_diagnostics()
        values = values_of(graph.wait_for_status("/posor_node: estimate", "no scan yet"))
        assert values["calibration"] == "slocum1985_printed"
        assert values["calibration_file"] == str(CALIBRATION)
        assert values["calibration_hash"] == digest
        assert values["session"] == "zmo"
        assert digest in node.wait_for_line("calibration 'slocum1985_printed'")
        assert node.end() == 0


def test_an_invalid_scan_is_lost_and_the_next_sound_scan_is_estimated(
    rig: NodeRig, sound: Callable[[int], Any]
) -> None:
    graph, raw, transforms = rig.graph, rig.raw, rig.transforms
    raw.publish(sound(9))
    before = int(values_of(wait_for_value(graph, "/posor_node: estimate", "last_scan", "9"))["scans_lost"])
    graph.wait_until(lambda: len(transforms) == 1, "a first transform")
    transforms.clear()
    for case, (path, value, fault, words) in enumerate(INVALID_SCANS, start=1):
        scan = sound(10 * case)
        spoil(scan, path, value)
        raw.publish(scan)
        graph.wait_until(lambda: len(transforms) == 2 * case - 1, path)  # noqa: B023  used at once
        lost = transforms[-1]
        assert (lost.scan, lost.state, lost.faults) == (10 * case, JointTransform.STATE_LOST, fault), path
        assert lost.header.stamp == scan.header.stamp
        position, orientation = lost.pose.position, lost.pose.orientation
        pose = [position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w]
        parts = [*lost.covariance_random, *lost.covariance_systematic, *lost.stamp_shift]
        assert np.isnan([*pose, *lost.native, *parts]).all(), path
        status = wait_for_value(graph, "/posor_node: estimate", "reason", f"scan {10 * case}")
        assert status.level == b"\x02"
        assert status.message.startswith("lost: ")
        reason = values_of(status)["reason"]
        assert all(word in reason for word in words), reason
        raw.publish(sound(10 * case + 1))
        graph.wait_until(lambda: len(transforms) == 2 * case, "a sound scan")  # noqa: B023  used at once
        assert transforms[-1].state == JointTransform.STATE_OK, path
    status = wait_for_value(graph, "/posor_node: estimate", "last_scan", str(10 * len(INVALID_SCANS) + 1))
    assert int(values_of(status)["scans_lost"]) == before + len(INVALID_SCANS)
    # The start of the iteration has no influence: equal scans give equal poses.
    poses = [tuple(transform.native) for transform in transforms[1::2]]
    np.testing.assert_allclose(poses, [poses[0]] * len(INVALID_SCANS), rtol=0.0, atol=1e-12)


def test_every_scan_number_that_a_message_can_hold_is_answered(rig: NodeRig, sound: Callable[[int], Any]) -> None:
    graph, raw, transforms = rig.graph, rig.raw, rig.transforms
    scan = sound(1)
    scan.scan = 2**64 - 1
    raw.publish(scan)
    graph.wait_until(lambda: bool(transforms) or rig.node.ended, "a transform, or the node's end")
    assert [transform.scan for transform in transforms] == [2**64 - 1]


def test_a_contradicting_reading_is_lost_by_its_chi_square(rig: NodeRig, sound: Callable[[int], Any]) -> None:
    """A spot moved by dirt: every reading is in range, but no pose explains all seven."""
    graph, raw, transforms = rig.graph, rig.raw, rig.transforms
    scan = sound(1000)
    shift = 0.03 * TOTAL_A  # of the ratio along y, within the map
    scan.diode_currents[5] -= shift
    scan.diode_currents[7] += shift
    raw.publish(scan)
    graph.wait_until(lambda: len(transforms) == 1, "a transform")
    [transform] = transforms
    assert (transform.state, transform.faults) == (JointTransform.STATE_LOST, JointTransform.FAULT_RESIDUAL)
    assert math.isnan(transform.pose.position.x)
    status = graph.wait_for_status("/posor_node: estimate", "lost: RESIDUAL")
    assert "contradict one another" in values_of(status)["reason"]


def test_a_signal_ends_a_lossless_node_although_a_subscription_takes_nothing(sound: Callable[[int], Any]) -> None:
    with posor_node(calibration=str(CALIBRATION), session="ymo", **LOSSLESS) as node, Graph() as graph:
        graph.watch_diagnostics()
        raw = graph.publisher(RawScan, "raw", KEEP_ALL_QOS)
        graph.node.create_subscription(JointTransform, "transform", print, KEEP_ALL_QOS)
        wait_for_value(graph, "/posor_node: listeners", "transform", "1")

        def publish_until_blocked() -> None:
            for number in count(1):
                raw.publish(sound(number))

        with pytest.raises(RuntimeError):  # the node takes no scan, because it cannot publish
            publish_until_blocked()
        begin_s = time.monotonic()
        assert node.end() == 0
        assert time.monotonic() - begin_s < 0.5 * PUBLISH_TIMEOUT_S
        assert any("not all messages of /transform were received" in line for line in node.stderr)
