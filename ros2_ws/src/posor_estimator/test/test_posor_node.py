"""posor_node as a program: its transforms, refusals and diagnostics."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor.calibration.calibration_file import load_calibration
from posor.estimation.digital_zero import MIN_SCANS
from posor.node_parameters import MIN_ZERO_SCANS
from posor_estimator.posor_node import PosorEstimatorNode
from posor_lab.harness.graph import Graph, set_stamp, values_of, wait_for_value
from posor_lab.harness.in_process_nodes import run_refused_node
from posor_lab.harness.program import HAND_FED, Program, installed
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.ros_arguments import ros_arguments

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


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
    lines = YMO.read_text(encoding="utf-8").splitlines()
    row = next(csv.DictReader(line for line in lines if not line.startswith("#")))
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


def nan_voltage(scan: Any) -> None:
    scan.gap_voltages[1] = math.nan


def infinite_current(scan: Any) -> None:
    scan.diode_currents[6] = math.inf


def missing_voltage(scan: Any) -> None:
    scan.gap_voltages = scan.gap_voltages[:2]


def surplus_currents(scan: Any) -> None:
    scan.diode_currents = [*scan.diode_currents, 1e-5, 1e-5]


def dark_diode(scan: Any) -> None:
    scan.diode_currents[4], scan.diode_currents[6] = 1e-6, 1e-6


def voltage_out_of_range(scan: Any) -> None:
    scan.gap_voltages[2] = 2.5


def spot_off_the_map(scan: Any) -> None:
    scan.diode_currents[0], scan.diode_currents[2] = 0.2 * TOTAL_A, 0.8 * TOTAL_A


def no_light(scan: Any) -> None:
    scan.lit_sources[0] = RawScan.NO_SOURCE


def unknown_light(scan: Any) -> None:
    scan.lit_sources[1] = 7


def foreign_frame(scan: Any) -> None:
    scan.header.frame_id = "elbow_receiving"


def zero_stamp(scan: Any) -> None:
    scan.header.stamp.sec = scan.header.stamp.nanosec = 0


INVALID_SCANS: list[tuple[Callable[[Any], None], int, tuple[str, ...]]] = [
    (nan_voltage, JointTransform.FAULT_BAD_READING, ("probe_2", "nan", "finite voltage")),
    (infinite_current, JointTransform.FAULT_BAD_READING, ("diode_2", "inf", "finite currents")),
    (missing_voltage, JointTransform.FAULT_BAD_READING, ("2 gap", "voltages", "expected 3")),
    (surplus_currents, JointTransform.FAULT_BAD_READING, ("10 contact currents", "expected 8")),
    (dark_diode, JointTransform.FAULT_DARK_DIODE, ("diode_2", "too dark", "A + C = 2e-06 A", "at least 2e-05 A")),
    (voltage_out_of_range, JointTransform.FAULT_OUT_OF_RANGE, ("probe_3", "2.8 V", "-0.6 to 1.2 V")),
    (spot_off_the_map, JointTransform.FAULT_OUT_OF_RANGE, ("diode_1", "-0.6", "0.502 to 0.526")),
    (no_light, JointTransform.FAULT_SOURCE, ("diode_1", "no light source was lit")),
    (unknown_light, JointTransform.FAULT_SOURCE, ("diode_2", "light source 7", "0 to 1")),
    (foreign_frame, JointTransform.FAULT_BAD_READING, ("'elbow_receiving'", "expected 'posor_receiving'")),
    (zero_stamp, JointTransform.FAULT_BAD_READING, ("the stamp is zero", "expected the time of exposure")),
]


def test_the_smallest_number_of_scans_is_that_of_the_digital_zero() -> None:
    assert MIN_ZERO_SCANS == MIN_SCANS


def test_a_missing_parameter_ends_the_program_with_one_sentence() -> None:
    with posor_node() as node:
        sentence = (
            "node /posor_node, parameter 'calibration': is not set; expected a string: "
            "path of the calibration file (YAML) of this joint's POSOR."
        )
        assert (node.wait(), node.stderr, node.stdout) == (2, [sentence], [])


def test_an_invalid_calibration_or_parameter_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    missing = tmp_path / "none.yaml"
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(CALIBRATION.read_text(encoding="utf-8").replace("unit: V}", "unit: mV}", 1), encoding="utf-8")
    line = next(n for n, text in enumerate(wrong.read_text(encoding="utf-8").splitlines(), 1) if "mV}" in text)
    for parameters, code, sentence in (
        (
            {"calibration": str(missing)},
            1,
            f"calibration file {missing}: cannot be read: No such file or directory; expected a YAML calibration file.",
        ),
        (
            {"calibration": str(CALIBRATION), "session": "ymx"},
            1,
            "calibration 'slocum1985_printed': session 'ymx' is unknown; expected ymo, yzmo, zmo.",
        ),
        (
            {"calibration": str(CALIBRATION), "covariance": "all"},
            2,
            (
                "node /posor_node, parameter 'covariance': 'all' is wrong; "
                "expected one of 'random', 'systematic', 'total'."
            ),
        ),
    ):
        assert run_refused_node(PosorEstimatorNode, parameters, capfd) == (code, [sentence])
    code, [sentence] = run_refused_node(PosorEstimatorNode, {"calibration": str(wrong)}, capfd)
    assert code == 1
    assert sentence.startswith(f"{wrong}, line {line}, key sensors[0].probes[0].zero_shift")
    assert sentence.endswith(": unit 'mV'; expected 'V'.")


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
    assert transform.covariance_kind == JointTransform.COVARIANCE_TOTAL
    assert transform.redundancy == 1
    covariance = np.reshape(transform.covariance, (6, 6))
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
    for case, (spoil, fault, words) in enumerate(INVALID_SCANS, start=1):
        scan = sound(10 * case)
        spoil(scan)
        raw.publish(scan)
        graph.wait_until(lambda: len(transforms) == 2 * case - 1, spoil.__name__)  # noqa: B023  used at once
        lost = transforms[-1]
        assert (lost.scan, lost.state, lost.faults) == (10 * case, JointTransform.STATE_LOST, fault), spoil.__name__
        assert lost.header.stamp == scan.header.stamp
        position, orientation = lost.pose.position, lost.pose.orientation
        pose = [position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w]
        assert np.isnan([*pose, *lost.native, *lost.covariance]).all(), spoil.__name__
        status = wait_for_value(graph, "/posor_node: estimate", "reason", f"scan {10 * case}")
        assert status.level == b"\x02"
        assert status.message.startswith("lost: ")
        reason = values_of(status)["reason"]
        assert all(word in reason for word in words), reason
        raw.publish(sound(10 * case + 1))
        graph.wait_until(lambda: len(transforms) == 2 * case, "a sound scan")  # noqa: B023  used at once
        assert transforms[-1].state == JointTransform.STATE_OK, spoil.__name__
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
    scan = sound(1)
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
