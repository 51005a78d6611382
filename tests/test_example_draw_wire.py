# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The example of docs/how_to/adding_a_sensor.md: a sensor type in its own package, built with colcon and used."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.calibration_file import load_calibration
from posor.errors import CalibrationError
from posor.estimation.clocks import LATE_RUN
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.estimation.sensor_stack import Stack
from posor.model.fault import Fault, State
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import Scan, Scans
from posor.numerics.array_types import FloatArray
from posor.sensors.base import PlainSensor
from posor.sensors.registry import sensor_types
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.graph import Graph, scan_message, wait_for_value
from posor_lab.harness.message_conversion import pose_from_message
from posor_lab.harness.program import HAND_FED, Program, installed
from posor_lab.harness.random_poses import TICK_NS, errors_in_parent
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.ros_arguments import ros_arguments
from scipy.stats import chi2

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "posor_draw_wire"
WIRES = 4
RELATIVE = 1e-6


@dataclass(frozen=True)
class Overlay:
    """The example as colcon has installed it, in a workspace of its own on top of this one."""

    install: Path

    def command(self, command: Sequence[str]) -> list[str]:
        return ["/bin/sh", "-c", '. "$0" && exec "$@"', str(self.install / "local_setup.sh"), *command]

    @property
    def calibration(self) -> Path:
        return self.install / "posor_draw_wire" / "share" / "posor_draw_wire" / "config" / "triad_draw_wire.yaml"


def built(home: Path) -> Overlay:
    folders = {name: str(home / name) for name in ("build", "install", "log")}
    done = subprocess.run(
        [
            *(sys.executable, "-m", "colcon", "--log-base", folders["log"], "build"),
            *("--base-paths", str(EXAMPLE), "--build-base", folders["build"], "--install-base", folders["install"]),
        ],
        cwd=home,
        env={**os.environ, "COLCON_DEFAULTS_FILE": os.devnull},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return Overlay(home / "install")


def wires_of(stack: Stack) -> PlainSensor:
    [sensor] = [sensor for sensor in stack.sensors if isinstance(sensor, PlainSensor)]
    return sensor


def poses(count: int, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw poses: leans to 4 mrad, theta to 0.2 rad, 1 mm across, gaps of 0.5 to 1 mm."""
    native = random.uniform(-1.0, 1.0, (count, 3)) * [0.004, 0.004, 0.2]
    across = random.uniform(-1e-3, 1e-3, (count, 2))
    along = random.uniform(0.5e-3, 1.0e-3, count)
    return np.array([rotation_from_native(*angles) for angles in native]), np.column_stack([across, along])


def read_by(
    stack: Stack, rotations: FloatArray, translations: FloatArray, noise: np.random.Generator | None = None
) -> Scans:
    """Return what a stack reads at poses; the wires' voltages by the inverse of their linearisation."""
    count = len(rotations)
    scans = scans_at(stack, rotations, translations, np.arange(1, count + 1, dtype=np.int64) * TICK_NS, noise=noise)
    wires = wires_of(stack)
    lengths = np.array([wires.predict(r, t)[0] for r, t in zip(rotations, translations, strict=True)])
    offset, slope = wires.parameter_values[-2 * WIRES :].reshape(WIRES, 2).T
    volts = (lengths - offset) / slope
    if noise is not None:
        volts += 2e-4 * noise.normal(size=volts.shape)  # as the calibration file says
    return scans.with_fields({"ring_voltages": volts})


def one_scan(posor: Posor) -> tuple[Scan, FloatArray, FloatArray]:
    rotation, translation = rotation_from_native(2e-3, -1e-3, 0.12), np.array([3e-4, -2e-4, 0.7e-3])
    return read_by(posor.stack, rotation[None], translation[None])[0], rotation, translation


def fourth_order(function: Callable[[float], FloatArray], step: float) -> FloatArray:
    """Return d function(x)/dx at zero by central differences."""
    near, far = function(step) - function(-step), function(2.0 * step) - function(-2.0 * step)
    return np.asarray((8.0 * near - far) / (12.0 * step))


@pytest.fixture(scope="module")
def overlay(tmp_path_factory: pytest.TempPathFactory) -> Overlay:
    return built(tmp_path_factory.mktemp("overlay"))


@pytest.fixture(scope="module")
def posor_maker(overlay: Overlay) -> Iterator[Callable[[], Posor]]:
    """Return a maker of the example's POSOR, the example's folder being on this process's path."""
    done = subprocess.run(
        overlay.command([sys.executable, "-c", "import posor_draw_wire; print(posor_draw_wire.__path__[0])"]),
        capture_output=True,
        text=True,
        check=True,
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(done.stdout.strip()).parent))
        sensor_types.cache_clear()
        calibration = load_calibration(overlay.calibration)
        yield lambda: Posor(calibration)
    sensor_types.cache_clear()


@pytest.fixture
def posor(posor_maker: Callable[[], Posor]) -> Posor:
    return posor_maker()


@pytest.mark.parametrize(
    ("key", "quantity", "complaint"),
    [
        ("noise", {"value": 0.0, "unit": "V"}, "noise 0.0; expected more than 0 V"),
        ("range", {"value": [9.5, 0.5], "unit": "V"}, "expected [lowest, highest] voltage"),
        ("volts_to_length", {"value": [0.1, 0.0], "unit": "m/V^k"}, "expected a slope A_1 other than 0 m/V"),
        ("anchor", {"value": [0.1, 0.0], "unit": "m"}, "expected 3 numbers"),
        ("attachment", {"value": [0.1, 0.0, 0.0], "unit": "in"}, "unit 'in'; expected 'm', 'mm' or 'um'"),
    ],
)
def test_a_wrong_calibration_is_refused_with_file_line_and_key(
    posor: Posor, tmp_path: Path, key: str, quantity: object, complaint: str
) -> None:
    content = posor.calibration.model_dump(mode="json")
    content["sensors"][1]["wires"][2][key] = quantity
    file = tmp_path / "wrong.yaml"
    file.write_text(json.dumps(content, indent=1), encoding="utf-8")  # YAML, which JSON is
    error = refusal(CalibrationError, load_calibration, file)
    assert error.where.startswith(f"{file}, line ")
    assert "sensors[1].wires[2]" in error.where
    assert str(error).endswith(f"{complaint}.")


# The model.


def test_analytic_derivatives_are_the_finite_differences(posor: Posor) -> None:
    random = np.random.default_rng(3)
    wires = wires_of(posor.stack)
    for rotation, translation in zip(*poses(3, random), strict=True):
        scan = read_by(posor.stack, rotation[None], translation[None])[0]
        _, by_pose = wires.predict(rotation, translation)
        by_parameter = wires.predict_jacobian(rotation, translation)
        of_reading = wires.read(scan).jacobian
        for i, direction in enumerate(np.eye(6)):

            def moved(by: float, direction: FloatArray = direction) -> FloatArray:
                pose = pin.SE3(rotation, translation) * pin.exp6(by * direction)  # noqa: B023  called at once
                return wires.predict(pose.rotation, pose.translation)[0]

            assert by_pose[:, i] == pytest.approx(fourth_order(moved, 1e-4), rel=RELATIVE, abs=1e-9)
        for p, name in enumerate(wires.parameter_names):
            one = np.eye(wires.parameter_values.size)[p]

            def other(by: float, one: FloatArray = one) -> PlainSensor:
                return wires.with_parameter_values(wires.parameter_values + by * one)

            predicted = fourth_order(lambda by: other(by).predict(rotation, translation)[0], 1e-4)  # noqa: B023
            assert by_parameter[:, p] == pytest.approx(predicted, rel=RELATIVE, abs=1e-9), name
            read = fourth_order(lambda by: other(by).read(scan).values, 1e-4)  # noqa: B023
            assert of_reading[:, p] == pytest.approx(read, rel=RELATIVE, abs=1e-9), name


def test_the_noise_of_a_voltage_comes_through_the_slope(posor: Posor) -> None:
    scan = one_scan(posor)[0]
    assert wires_of(posor.stack).read(scan).variances == pytest.approx(np.full(WIRES, (0.01 * 2e-4) ** 2), rel=1e-12)


# The estimator with it.


@pytest.mark.long
def test_closure(posor: Posor) -> None:
    rotations, translations = poses(50, np.random.default_rng(50))
    found = posor.estimate_each(read_by(posor.stack, rotations, translations))
    assert (found.states == State.OK).all()
    errors = errors_in_parent(found.rotations, found.translations, rotations, translations)
    assert np.max(np.linalg.norm(errors[:, :3], axis=1)) < 1e-9
    assert np.max(np.linalg.norm(errors[:, 3:], axis=1)) < 1e-9
    assert found.residuals == pytest.approx(np.zeros(50), abs=1e-9)


@pytest.mark.long
def test_the_stated_uncertainty_holds(posor: Posor) -> None:
    """Each run has another noise, and another real POSOR, drawn from the uncertainties of its calibration."""
    random, runs = np.random.default_rng(8), 400
    rotations, translations = poses(runs, random)
    values, sigmas = posor.stack.parameter_values, posor.stack.parameter_sigmas
    random_squared, total_squared, residuals = 0.0, 0.0, []
    for n in range(runs):
        here = rotations[n : n + 1], translations[n : n + 1]
        found = posor.estimate_each(read_by(posor.stack, *here, noise=random))
        error = errors_in_parent(found.rotations, found.translations, *here)[0]
        assert np.isfinite(found.covariances_random).all()
        random_squared += error @ np.linalg.solve(found.covariances_random[0], error)
        real = posor.stack.with_parameter_values(values + sigmas * random.normal(size=sigmas.size))
        found = posor.estimate_each(read_by(real, *here, noise=random))
        if found.states[0] == State.LOST:  # one in a thousand, by the chi-square test
            continue
        error = errors_in_parent(found.rotations, found.translations, *here)[0]
        total = found.covariances_random[0] + found.covariances_systematic[0]
        total_squared += error @ np.linalg.solve(total, error)
        residuals.append(found.residuals[0])
    kept = len(residuals)
    assert kept >= runs - 4
    assert chi2.ppf(0.01, 6 * runs) < random_squared < chi2.ppf(0.99, 6 * runs)
    assert chi2.ppf(0.01, 6 * kept) < total_squared < chi2.ppf(0.99, 6 * kept)
    assert chi2.ppf(0.01, kept) < sum(residuals) < chi2.ppf(0.99, kept)


@pytest.mark.long
def test_one_by_one_together_and_again_give_the_same_bits(posor_maker: Callable[[], Posor]) -> None:
    posor, again = posor_maker(), posor_maker()
    thetas = 0.1 * np.sin(np.linspace(0.0, 3.0, 40))
    rotations = np.array([rotation_from_native(1e-3, -2e-3, theta) for theta in thetas])
    translations = np.tile([2e-4, 1e-4, 0.7e-3], (40, 1))
    scans = read_by(posor.stack, rotations, translations, np.random.default_rng(4))
    together, alone = posor.estimate_all(scans), [again.estimate(scans[n]) for n in range(40)]
    assert (together.states == State.OK).all()
    assert np.array([e.T_R_T.translation for e in alone if e.T_R_T]).tobytes() == together.translations.tobytes()
    assert np.array([e.T_R_T.rotation for e in alone if e.T_R_T]).tobytes() == together.rotations.tobytes()
    posor.reset()
    once_more = posor.estimate_all(scans)
    assert once_more.translations.tobytes() == together.translations.tobytes()
    assert once_more.covariances_systematic.tobytes() == together.covariances_systematic.tobytes()
    # Time goes back: once some scans show that the recording has started over, the poses are the same without a reset.
    over = posor.estimate_all(scans)
    assert (over.states[: LATE_RUN - 1] == State.LOST).all()
    np.testing.assert_allclose(over.translations[LATE_RUN:], together.translations[LATE_RUN:], rtol=0.0, atol=1e-14)


def test_a_jump_far_from_the_last_pose_is_found(posor: Posor) -> None:
    rotations = np.array([rotation_from_native(1e-3, -2e-3, theta) for theta in (-0.3, 0.3)])
    translations = np.array([[-1e-3, 1e-3, 0.9e-3], [1e-3, -1e-3, 0.6e-3]])
    found = posor.estimate_all(read_by(posor.stack, rotations, translations))
    assert (found.states == State.OK).all()
    assert found.translations == pytest.approx(translations, abs=1e-9)


# What is wrong with a scan.


def changed(scan: Scan, wire: int, volt: float) -> Scan:
    volts = scan.ring_voltages.copy()
    volts[wire] = volt
    return replace(scan, ring_voltages=volts)


@pytest.mark.parametrize(
    ("make", "fault", "reason"),
    [
        (
            lambda scan: changed(scan, 2, np.nan),
            Fault.BAD_READING,
            "scan 0, draw wire wire_3: voltage nan; expected a finite voltage.",
        ),
        (
            lambda scan: changed(scan, 1, 0.02),
            Fault.OUT_OF_RANGE,
            "scan 0, draw wire wire_2: 0.02 V is outside the calibrated range; expected 0.5 to 9.5 V.",
        ),
        (
            lambda scan: replace(scan, ring_voltages=scan.ring_voltages[:3]),
            Fault.BAD_READING,
            "scan 0: 3 draw wire voltages; expected 4.",
        ),
    ],
)
def test_a_broken_wire_is_told(posor: Posor, make: Callable[[Scan], Scan], fault: Fault, reason: str) -> None:
    scan, _, translation = one_scan(posor)
    broken = posor.estimate(make(scan))
    assert (broken.state, broken.faults, broken.reason) == (State.LOST, fault, reason)
    assert broken.T_R_T is None
    sound = posor.estimate(scan)
    assert sound.T_R_T is not None
    assert sound.T_R_T.translation == pytest.approx(translation, abs=1e-9)


def test_a_wire_caught_on_something_contradicts_the_others(posor: Posor) -> None:
    scan, _, _ = one_scan(posor)
    caught = posor.estimate(changed(scan, 0, float(scan.ring_voltages[0]) + 0.2))  # 2 mm too long
    assert (caught.state, caught.faults) == (State.LOST, Fault.RESIDUAL)
    assert "contradict" in caught.reason


# The node with it.


@pytest.mark.usefixtures("ros_domain")
def test_posor_node_gives_the_same_pose(overlay: Overlay, posor: Posor) -> None:
    scan, rotation, translation = one_scan(posor)
    expected = posor.estimate(scan)
    parameters = {"calibration": str(overlay.calibration), "lossless": True, **HAND_FED}
    node = overlay.command([*installed("posor_estimator", "posor_node"), *ros_arguments(parameters)])
    with Program(node) as program, Graph() as graph:
        transforms = graph.collect(JointTransform, "transform")
        graph.watch_diagnostics()
        raw = graph.publisher(RawScan, "raw")
        wait_for_value(graph, "/posor_node: listeners", "transform", "1")
        raw.publish(scan_message(scan))
        graph.wait_until(lambda: len(transforms) == 1, "a transform")
        program.end()
    [transform] = transforms
    assert (transform.state, transform.faults) == (JointTransform.STATE_OK, JointTransform.FAULT_NONE)
    pose = pose_from_message(transform.pose)
    assert expected.T_R_T is not None
    assert pose.translation.tobytes() == expected.T_R_T.translation.tobytes()
    assert pose.translation == pytest.approx(translation, abs=1e-9)
    assert pose.rotation == pytest.approx(rotation, abs=1e-9)
    assert np.reshape(transform.covariance_random, (6, 6)) == pytest.approx(expected.covariance_random, rel=1e-12)
    systematic = np.reshape(transform.covariance_systematic, (6, 6))
    assert systematic == pytest.approx(expected.covariance_systematic, rel=1e-12)
