# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The services of posor_node: reload, zero and home, with a real node over DDS."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
import yaml
from lifecycle_msgs.msg import Transition
from posor.calibration.calibration_file import Calibration, load_calibration
from posor.calibration.designs import DesignName, design
from posor.calibration.quantity import Quantity
from posor.calibration.session import Session
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.native_coordinates import rotation_from_native
from posor.numerics.array_types import FloatArray
from posor_estimator.posor_node import PosorEstimatorNode
from posor_lab.harness.case_tables import edited
from posor_lab.harness.graph import Graph, scan_message, values_of, wait_for_value
from posor_lab.harness.in_process_nodes import run_refused_node
from posor_lab.harness.program import HAND_FED, Program, installed
from posor_msgs.msg import JointTransform, RawScan
from posor_msgs.srv import Acknowledge
from posor_ros.ros_arguments import ros_arguments
from std_srvs.srv import Trigger

pytestmark = pytest.mark.usefixtures("ros_domain")

LOSSLESS = {"lossless": True, "alarm_count": 1, **HAND_FED}
GAP = 0.735e-3
DRIFT = [0.02, -0.03, 0.05]
SCANS = 50


def yaml_of(calibration: Calibration) -> str:
    text: str = yaml.safe_dump(calibration.model_dump(mode="json", exclude_none=True), sort_keys=False)
    return text


def with_drift(calibration: Calibration) -> Calibration:
    """Return the calibration after a drift of the gap probes' zero."""
    shifts = Quantity(value=DRIFT, unit="V")
    gap = calibration.sensors[0].for_session(Session(note="drift", zero_shifts=shifts))
    return calibration.model_copy(update={"sensors": [gap, *calibration.sensors[1:]]})


class NodeRig:
    """A posor_node with a calibration file, and simulated scans of the instrument."""

    def __init__(
        self, folder: Path, name: DesignName = "triad_diodes", *, motion: bool = False, **parameters: object
    ) -> None:
        self.file = folder / "posor.yaml"
        self.calibration = design(name, motion=motion)
        self.file.write_text(yaml_of(self.calibration), encoding="utf-8")
        self.stack = Posor(with_drift(self.calibration)).stack
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
        wait_for_value(self.graph, "/posor_node: listeners", "transform", "1")
        return self

    def __exit__(self, *reason: object) -> None:
        self.graph.__exit__(None, None, None)
        self.node.__exit__(None, None, None)

    def send(
        self, count: int, natives: Any = (0.0, 0.0, GAP, 0.0, 0.0, 0.0), *, step: float = 0.0, gaps: float = 0.0
    ) -> list[Any]:
        """Send scans at a pose, rising by ``step`` [m] a scan, gap probes ``gaps`` [V] off; return their transforms."""
        x, y, gap, alpha, beta, theta = natives
        rotations = np.tile(rotation_from_native(alpha, beta, theta), (count, 1, 1))
        translations = np.tile([x, y, gap], (count, 1)) + step * np.arange(count)[:, None] * [0.0, 0.0, 1.0]
        numbers = np.arange(self.sent + 1, self.sent + count + 1)
        scans = scans_at(self.stack, rotations, translations, numbers * 1_000_000, noise=self.random)
        scans = scans.with_fields({"numbers": numbers, "gap_voltages": scans.gap_voltages + gaps})
        before = len(self.transforms)
        for index in range(count):
            self.raw.publish(scan_message(scans[index]))
        self.sent += count
        self.graph.wait_until(lambda: len(self.transforms) == before + count, f"{count} transforms")
        return self.transforms[before:]

    def call(self, service: str) -> tuple[bool, str]:
        response = self.graph.call(Trigger, f"/posor_node/{service}", Trigger.Request())
        return response.success, response.message

    def acknowledge(self, reason: str = "inspected") -> tuple[bool, str]:
        request = Acknowledge.Request(caller="a test", reason=reason)
        response = self.graph.call(Acknowledge, "/posor_node/acknowledge", request)
        return response.success, response.message


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[NodeRig]:
    with NodeRig(tmp_path, home_pose=[GAP, 0.0, 0.0], zero_scans=SCANS) as rig:
        yield rig


def natives(transforms: list[Any]) -> FloatArray:
    """Return native coordinates, (n, 6)."""
    return np.array([transform.native for transform in transforms])


def test_zero_makes_the_present_pose_home_and_reports_the_shifts_with_uncertainty(rig: NodeRig) -> None:
    before = natives(rig.send(SCANS))
    assert abs(before[:, 2].mean() - GAP) > 1e-6
    assert np.max(np.abs(before[:, 3:5].mean(axis=0))) > 2e-5
    success, message = rig.call("zero")
    assert success, message
    shifts = yaml.safe_load(message.partition(", changed")[0])["zero_shifts"]
    noise = 1e-3  # of one voltage of this design
    np.testing.assert_allclose(shifts["value"], DRIFT, atol=5.0 * noise / np.sqrt(SCANS))
    np.testing.assert_allclose(shifts["sigma"], noise / np.sqrt(SCANS), rtol=0.4)
    after = natives(rig.send(SCANS))
    np.testing.assert_allclose(after[:, 2].mean(), GAP, atol=1e-7)
    np.testing.assert_allclose(after[:, 3:5].mean(axis=0), 0.0, atol=3e-6)
    assert {transform.state for transform in rig.transforms[SCANS:]} == {JointTransform.STATE_OK}
    status = wait_for_value(rig.graph, "/posor_node: estimate", "zero", "zero_shifts")
    assert values_of(status)["zero"] == message.partition(", changed")[0]
    # The shifts hold at another pose, too; a reload restores the zero of the file.
    elsewhere = natives(rig.send(SCANS, (1e-4, 0.0, 0.6e-3, 2e-3, -1e-3, 0.05))).mean(axis=0)
    assert np.all(np.abs(elsewhere[2:5] - [0.6e-3, 2e-3, -1e-3]) < [5e-7, 1e-5, 1e-5])
    assert rig.call("reload")[0]
    assert abs(natives(rig.send(SCANS))[:, 2].mean() - before[:, 2].mean()) < 2e-7
    assert values_of(wait_for_value(rig.graph, "/posor_node: estimate", "zero", "as in the file"))


def test_zero_uses_scans_of_one_light_source_only_also_across_a_reload(tmp_path: Path) -> None:
    with NodeRig(tmp_path, "triad_light_ring", home_pose=[GAP, 0.0, 0.0], zero_scans=SCANS) as rig:
        for reloaded in (True, False):
            assert {transform.state for transform in rig.send(SCANS)} == {JointTransform.STATE_OK}
            if reloaded:
                assert rig.call("reload")[0]
            [elsewhere] = rig.send(1, (0.0, 0.0, GAP, 0.0, 0.0, 1.0))
            assert elsewhere.state == JointTransform.STATE_OK
            assert rig.call("zero") == (False, f"zero: 1 sound scans so far; expected {SCANS}.")


def test_zero_uses_only_scans_after_a_lost_one(rig: NodeRig) -> None:
    rig.send(SCANS - 1)
    [lost] = rig.send(1, (0.0, 0.0, 10.0 * GAP, 0.0, 0.0, 0.0))
    assert lost.state == JointTransform.STATE_LOST
    rig.send(1)
    assert rig.call("zero") == (False, f"zero: 1 sound scans so far; expected {SCANS}.")

    def first_lost_values() -> dict[str, str]:
        statuses = (status for status in rig.graph.diagnostics if status.name == "/posor_node: estimate")
        return next((values_of(status) for status in statuses if status.message.startswith("lost")), {})

    rig.graph.wait_until(lambda: bool(first_lost_values()), "a report of it")
    assert (first_lost_values()["scans"], first_lost_values()["scans_lost"]) == (str(SCANS), "1")


def test_zero_needs_scans_and_a_target_at_rest_and_home_needs_a_bumpy_ring(rig: NodeRig) -> None:
    assert rig.call("zero") == (False, f"zero: 0 sound scans so far; expected {SCANS}.")
    rig.send(7)
    assert rig.call("zero") == (False, f"zero: 7 sound scans so far; expected {SCANS}.")
    before = natives(rig.send(SCANS, step=1e-7))
    success, message = rig.call("zero")
    assert not success
    assert message.startswith("digital zero: the target moves: probe ")
    assert message.endswith(f" V within {SCANS} scans; expected a target at rest.")
    # The estimates continue unchanged.
    after = natives(rig.send(3, step=1e-7))
    assert abs(after[0, 2] - before[0, 2]) < 5e-7
    success, message = rig.call("home")
    assert not success
    assert message == (
        "calibration 'triad_diodes': theta is not counted; expected a bumpy ring; ~/set_home of the chain makes poses "
        "relative to home."
    )


def test_an_invalid_home_pose_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "posor.yaml").write_text(yaml_of(design("triad_diodes")), encoding="utf-8")
    parameters = {"calibration": str(tmp_path / "posor.yaml"), "home_pose": [1e-3, 0.0]}
    sentence = "node /posor_node, parameter 'home_pose': 2 numbers; expected 3: gap, alpha, beta, or none."
    assert run_refused_node(PosorEstimatorNode, parameters, capfd) == (2, [sentence])


def test_reload_uses_the_new_file_without_a_restart(rig: NodeRig) -> None:
    before = natives(rig.send(20)).mean(axis=0)
    rig.file.write_text(yaml_of(with_drift(rig.calibration)), encoding="utf-8")
    digest = load_calibration(rig.file).content_hash
    success, message = rig.call("reload")
    assert (success, message) == (True, f"calibration 'triad_diodes', hash {digest}")
    after = rig.send(20)
    assert {transform.state for transform in after} == {JointTransform.STATE_OK}
    assert {f"{transform.calibration:016x}" for transform in after} == {digest[:16]}
    assert abs(natives(after)[:, 2].mean() - GAP) < 2e-7
    assert abs(before[2] - GAP) > 1e-6
    status = wait_for_value(rig.graph, "/posor_node: estimate", "scans", "40")
    assert values_of(status)["calibration_hash"] == digest
    assert digest in rig.node.wait_for_line(digest)


def test_a_refused_file_leaves_the_former_calibration_in_force(rig: NodeRig) -> None:
    before = natives(rig.send(20)).mean(axis=0)
    digest = load_calibration(rig.file).content_hash
    text = rig.file.read_text(encoding="utf-8")
    renamed = rig.calibration.model_copy(
        update={"frames": rig.calibration.frames.model_copy(update={"child": "plate"})}
    )
    for content, said in (
        (edited(text, "unit: V\n", "unit: mV\n"), ": unit 'mV'; "),
        ("format: [", "is not YAML: "),
        (
            yaml_of(renamed),
            (
                f"calibration file {rig.file}: its frames are receiving and plate; expected receiving and target as "
                "before, or a restart of the node."
            ),
        ),
        (None, "cannot be read: No such file or directory; "),
    ):
        if content is None:
            rig.file.unlink()
        else:
            rig.file.write_text(content, encoding="utf-8")
        success, message = rig.call("reload")
        assert not success
        assert str(rig.file) in message
        assert said in message
        assert rig.node.wait_for_line(said[-40:])
    after = rig.send(20)
    assert abs(natives(after)[:, 2].mean() - before[2]) < 3e-7
    assert (
        values_of(wait_for_value(rig.graph, "/posor_node: estimate", "last_scan", "40"))["calibration_hash"] == digest
    )


def service_names(rig: NodeRig) -> set[str]:
    return {name for name, _ in rig.graph.node.get_service_names_and_types()}


def test_home_starts_the_count_of_bumps_and_zero_needs_a_home_pose(tmp_path: Path) -> None:
    with NodeRig(tmp_path, "triad_bumpy_ring", alarm_count=3) as rig:
        rig.graph.wait_until(lambda: {"/posor_node/reload", "/posor_node/home"} <= service_names(rig), "the services")
        assert "/posor_node/zero" not in service_names(rig)
        for _ in range(30):  # losses before the count are no fault afterwards
            assert [each.state for each in rig.send(1, gaps=math.nan)] == [JointTransform.STATE_LOST]
            assert [each.state for each in rig.send(1)] == [JointTransform.STATE_UNCOUNTED]
        assert rig.graph.wait_for_status("/posor_node: estimate", "waiting for the home mark").level == b"\x01"
        success, message = rig.call("home")
        assert success
        assert message.startswith("theta is counted from the next scan")
        counted = rig.send(3)
        assert {transform.state for transform in counted} == {JointTransform.STATE_OK}
        assert rig.graph.wait_for_status("/posor_node: estimate", "ok").level == b"\x00"
        np.testing.assert_allclose(natives(counted)[:, 5], 0.0, atol=1e-3)
        # The count outlives a reload.
        assert rig.call("reload")[0]
        assert {transform.state for transform in rig.send(3)} == {JointTransform.STATE_OK}
        # It outweighs a call away from home.
        for theta in (0.03, 0.06, 0.09, 0.12):
            (there,) = rig.send(1, (0.0, 0.0, GAP, 0.0, 0.0, theta))
            assert there.state == JointTransform.STATE_OK
        success, message = rig.call("home")
        assert not success
        counted_as = re.match(r"home: theta is counted as (\S+) rad; expected the joint at its home mark", message)
        assert counted_as is not None
        assert float(counted_as[1]) == pytest.approx(0.12, abs=1e-3)
        for theta in (0.09, 0.06, 0.03):
            rig.send(1, (0.0, 0.0, GAP, 0.0, 0.0, theta))
        # A call belongs to the next scan: it is void if that scan is LOST, and refused after a LOST scan.
        assert rig.call("home")[0]
        dark = rig.send(1, gaps=math.nan)
        assert dark[0].state == JointTransform.STATE_LOST
        assert {transform.state for transform in rig.send(1, gaps=math.nan)} == {JointTransform.STATE_LOST}
        success, message = rig.call("home")
        assert not success
        assert message == "home: the last scan is LOST; expected sound scans while the joint is at the home mark."
        rig.graph.wait_until(
            lambda: any("the call of ~/home is void" in status.message for status in rig.graph.diagnostics), "the note"
        )


SERVICES: dict[str, tuple[DesignName, str]] = {  # design of the joint, and what is expected
    "home": ("triad_bumpy_ring", "sound scans while the joint is at the home mark"),
    "zero": ("triad_diodes", "sound scans while the target is at home"),
    "acknowledge": ("triad_diodes", "sound scans at the release"),
}


@pytest.mark.parametrize("service", SERVICES)
def test_services_refuse_scans_from_before_a_silence_or_a_deactivation(tmp_path: Path, service: str) -> None:
    name, expected = SERVICES[service]
    zero = {"home_pose": [GAP, 0.0, 0.0], "zero_scans": SCANS} if service == "zero" else {}
    with NodeRig(tmp_path, name, motion=service == "acknowledge", **zero, **{"freshness.max_silence": 0.5}) as rig:
        call = rig.acknowledge if service == "acknowledge" else lambda: rig.call(service)

        def prepare() -> None:
            latched(rig) if service == "acknowledge" else rig.send(SCANS)

        prepare()
        rig.graph.wait_for_status("/posor_node: estimate", "no estimate: no input on /raw for ")
        success, message = call()
        assert not success
        assert re.fullmatch(rf"{service}: no input on /raw for [\d.]+ s; expected {expected}\.", message)
        if service == "zero":  # the scans before the silence are no longer kept

            def counts_anew() -> bool:
                rig.send(1)
                return call()[1].endswith(f"sound scans so far; expected {SCANS}.")

            rig.graph.wait_until(counts_anew, "scans that are counted anew")
        prepare()
        assert rig.graph.change_state("/posor_node", Transition.TRANSITION_DEACTIVATE)
        assert call() == (False, f"{service}: the node is not active; expected {expected}.")
        assert rig.graph.change_state("/posor_node", Transition.TRANSITION_ACTIVATE)
        if service != "home":
            success, message = call()
            assert not success
            assert re.search("0 sound scans so far|no lit scan has arrived|no input on /raw", message)


def test_a_call_of_home_is_void_after_a_deactivation(tmp_path: Path) -> None:
    with NodeRig(tmp_path, "triad_bumpy_ring") as rig:
        rig.send(3)
        assert rig.call("home")[0]
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE):
            assert rig.graph.change_state("/posor_node", transition)
        assert {transform.state for transform in rig.send(3)} == {JointTransform.STATE_UNCOUNTED}


def latched(rig: NodeRig) -> None:
    """Let the gap jump by more than the motion limits allow."""
    rig.send(3)
    assert rig.send(3, (0.0, 0.0, 0.5e-3, 0.0, 0.0, 0.0))[-1].faults & JointTransform.FAULT_LATCHED


def test_a_release_needs_a_reason_and_a_plausible_scan_and_degrades(tmp_path: Path) -> None:
    with NodeRig(tmp_path, "triad_diodes", motion=True) as rig:
        assert rig.acknowledge("") == (True, "there is no latched fault")
        latched(rig)
        assert rig.acknowledge(" ") == (
            False,
            "acknowledge: 'reason' is empty; expected who releases the joint, and why.",
        )
        rig.send(1, gaps=math.nan)
        success, message = rig.acknowledge()
        assert not success
        assert "the last scan is not plausible" in message
        rig.send(1, (0.0, 0.0, 0.5e-3, 0.0, 0.0, 0.0))
        assert rig.acknowledge()[0]
        released = rig.send(3, (0.0, 0.0, 0.5e-3, 0.0, 0.0, 0.0))
        assert {each.state for each in released} == {JointTransform.STATE_DEGRADED}
        assert {each.faults for each in released} == {JointTransform.FAULT_ACKNOWLEDGED}
        assert values_of(wait_for_value(rig.graph, "/posor_node: estimate", "acknowledged", "released by a test"))
        rig.send(3)
        success, message = rig.acknowledge()
        assert not success
        assert "'acknowledge_interval'" in message


def test_releases_may_be_unlimited(tmp_path: Path) -> None:
    with NodeRig(tmp_path, "triad_diodes", motion=True, acknowledge_interval=0.0) as rig:
        for _ in range(2):
            latched(rig)
            rig.send(1)
            assert rig.acknowledge()[0]
