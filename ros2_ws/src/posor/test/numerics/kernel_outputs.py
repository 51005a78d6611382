# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Run the kernels on the same inputs and save what comes out: ``kernel_outputs.py FILE.npz [--short]``.

The inputs are random ones for each kind of kernel, the golden cases and a bag; with ``--short`` some golden cases and a
bag of 1985. A program of its own, since the way of the kernels is chosen when they are imported (POSOR_KERNELS).
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from posor import load_arm, load_calibration, read_scans
from posor.calibration.designs import DesignName, design
from posor.chain.arm_geometry import BEAM, ELEMENT, ArmGeometry
from posor.chain.beam_acceleration import BeamHistory
from posor.chain.endpoint_predictor import EndpointPredictor
from posor.chain.fault_bounds import ArmCauses, EndpointBounds, bound_endpoints
from posor.chain.forward_kinematics import Endpoints, estimate_endpoints
from posor.chain.joint_measurements import VIBRATION, JointMeasurements
from posor.chain.kinematic_chain import Chain
from posor.estimation import solver
from posor.estimation.fault_model import ALWAYS, EFFECT, SECOND, SHARED, JointCauses
from posor.estimation.posor import Posor
from posor.estimation.workspace import WORKSPACE
from posor.kernel_examples import ARM, example_stream
from posor.messages.message_stream import MessageEstimator
from posor.model.reading_rows import GAP, RING, SPOT_X, SPOT_Y, differentiate_rows, evaluate_rows
from posor.model.scan import Scans
from posor.node_parameters import EncodersParameters
from posor.numerics import compiled, vector
from posor.numerics import matrix as matrices
from posor.numerics.array_types import FloatArray
from posor.numerics.compiled import in_place, record_view
from posor.numerics.summary_statistics import FIGURES, figures_of
from posor_lab.accuracy.golden_command import StackName, read_cases
from posor_lab.harness.random_poses import turning_scans
from posor_lab.harness.row_builder import make_rows

CASES = 100
SOURCES = Path(__file__).resolve().parents[3]
BAGS = SOURCES.parents[1] / "bags"
GOLDEN = SOURCES / "posor" / "test" / "data" / "posor_cases.jsonl"
THETAS = 2e-3 * np.arange(6.0)
HARMONICS = ((1.0, 1e-5), (36.0, 2e-4), (72.0, 1e-5))


def random_pose(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    rotation, translation = np.eye(3), np.zeros(3)
    turn = np.array([0.0, 0.0, 0.0, 0.0, 0.0, rng.uniform(-math.pi, math.pi)])
    vector.apply_tangent(rotation, translation, turn)
    vector.apply_tangent(rotation, translation, rng.uniform(-1e-2, 1e-2, 6))
    return rotation, translation


def random_rows(rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the parameters of a gap probe, of a diode with its source, and of a ring probe."""
    probe = np.concatenate(
        [rng.uniform(-0.08, 0.08, 3), rng.normal([0, 0, 1], 0.01), rng.normal(0, 1e-3, 3), rng.normal(0, 0.03, 3)]
    )
    diode = np.concatenate(
        [
            *(rng.uniform(-0.05, 0.05, 3), rng.normal([1, 0, 0], 0.01), rng.normal([0, 1, 0], 0.01)),
            *(rng.uniform(-0.05, 0.05, 3), rng.normal([0, 0, -1], 0.01), rng.normal(0, 0.1, 1)),
        ]
    )
    around = rng.uniform(-math.pi, math.pi)
    outward = np.array([math.cos(around), math.sin(around), 0.0])
    profile = np.ravel([[k, *rng.uniform(-size, size, 2)] for k, size in HARMONICS])
    ring_probe = np.array([*(0.052 * outward), *(rng.normal(0, 0.01, 3) - outward), 0.0508, len(HARMONICS), *profile])
    return probe, diode, ring_probe


def kernel_values(rng: np.random.Generator) -> list[float]:
    """Return the outputs of the kernels of one row, of the pose and of the factorisation."""
    out: list[float] = []
    rotation, translation = random_pose(rng)
    probe, diode, ring_probe = random_rows(rng)
    rows = make_rows((GAP, SPOT_X, SPOT_Y, RING), (probe, diode, diode, ring_probe))
    readings, jacobian = evaluate_rows(rows, rotation, translation)
    out += [*readings, *jacobian.ravel(), *differentiate_rows(rows, rotation, translation).ravel()]
    for size in (1e-6, 1e-2, 1.0):
        vector.apply_tangent(rotation, translation, rng.uniform(-size, size, 6))
        vector.orthonormalise(rotation)
        out += [*rotation.ravel(), *translation]
    matrix = np.cov(rng.normal(size=(6, 20)))
    right = rng.normal(size=6)
    weights, nothing = rng.uniform(0.5, 2.0, 8), np.zeros((8, 6))
    for jacobian in (rng.normal(size=(8, 6)), np.eye(8, 6), nothing):  # the last determines no unknown
        out.append(matrices.factorise(matrices.normal_matrix(jacobian, weights, 8))[1])
    out.append(matrices.cholesky_factorise(matrix, 6))
    matrices.solve_lower_triangular(matrix, 6, right)
    return [*out, *np.tril(matrix).ravel(), *right]


@in_place
def solve_workspace(memory: NDArray[np.void], count: int) -> int:
    """Run the solver; compiled code takes records in arrays only."""
    return solver.solve_pose(memory[0], count, 1e-7, math.nan)


def solved_scan(rng: np.random.Generator) -> list[float]:
    """Return the outcome of the solver for one scan with noise."""
    kinds = [GAP, GAP, GAP, SPOT_X, SPOT_Y, SPOT_X, SPOT_Y, RING]
    drawn = [random_rows(rng) for _ in kinds]
    parameters = [row[0 if kind == GAP else 2 if kind == RING else 1] for kind, row in zip(kinds, drawn, strict=True)]
    parameters[4], parameters[6] = parameters[3], parameters[5]
    memory = np.zeros(1, dtype=WORKSPACE)
    workspace, count = memory[0], len(kinds)
    workspace["rows"][:count] = make_rows(kinds, parameters)
    rotation, translation = random_pose(rng)
    workspace["pose"]["rotation"], workspace["pose"]["translation"] = rotation, translation
    workspace["values"][:count] = rng.normal(0, 1e-4, count)
    workspace["weights"][:count] = rng.uniform(0.5, 2.0, count) * 1e12
    outcome = solve_workspace(record_view(memory), count)
    pose = workspace["pose"]
    arrays = (pose["rotation"], pose["translation"], workspace["jacobian"][:count], workspace["residuals"][:count])
    return [outcome, *(number for array in (*arrays, workspace["step_sum"]) for number in array.ravel().tolist())]


def arm(rng: np.random.Generator) -> list[float]:
    """Return the endpoints of a moving arm of two joints, and a beam that sags on either side of the second."""
    scans = 12
    rotations = np.array([random_pose(rng)[0] for _ in range(7)])
    elements, beams = np.zeros(5, dtype=ELEMENT), np.zeros(2, dtype=BEAM)
    elements["joint"], elements["beam"] = (0, -1, 1, -1, -1), (-1, 0, -1, 1, -1)
    elements["rotation"], elements["translation"] = rotations[:5], rng.uniform(-1.0, 1.0, (5, 3))
    beams["rotation"], beams["translation"] = rotations[5:], rng.uniform(-1.0, 1.0, (2, 3))
    for gain in (name for name in BEAM.names or () if name.endswith("gain")):
        beams[gain] = rng.uniform(-1e-4, 1e-4, (2, 3, 3))
    quaternions = rng.normal(size=(scans, 2, 4))
    quaternions /= np.linalg.norm(quaternions, axis=2, keepdims=True)
    poses = np.concatenate([rng.uniform(-1e-3, 1e-3, (scans, 2, 3)), quaternions], axis=2)
    poses[scans // 2, 1, 4] = math.nan
    roots = rng.normal(size=(2, scans + 1, 2, 6, 6)) * 1e-6
    random, systematic = roots @ np.swapaxes(roots, 3, 4)
    beams["covariance"] = systematic[-1]
    stamps = np.cumsum(rng.integers(1, 1000, scans))
    thetas = rng.uniform(-9.0, 9.0, (scans, 2))
    terms, shared = np.array([[0, 1], [1, -1]]), 1e-8 * rng.normal(size=(scans, 2, 2, 6))
    common = 1e-6 * rng.normal(size=(3, 2, 6)), 1e-8 * rng.normal(size=(3, 2, 6, 3))
    beams["expansion"] = 1e-6
    endpoints = Endpoints.allocate(scans, 2, 3)
    arm = ArmGeometry(elements, beams, rotations[:2], np.zeros((2, 3)), np.array([0.1, 0.2, -9.8]), terms, *common)
    shifts = rng.uniform(0.0, 1e-6, (scans, 2, 6))
    effects = 1e-6 * rng.normal(size=(scans, 2, 4, EFFECT))
    effects[..., 6] = rng.choice([0.3, 1.0, math.inf], (scans, 2, 4), p=[0.45, 0.45, 0.1])
    vibrations = np.zeros((scans, 2), dtype=VIBRATION)
    vibrations["mean"], vibrations["difference"] = 9.0 * rng.normal(size=(2, scans, 2, 3))
    vibrations["mean"][:3], vibrations["sigma_mean"], vibrations["bounded"] = math.nan, 0.5, 1
    vibrations["sigma_difference"] = 0.25
    vibrations["bounded"][5, 1] = 0
    measurements = JointMeasurements(
        stamps, poses, random[:-1], systematic[:-1], thetas, shared, shifts, effects.astype(np.float32), vibrations
    )
    estimate_endpoints(arm, BeamHistory.allocate(3e-6, 2), measurements, endpoints, 0)
    relative = endpoints.relative_to(endpoints.poses[0])
    _, causes = ArmCauses.of([JointCauses(("a", "b"), (0, 1, 1, 0), (SHARED, 0, SECOND, ALWAYS))] * 2)
    bounds = EndpointBounds.allocate(scans)
    bound_endpoints(arm, causes, measurements, endpoints, np.eye(3), bounds)
    outputs = *endpoints, *relative[:3], relative.stamp_shifts, *bounds
    return [number for each in outputs for number in each.ravel().tolist()]


def prediction(rng: np.random.Generator) -> FloatArray:
    """Return endpoints of an arm of one joint at the readings of its encoder, which turns back once."""
    parameters = EncodersParameters(sigma=(1e-6,), backlash=(1e-5,), lead_time=0.01)
    predictor, outputs = EndpointPredictor(Chain(ARM, "endpoint"), parameters), []
    measured, root = predictor.measurements, 1e-6 * rng.normal(size=(6, 6))
    measured.covariances_random[0, 0], measured.covariances_systematic[0, 0] = (
        np.diag(np.diag(root) ** 2),
        root @ root.T,
    )
    measured.thetas[0, 0] = math.nan
    for ms in range(1, 60):
        angle = 0.02 * math.sin(0.1 * ms)
        predictor.read(ms * 1_000_000, np.array([angle + 1e-6 * rng.normal()]))
        outputs += [*predictor.present.pose, *predictor.present.covariance().ravel()]
        outputs += [*predictor.ahead.pose, *predictor.ahead.covariance().ravel(), *predictor.twist_ahead.twist]
        if ms % 5 == 0:
            measured.poses[0, 0] = *1e-6 * rng.normal(size=3), 0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle)
            predictor.use_transform(0, ms * 1_000_000)
    return np.array(outputs)


def raw_scans(name: DesignName) -> FloatArray:
    """Return all that is made of noisy raw scans of a design, from voltages and currents to covariances."""
    posor = Posor(design(name, motion=True))
    scans = turning_scans(posor, THETAS, 8, home=[0])
    found = posor.estimate_all(scans, fault_effects=True)
    arrays = (found.fault_effects, found.rotations, found.covariances_random, found.covariances_systematic)
    others = (found.poses, found.natives, found.residuals)
    return np.concatenate([array.reshape(len(scans), -1) for array in (*arrays, *others)], axis=1)


def messages(name: DesignName) -> FloatArray:
    """Return the transforms of serialised raw scans, and the summary of their times."""
    posor = Posor(design(name, motion=True))
    scans = turning_scans(posor, THETAS)
    count, stamps = len(scans), scans.stamps_ns
    stream = example_stream(count)
    layout, raw = stream.raw_layout[0], stream.raw
    stream.status["readings_usable"] = 1
    for sequence, size in (("gap_voltages", "gap_count"), ("ring_voltages", "ring_count")):
        readings = getattr(scans, sequence)
        layout[size] = readings.shape[1]
        raw.floats[:, layout[sequence] // 8 :][:, : readings.shape[1]] = readings
    currents = scans.diode_currents.reshape(count, -1)
    layout["current_count"], layout["lit_count"] = currents.shape[1], scans.lit_sources.shape[1]
    raw.floats[:, layout["diode_currents"] // 8 :][:, : currents.shape[1]] = currents
    raw.octets[:, layout["lit_sources"] :][:, : scans.lit_sources.shape[1]] = scans.lit_sources
    for field, numbers in (("supply_voltage", scans.supply_voltages), ("temperature", scans.temperatures)):
        raw.floats[:, layout[field] // 8] = numbers
    raw.words[:, layout["stamp"] // 4 + 1] = stamps
    raw.floats[3, layout["gap_voltages"] // 8] = math.nan
    raw.words[4, layout["stamp"] // 4 :][:2] = 0
    assert MessageEstimator(posor, stream).estimate_rows()
    times = np.empty(FIGURES)
    counted = figures_of(stamps // 1000, 2**62, times)
    return np.concatenate([stream.transforms.floats.ravel(), [counted], times])


def golden(stack: StackName, count: int) -> FloatArray:
    """Return the predicted readings and the estimates of golden cases."""
    outputs: list[FloatArray] = []
    for case in list(read_cases(GOLDEN, stack))[:count]:
        posor = Posor(case.calibration)
        outputs += [posor.predict(case.scan, case.T_R_T), *estimates(posor, Scans.of([case.scan]))]
    return np.concatenate(outputs)


def estimates(posor: Posor, scans: Scans) -> list[FloatArray]:
    """Return all numbers of the estimates of scans."""
    found = posor.estimate_all(scans, fault_effects=True)
    covariances = found.covariances_random, found.covariances_systematic, found.fault_effects
    return [array.ravel().astype(float) for array in (found.poses, found.natives, found.residuals, *covariances)]


def rig_bag() -> FloatArray:
    """Return the estimates of a test of 1985."""
    calibration = load_calibration(SOURCES / "posor_bringup" / "config" / "slocum1985_printed.yaml")
    return np.concatenate(estimates(Posor(calibration), read_scans(BAGS / "ymo")))


def arm_bag() -> FloatArray:
    """Return joints and endpoints of the bag of an arm."""
    arm = load_arm(SOURCES / "posor_bringup" / "arms" / "five_axis" / "arm.yaml")
    found = arm.estimate(BAGS / "five_axis")
    endpoint = found.endpoint
    outputs = [endpoint.poses, endpoint.covariances_random, endpoint.covariances_systematic]
    for joint in found.joints.values():
        outputs += [joint.poses, joint.covariances_random, joint.covariances_systematic]
    return np.concatenate([array.ravel() for array in outputs])


def main(file: Path, *, short: bool) -> None:
    golden_cases = [golden(stack, 5 if short else CASES) for stack in get_args(StackName)]
    outputs = {"golden": np.concatenate(golden_cases), "rig": rig_bag()}
    np.savez(file, allow_pickle=False, mode=np.array(compiled.MODE), **outputs, **({} if short else all_outputs()))


def all_outputs() -> dict[str, FloatArray]:
    rng = np.random.default_rng(1985)
    outputs = {
        "rows": [kernel_values(rng) for _ in range(CASES)],
        "scans": [solved_scan(rng) for _ in range(CASES)],
        "prediction": prediction(np.random.default_rng(44)),
        "arms": [arm(rng) for _ in range(CASES)],
        "raw": np.concatenate([raw_scans(name).ravel() for name in get_args(DesignName)]),
        "messages": [messages(name) for name in get_args(DesignName)],
        "bag": arm_bag(),
    }
    return {name: np.array(values) for name, values in outputs.items()}


if __name__ == "__main__":
    main(Path(sys.argv[1]), short="--short" in sys.argv)
