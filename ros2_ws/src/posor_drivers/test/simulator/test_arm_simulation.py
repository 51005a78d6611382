# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The simulated arm as a whole: what is true, what is read, and that one belongs to the other."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.chain.arm_file import load_arm_file
from posor.chain.joint_measurements import MeasuredJoint
from posor.estimation.posor import Posor
from posor.model.fault import Fault, State
from posor.model.scan import SCAN_FIELDS
from posor.numerics.stamps import NS
from posor.numerics.vector import theta_of
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.mechanics import LinkCompliance, bend_links
from posor_drivers.simulator.nominal_arm import NominalArm
from posor_drivers.simulator.pose_array import ArmTruth
from posor_msgs.msg import RawScan

from ..three_joint_arm import FAR, JOINTS, TICKS, N, perfect, refused, scenario, simulation, write_arm

ARMS = Path(__file__).resolve().parents[3] / "posor_bringup" / "arms"
READINGS = ("gap_voltages", "ring_voltages", "diode_currents")


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> ArmSimulation:
    return simulation(tmp_path_factory.mktemp("everything"))


def by_chain(arm: ArmSimulation, truth: ArmTruth, n: int) -> pin.SE3:
    """Return the endpoint that chain_node would give if its POSORs were without error."""
    measured = {joint: MeasuredJoint(truth.T_parent_child[joint][n]) for joint in arm.joints}
    return arm.chain.estimate(measured).T_base_endpoint


def test_perfect_encoders_give_the_endpoint(tmp_path: Path) -> None:
    arm = simulation(tmp_path, Imperfections.only(), perfect(scenario()))
    truth = arm.truth(TICKS)
    assert np.array_equal(truth.angles, truth.commanded)
    assert np.array_equal(truth.encoder, truth.commanded)
    by_encoders = NominalArm(arm.chain).endpoint(truth.encoder)
    assert np.allclose(by_encoders.translations, truth.endpoint.translations, rtol=0.0, atol=1e-14)
    assert np.allclose(by_encoders.rotations, truth.endpoint.rotations, rtol=0.0, atol=1e-14)
    assert np.ptp(truth.target.translations, axis=0).min() > 0.05


def test_measuring_beam_follows_the_line_from_joint_to_joint(tmp_path: Path) -> None:
    content = perfect(scenario())
    for joint, settings in scenario()["joints"].items():
        content["joints"][joint]["structure"] = settings["structure"]
    arm = simulation(tmp_path, Imperfections.only(), content)
    seen = {joint: poses[0] for joint, poses in arm.truth(TICKS[:1]).T_parent_child.items()}
    # Every joint at zero: the arm lies along X and bends down, which is about the axes of shoulder and elbow.
    nominal, files = NominalArm(arm.chain), arm.scenario.joints
    spans = [link.translation for link in nominal.links[1:]]
    lengths = [float(np.linalg.norm(span)) for span in spans]
    links = [
        LinkCompliance.from_structure(files[joint].structure, length)
        for joint, length in zip(JOINTS, lengths, strict=True)
    ]
    bent = bend_links(nominal.target_plates(np.zeros((1, 3))), spans, links, 3.0, arm.chain.gravity)
    _, upper, fore = ((bend.rotations[0, 2], np.linalg.norm(bend.translations[0])) for bend in bent)
    assert upper[1] > 5e-5
    # The elbow's receiving plate turns with the chord of the upper arm, its target plate with the end of the upper arm
    # and the chord of the forearm, which is not quite at right angles to the axis.
    turn = upper[0] - upper[1] / lengths[1] + fore[1] * spans[2][0] / lengths[2] ** 2
    assert theta_of(seen["elbow"].rotation) == pytest.approx(turn, rel=1e-4)
    for pose in seen.values():  # and lies at the joint, however far that has moved
        assert np.allclose(pose.translation, [0.0, 0.0, 0.000735], rtol=0.0, atol=1e-6)


def test_perfect_posors_and_chain_give_the_endpoint(tmp_path: Path) -> None:
    arm = simulation(tmp_path, Imperfections.only("sag"), perfect(scenario()))  # which the chain corrects
    ticks = TICKS[::5]
    truth = arm.truth(ticks)
    found = {}
    for i, joint in enumerate(JOINTS):
        posor = Posor(arm.calibrations[joint])
        thetas = truth.angles[:, i] if posor.counts_bumps else None
        found[joint] = posor.estimate_each(arm.scans(joint, ticks).scans, thetas)
        assert np.all(found[joint].states == State.OK)
    for n in range(len(ticks)):
        poses = {joint: pin.SE3(found[joint].rotations[n], found[joint].translations[n]) for joint in JOINTS}
        measured = {joint: MeasuredJoint(pose) for joint, pose in poses.items()}
        endpoint = arm.chain.estimate(measured).T_base_endpoint
        assert np.linalg.norm(endpoint.translation - truth.endpoint.translations[n]) < 1e-9
        assert np.linalg.norm(pin.log3(endpoint.rotation.T @ truth.endpoint.rotations[n])) < 1e-9


def test_chain_is_unaffected_by_bending_backlash_runout_and_sag(tmp_path: Path) -> None:
    arm = simulation(tmp_path, Imperfections.only("sag"))
    truth = arm.truth(TICKS)
    by_encoders = NominalArm(arm.chain).endpoint(truth.encoder)
    off = np.linalg.norm(by_encoders.translations - truth.endpoint.translations, axis=1)
    assert 1e-4 < np.sqrt(np.mean(off**2)) < 1e-3
    for n in range(0, N, 7):
        assert np.linalg.norm(by_chain(arm, truth, n).translation - truth.endpoint.translations[n]) < 1e-9


@pytest.mark.long
def test_beam_errors_limit_the_accuracy_of_the_chain(tmp_path: Path) -> None:
    arm = simulation(tmp_path, Imperfections.only("sag", "beam_errors"))
    truth = arm.truth(TICKS)
    misses = [np.linalg.norm(by_chain(arm, truth, n).translation - truth.endpoint.translations[n]) for n in range(N)]
    assert min(misses) > 1e-8
    assert max(misses) < 5e-6


def test_true_motion_stays_within_the_range_of_the_sensors(everything: ArmSimulation) -> None:
    for joint in JOINTS:
        scans = everything.scans(joint, TICKS)
        assert not np.any(scans.statuses & RawScan.STATUS_SATURATED)
        found = Posor(everything.calibrations[joint]).estimate_all(scans.scans)
        usable = np.isin(found.states, (State.OK, State.DEGRADED))
        assert np.mean(usable) > 0.9


def test_errors_of_estimates_agree_with_their_covariances(everything: ArmSimulation) -> None:
    truth = everything.truth(TICKS).T_parent_child["base"]
    found = Posor(everything.calibrations["base"]).estimate_all(everything.scans("base", TICKS).scans)
    covariances = found.covariances()
    errors = np.array(
        [
            [*(found.translations[n] - truth.translations[n]), *pin.log3(found.rotations[n] @ truth.rotations[n].T)]
            for n in TICKS
        ]
    )
    nees = np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[:, :, None])[:, :, 0]) / 6.0
    assert 0.05 < np.mean(nees) < 4.0  # one draw of the calibration's errors


def test_home_mark_flag_is_set_in_the_first_scan(everything: ArmSimulation) -> None:
    at_home = {joint: everything.scans(joint, TICKS).statuses & RawScan.STATUS_HOME_BUMP > 0 for joint in JOINTS}
    assert at_home["base"][0]
    assert at_home["elbow"][0]
    assert not at_home["shoulder"].any()  # a ring of light sources counts nothing
    (bump,) = (sensor.bump_angle for sensor in everything.calibrations["base"].sensors if sensor.bump_angle)
    theta = np.array([theta_of(rotation) for rotation in everything.truth(TICKS).T_parent_child["base"].rotations])
    assert np.array_equal(at_home["base"], np.abs(theta) < 0.25 * bump)
    assert not at_home["base"].all()


def test_scans_carry_tick_stamp_and_the_simulated_flag(everything: ArmSimulation) -> None:
    scans = everything.scans("base", FAR + TICKS)
    assert np.array_equal(scans.scans.numbers, FAR + TICKS)
    assert np.array_equal(scans.scans.stamps_ns, (FAR + TICKS) * (NS // 100))
    assert np.all(scans.statuses & RawScan.STATUS_SIMULATED)


@pytest.mark.parametrize("joint", JOINTS)
def test_scan_depends_on_its_tick_only(everything: ArmSimulation, joint: str) -> None:
    together = everything.scans(joint, TICKS)
    for n in (0, 1, 57, 110, 799):
        alone = everything.scans(joint, TICKS[n : n + 1])
        for name in SCAN_FIELDS:
            both = getattr(together.scans, name)[n], getattr(alone.scans, name)[0]
            assert np.array_equal(*both, equal_nan=name in UNMEASURED)
        assert together.statuses[n] == alone.statuses[0]
        assert together.latencies_ns[n] == alone.latencies_ns[0] == everything.latency_ns(joint, n)


def test_noise_differs_between_cycles_but_motion_does_not(everything: ArmSimulation) -> None:
    once, again = everything.scans("base", TICKS), everything.scans("base", N + TICKS)
    assert np.array_equal(
        everything.truth(TICKS).endpoint.translations, everything.truth(N + TICKS).endpoint.translations
    )
    assert np.mean(once.scans.ring_voltages == again.scans.ring_voltages) < 0.5  # some fall on the same step


def test_rings_that_start_anywhere_are_counted_at_their_home_marks() -> None:
    """Readings of a ring with five probes contradict each other until then, because its bumps are not alike."""
    arm = ArmSimulation(load_arm_file(ARMS / "five_axis_checked" / "arm.yaml"), rate=50)
    ticks = 150 + np.arange(400)
    for joint in arm.joints:
        posor = Posor(arm.calibrations[joint])
        estimates = posor.estimate_all(arm.scans(joint, ticks).scans)
        assert estimates.faults[0] & Fault.RESIDUAL
        assert not (estimates.faults & Fault.LATCHED).any()
        assert set(estimates.states[-40:]) == {State.OK}
        thetas = [theta_of(pose) for pose in arm.truth(ticks[-40:]).T_parent_child[joint].rotations]
        np.testing.assert_allclose(estimates.thetas[-40:], thetas, rtol=0.0, atol=1e-4)


def test_rings_that_lose_their_count_in_a_gap_are_counted_at_the_next_home_marks() -> None:
    """Behind a gap in motion a ring may assume another bump, where its sound readings contradict each other."""
    arm, chance = ArmSimulation(load_arm_file(ARMS / "five_axis" / "arm.yaml"), rate=200), np.random.default_rng(0)
    ticks = np.arange(4400)  # two cycles and their next home marks
    truth = arm.truth(ticks[-40:])
    for joint in arm.joints:
        scans = arm.scans(joint, ticks).scans
        thetas = [theta_of(pose) for pose in truth.T_parent_child[joint].rotations]
        for begin, length in zip(chance.integers(300, 1300, 8), chance.integers(20, 100, 8), strict=True):
            is_there = (ticks < begin) | (ticks >= begin + length)
            estimates = Posor(arm.calibrations[joint]).estimate_all(scans.select(is_there))
            assert not (estimates.faults & Fault.LATCHED).any()
            assert set(estimates.states[-40:]) == {State.OK}
            np.testing.assert_allclose(estimates.thetas[-40:], thetas, rtol=0.0, atol=1e-4)


OTHER_PROCESS = """
import sys
from pathlib import Path
import numpy as np
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor.chain.arm_file import load_arm_file

arm = ArmSimulation(load_arm_file(Path(sys.argv[1])))
ticks = np.arange(*map(int, sys.argv[3:]))
arm.scans("elbow", ticks[::-1].copy())  # earlier calls have no effect
truth = arm.truth(ticks)
out = {"endpoint": truth.endpoint.translations, "encoder": truth.encoder, "angles": truth.angles}
for joint in arm.joints:
    simulated = arm.scans(joint, ticks)
    out |= {f"{joint} {name}": getattr(simulated, name) for name in ("statuses", "sent", "latencies_ns")}
    for name in ("gap_voltages", "ring_voltages", "diode_currents", "supply_voltages", "lit_sources"):
        out[f"{joint} {name}"] = getattr(simulated.scans, name)
assert "rclpy" not in sys.modules
np.savez(sys.argv[2], **out)
"""


@pytest.mark.long
def test_other_processes_that_start_elsewhere_give_the_same_numbers(tmp_path: Path) -> None:
    path = write_arm(tmp_path)
    found = []
    for name, first in (("one", FAR - 30), ("other", FAR + 50)):
        file = tmp_path / f"{name}.npz"
        command = [sys.executable, "-c", OTHER_PROCESS, str(path), str(file), str(first), str(FAR + 130)]
        subprocess.run(command, check=True)
        with np.load(file) as arrays:
            found.append({key: arrays[key] for key in arrays.files})
    assert len(found[0]) == 3 + 8 * len(JOINTS)
    for key, values in found[0].items():
        assert np.array_equal(values[80:], found[1][key])


def test_another_seed_gives_other_numbers(tmp_path: Path, everything: ArmSimulation) -> None:
    other = simulation(tmp_path, content=scenario({"seed": 1986}))
    assert not np.array_equal(other.truth(TICKS).endpoint.translations, everything.truth(TICKS).endpoint.translations)
    assert not np.array_equal(other.scans("base", TICKS).sent, everything.scans("base", TICKS).sent)


UNMEASURED = ("temperatures", "reference_voltages")
MECHANICAL = {"endpoint", "T_parent_child"}
CHANGES = {
    "noise": set(READINGS),
    "quantisation": set(READINGS),
    "zero_drift": {"gap_voltages", "ring_voltages"},
    "supply_drift": {"gap_voltages", "ring_voltages", "supply_voltages"},
    "ambient_light": set(),  # no joint of this arm has dark scans
    "contamination": {"gap_voltages", "diode_currents"},
    "dropouts": {"sent"},
    "latency": {"latencies_ns"},
    "calibration_errors": set(READINGS),
    "beam_errors": set(READINGS) | MECHANICAL,
    "sag": set(READINGS) | MECHANICAL,
    "inertia": set(),  # of beams that do not sag
    "sag inertia": set(READINGS) | MECHANICAL,
}


def differing(one: Any, other: Any, names: Iterable[str]) -> set[str]:
    """Return which of some arrays differ; quantities that nobody measures are NaN."""
    pairs = {name: (np.asarray(getattr(one, name)), np.asarray(getattr(other, name))) for name in names}
    return {name for name, pair in pairs.items() if not np.array_equal(*pair, equal_nan=name in UNMEASURED)}


def changed(one: ArmSimulation, other: ArmSimulation, ticks: np.ndarray[Any, Any]) -> set[str]:
    out = set()
    truths = one.truth(ticks), other.truth(ticks)
    out |= differing(*truths, ("commanded", "encoder", "angles"))
    for name in ("endpoint", "target"):
        if differing(getattr(truths[0], name), getattr(truths[1], name), ("rotations", "translations")):
            out.add(name)
    for joint in JOINTS:
        if differing(truths[0].T_parent_child[joint], truths[1].T_parent_child[joint], ("rotations", "translations")):
            out.add("T_parent_child")
        scans = one.scans(joint, ticks), other.scans(joint, ticks)
        out |= differing(scans[0].scans, scans[1].scans, SCAN_FIELDS)
        out |= differing(*scans, ("statuses", "sent", "latencies_ns"))
    return out


def test_every_imperfection_is_tested() -> None:
    others = {"temperature", "vibration"}  # see test_beam_heat.py and test_link_vibration.py
    assert {*" ".join(CHANGES).split(), *others} == set(Imperfections.model_fields)


@pytest.mark.parametrize("names", CHANGES)
def test_each_imperfection_changes_only_its_own_quantities(tmp_path: Path, names: str) -> None:
    clean = simulation(tmp_path, Imperfections.only())
    *others, name = names.split()
    without = simulation(tmp_path, Imperfections.only(*others)) if others else clean
    assert changed(simulation(tmp_path, Imperfections.only(*others, name)), without, FAR + TICKS) == CHANGES[names]


def test_stage_moves_endpoint_and_last_target_plate_alike(everything: ArmSimulation) -> None:
    position = np.random.default_rng(3).uniform(-5e-4, 5e-4, size=(N, 3))
    still, moved = everything.truth(TICKS), everything.truth(TICKS, position)
    shift = moved.endpoint.translations - still.endpoint.translations
    assert np.allclose(still.endpoint.rotate_back(shift), position, rtol=0.0, atol=1e-15)
    for joint in JOINTS[:-1]:
        assert np.array_equal(moved.T_parent_child[joint].translations, still.T_parent_child[joint].translations)
    seen = moved.T_parent_child["elbow"].translations - still.T_parent_child["elbow"].translations
    assert np.allclose(np.linalg.norm(seen, axis=1), np.linalg.norm(shift, axis=1), rtol=1e-9)
    for n in range(0, N, 40):
        by_posors = by_chain(everything, moved, n).translation - by_chain(everything, still, n).translation
        assert np.allclose(by_posors, shift[n], rtol=0.0, atol=2e-9)
    assert np.array_equal(moved.target.translations, still.target.translations)


def test_scenario_of_other_joints_is_refused(tmp_path: Path) -> None:
    error = refused(tmp_path, scenario({"joints.wrist": {}}))
    assert error.where == f"{tmp_path / 'scenario.yaml'}, key joints"
    assert (error.what, error.expected) == ("joints base, shoulder, elbow, wrist", "base, shoulder, elbow")


def test_scenario_that_never_passes_the_home_mark_is_refused(tmp_path: Path) -> None:
    rest = [{"kind": "rest", "duration": {"value": 8.0, "unit": "s"}}]
    error = refused(tmp_path, scenario({"motion": rest, "joints.base.start": {"value": 0.5, "unit": "rad"}}))
    assert error.what == "joint 'base' never passes the home mark of its ring, so its theta cannot be counted"
    assert error.expected == "a motion through theta = 0 rad"
