"""The services of posor_node: reload, zero and home, with a real node over DDS."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pytest
import yaml
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.calibration.quantity import Quantity
from posor_estimator.core.calibration.session import Session
from posor_estimator.core.designs import design
from posor_estimator.core.forward import scans_at
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.posor_node import PosorEstimatorNode
from posor_estimator.testing.graph import Graph, values_of
from posor_estimator.testing.program import Program, installed, ros_arguments
from posor_estimator.testing.refusal import refusal
from posor_estimator.testing.stamped import status_with
from posor_msgs.msg import JointTransform, RawScan
from std_srvs.srv import Trigger

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.designs import DesignName
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import FloatArray

pytestmark = pytest.mark.usefixtures("ros_domain")

LOSSLESS = {"qos_reliability": "reliable", "qos_depth": 0}
GAP = 0.735e-3
DRIFT = [0.02, -0.03, 0.05]
SCANS = 50


def text_of(calibration: Calibration) -> str:
    text: str = yaml.safe_dump(calibration.model_dump(mode="json", exclude_none=True), sort_keys=False)
    return text


def message_of(scans: Scans, index: int) -> Any:
    scan = scans[index]
    message = RawScan(scan=scan.number, samples=1, supply_voltage=scan.supply_voltage, temperature=scan.temperature)
    seconds, nanoseconds = divmod(scan.stamp_ns, 10**9)
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds
    message.header.frame_id = "receiving"
    message.gap_voltages = scan.gap_voltages.tolist()
    message.ring_voltages = scan.ring_voltages.tolist()
    message.diode_currents = scan.diode_currents.ravel().tolist()
    message.lit_sources = list(scan.lit_sources)
    return message


def drifted(calibration: Calibration) -> Calibration:
    """Return the calibration of the instrument as it really is: the zero of its gap probes has drifted."""
    shifts = Quantity(value=DRIFT, unit="V")
    gap = calibration.sensors[0].for_session(Session(note="drift", zero_shifts=shifts))
    return calibration.model_copy(update={"sensors": [gap, *calibration.sensors[1:]]})


class Bench:
    """A posor_node on a calibration file, and scans of the instrument that it belongs to."""

    def __init__(self, folder: Path, name: DesignName = "triad_diodes", **parameters: object) -> None:
        self.file = folder / "posor.yaml"
        self.calibration = design(name)
        self.file.write_text(text_of(self.calibration), encoding="utf-8")
        self.stack = Posor(drifted(self.calibration)).stack
        self.random = np.random.default_rng(1985)
        self.sent = 0
        command = [
            *installed("posor_estimator", "posor_node"),
            *ros_arguments({"calibration": str(self.file), **LOSSLESS, **parameters}),
        ]
        self.node, self.graph = Program(command), Graph()

    def __enter__(self) -> Self:
        self.node.__enter__()
        self.graph.__enter__()
        self.transforms = self.graph.collect(JointTransform, "transform")
        self.graph.watch_diagnostics()
        self.raw = self.graph.publisher(RawScan, "raw")
        status_with(self.graph, "/posor_node: listeners", "transform", "1")
        return self

    def __exit__(self, *reason: object) -> None:
        self.graph.__exit__(None, None, None)
        self.node.__exit__(None, None, None)

    def send(self, count: int, natives: Any = (0.0, 0.0, GAP, 0.0, 0.0, 0.0), *, moving: float = 0.0) -> list[Any]:
        """Send scans at a place, or rising by ``moving`` [m] from scan to scan; return their transforms."""
        x, y, gap, alpha, beta, theta = natives
        rotations = np.tile(rotation_from_native(alpha, beta, theta), (count, 1, 1))
        translations = np.tile([x, y, gap], (count, 1)) + moving * np.arange(count)[:, None] * [0.0, 0.0, 1.0]
        numbers = np.arange(self.sent + 1, self.sent + count + 1)
        scans = scans_at(self.stack, rotations, translations, numbers * 1_000_000, noise=self.random)
        scans = replace(scans, numbers=numbers.astype(np.uint64))
        before = len(self.transforms)
        for index in range(count):
            self.raw.publish(message_of(scans, index))
        self.sent += count
        self.graph.wait_until(lambda: len(self.transforms) == before + count, f"{count} transforms")
        return self.transforms[before:]

    def call(self, service: str) -> tuple[bool, str]:
        response = self.graph.call(Trigger, f"/posor_node/{service}", Trigger.Request())
        return response.success, response.message


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with Bench(tmp_path, home_pose=[GAP, 0.0, 0.0], zero_scans=SCANS) as made:
        yield made


def natives(transforms: list[Any]) -> FloatArray:
    """Return native coordinates, (n, 6)."""
    return np.array([transform.native for transform in transforms])


def average(transforms: list[Any]) -> FloatArray:
    """Return the mean native coordinates, (6,)."""
    return np.asarray(natives(transforms).mean(axis=0))


def test_zero_makes_the_present_place_home_and_says_the_shifts_with_their_uncertainty(bench: Bench) -> None:
    before = natives(bench.send(SCANS))
    assert abs(before[:, 2].mean() - GAP) > 1e-6
    assert np.max(np.abs(before[:, 3:5].mean(axis=0))) > 2e-5
    success, message = bench.call("zero")
    assert success, message
    shown = yaml.safe_load(message.partition(", changed")[0])["zero_shifts"]
    noise = 1e-3  # of one voltage of this design
    np.testing.assert_allclose(shown["value"], DRIFT, atol=5.0 * noise / np.sqrt(SCANS))
    np.testing.assert_allclose(shown["sigma"], noise / np.sqrt(SCANS), rtol=0.4)
    after = natives(bench.send(SCANS))
    np.testing.assert_allclose(after[:, 2].mean(), GAP, atol=1e-7)
    np.testing.assert_allclose(after[:, 3:5].mean(axis=0), 0.0, atol=3e-6)
    assert {transform.state for transform in bench.transforms[SCANS:]} == {JointTransform.STATE_OK}
    status = status_with(bench.graph, "/posor_node: estimate", "zero", "zero_shifts")
    assert values_of(status)["zero"] == message.partition(", changed")[0]
    # Elsewhere it is right as well, and the file's own zero is back after a reload.
    elsewhere = average(bench.send(SCANS, (1e-4, 0.0, 0.6e-3, 2e-3, -1e-3, 0.05)))
    assert np.all(np.abs(elsewhere[2:5] - [0.6e-3, 2e-3, -1e-3]) < [5e-7, 1e-5, 1e-5])
    assert bench.call("reload")[0]
    assert abs(natives(bench.send(SCANS))[:, 2].mean() - before[:, 2].mean()) < 2e-7
    assert values_of(status_with(bench.graph, "/posor_node: estimate", "zero", "as in the file"))


def test_zero_takes_no_scans_of_another_light_source_not_even_across_a_reload(tmp_path: Path) -> None:
    with Bench(tmp_path, "triad_light_ring", home_pose=[GAP, 0.0, 0.0], zero_scans=SCANS) as bench:
        for reloaded in (True, False):
            assert {transform.state for transform in bench.send(SCANS)} == {JointTransform.STATE_OK}
            if reloaded:
                assert bench.call("reload")[0]
            [elsewhere] = bench.send(1, (0.0, 0.0, GAP, 0.0, 0.0, 1.0))
            assert elsewhere.state == JointTransform.STATE_OK
            assert bench.call("zero") == (False, f"zero: 1 sound scans so far; expected {SCANS}.")


def test_zero_takes_no_scans_from_before_one_without_a_pose(bench: Bench) -> None:
    bench.send(SCANS - 1)
    [lost] = bench.send(1, (0.0, 0.0, 10.0 * GAP, 0.0, 0.0, 0.0))
    assert lost.state == JointTransform.STATE_LOST
    bench.send(1)
    assert bench.call("zero") == (False, f"zero: 1 sound scans so far; expected {SCANS}.")

    def first() -> dict[str, str]:
        told = (status for status in bench.graph.diagnostics if status.name == "/posor_node: estimate")
        return next((values_of(status) for status in told if status.message.startswith("lost")), {})

    bench.graph.wait_until(lambda: bool(first()), "a report of it")
    assert (first()["scans"], first()["scans_lost"]) == (str(SCANS), "1")


def test_zero_is_refused_before_there_are_scans_and_while_the_target_moves_and_home_is_no_count(bench: Bench) -> None:
    assert bench.call("zero") == (False, f"zero: 0 sound scans so far; expected {SCANS}.")
    bench.send(7)
    assert bench.call("zero") == (False, f"zero: 7 sound scans so far; expected {SCANS}.")
    before = natives(bench.send(SCANS, moving=1e-7))
    success, message = bench.call("zero")
    assert not success
    assert message.startswith("digital zero: the target moves: probe ")
    assert message.endswith(f" V within {SCANS} scans; expected a target at rest.")
    # It went on as it was.
    after = natives(bench.send(3, moving=1e-7))
    assert abs(after[0, 2] - before[0, 2]) < 5e-7
    success, message = bench.call("home")
    assert not success
    assert message == (
        "calibration 'triad_diodes': theta is not counted; expected a bumpy ring; ~/set_home of the chain makes poses "
        "relative to home."
    )


def test_a_wrong_home_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "posor.yaml").write_text(text_of(design("triad_diodes")), encoding="utf-8")
    parameters = {"calibration": str(tmp_path / "posor.yaml"), "home_pose": [1e-3, 0.0]}
    sentence = "node /posor_node, parameter 'home_pose': 2 numbers; expected 3: gap, alpha, beta, or none."
    assert refusal(PosorEstimatorNode, parameters, capfd) == (2, [sentence])


def test_reload_takes_the_new_file_without_a_restart(bench: Bench) -> None:
    before = average(bench.send(20))
    bench.file.write_text(text_of(drifted(bench.calibration)), encoding="utf-8")
    digest = load_calibration(bench.file).content_hash
    success, message = bench.call("reload")
    assert (success, message) == (True, f"calibration 'triad_diodes', hash {digest}")
    after = bench.send(20)
    assert {transform.state for transform in after} == {JointTransform.STATE_OK}
    assert abs(natives(after)[:, 2].mean() - GAP) < 2e-7
    assert abs(before[2] - GAP) > 1e-6
    status = status_with(bench.graph, "/posor_node: estimate", "scans", "40")
    assert values_of(status)["calibration_hash"] == digest
    assert digest in bench.node.wait_for_line(digest)


def test_a_refused_file_leaves_the_old_one_in_force_and_says_why(bench: Bench) -> None:
    before = average(bench.send(20))
    digest = load_calibration(bench.file).content_hash
    text = bench.file.read_text(encoding="utf-8")
    renamed = bench.calibration.model_copy(
        update={"frames": bench.calibration.frames.model_copy(update={"child": "plate"})}
    )
    wrong = {
        text.replace("unit: V\n", "unit: mV\n", 1): ": unit 'mV'; expected 'V'.",
        "format: [": "is not YAML: while parsing a flow node, expected the node content, but found '<stream end>'.",
        text_of(renamed): (
            f"calibration file {bench.file}: its frames are receiving and plate; expected receiving and target as "
            "before, or a restart of the node."
        ),
    }
    for content, sentence in wrong.items():
        bench.file.write_text(content, encoding="utf-8")
        success, message = bench.call("reload")
        assert not success
        assert message.endswith(sentence)
        assert str(bench.file) in message
        assert bench.node.wait_for_line(sentence[-40:])
    bench.file.unlink()
    success, message = bench.call("reload")
    assert not success
    assert message.endswith("cannot be read: No such file or directory; expected a YAML calibration file.")
    after = bench.send(20)
    assert abs(natives(after)[:, 2].mean() - before[2]) < 3e-7
    assert values_of(status_with(bench.graph, "/posor_node: estimate", "last_scan", "40"))["calibration_hash"] == digest


def services(bench: Bench) -> set[str]:
    return {name for name, _ in bench.graph.node.get_service_names_and_types()}


def test_home_begins_the_count_of_bumps_and_zero_is_not_there_where_home_is_not_known(tmp_path: Path) -> None:
    with Bench(tmp_path, "triad_bumpy_ring") as bench:
        bench.graph.wait_until(lambda: {"/posor_node/reload", "/posor_node/home"} <= services(bench), "the services")
        assert "/posor_node/zero" not in services(bench)
        assert {transform.state for transform in bench.send(3)} == {JointTransform.STATE_UNCOUNTED}
        success, message = bench.call("home")
        assert success
        assert message.startswith("theta is counted from the next scan")
        counted = bench.send(3)
        assert {transform.state for transform in counted} == {JointTransform.STATE_OK}
        np.testing.assert_allclose(natives(counted)[:, 5], 0.0, atol=1e-3)
        # The count outlives a reload.
        assert bench.call("reload")[0]
        assert {transform.state for transform in bench.send(3)} == {JointTransform.STATE_OK}
