"""Run every kind of kernel on the same random inputs and save what comes out: ``kernel_outputs.py FILE.npz``.

A program of its own, since whether kernels are compiled is decided when they are imported (POSOR_COMPILE).
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import numpy as np
from posor_estimator.core import compiled
from posor_estimator.core.chain import Chain
from posor_estimator.core.chain_records import ChainRecords
from posor_estimator.core.designs import DesignName, design
from posor_estimator.core.forward import scans_at
from posor_estimator.core.kernels import blocks, chain, chain_motion, cholesky, solve, vector
from posor_estimator.core.kernels.moments import FIGURES, figures_of
from posor_estimator.core.kernels.rows import GAP, RING, SPOT_X, SPOT_Y, evaluate_row, row_parameters
from posor_estimator.core.native import rotation_from_native
from posor_estimator.core.posor import Posor
from posor_estimator.core.records import Records
from posor_estimator.core.warm_up import ARM, OF_A_POSE, rows_of

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

CASES = 100
HARMONICS = ((1.0, 1e-5), (36.0, 2e-4), (72.0, 1e-5))


def random_pose(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return rotation and translation: any turn, small leans."""
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


def one_by_one(rng: np.random.Generator) -> list[float]:
    """Return the outputs of the kernels of one row, of the pose and of the factorisation."""
    out: list[float] = []
    rotation, translation = random_pose(rng)
    probe, diode, ring_probe = random_rows(rng)
    tangent = np.empty(6)
    by_parameter = np.zeros(32)
    for kind, row in ((GAP, probe), (SPOT_X, diode), (SPOT_Y, diode), (RING, ring_probe)):
        out += [evaluate_row(kind, row, rotation, translation, np.zeros(6), tangent), *tangent]
        row_parameters(kind, row, rotation, translation, by_parameter)
        out += by_parameter.tolist()
    for size in (1e-6, 1e-2, 1.0):
        vector.apply_tangent(rotation, translation, rng.uniform(-size, size, 6))
        vector.orthonormalise(rotation)
        out += [*rotation.ravel(), *translation]
    matrix = np.cov(rng.normal(size=(6, 20)))
    right = rng.normal(size=6)
    weights, nothing = rng.uniform(0.5, 2.0, 8), np.zeros((8, 6))
    for jacobian in (rng.normal(size=(8, 6)), np.eye(8, 6), nothing):  # of the last no unknown is left
        out.append(blocks.factor(blocks.normal_matrix(jacobian, weights, 8))[1])
    out.append(cholesky.factor(matrix))
    cholesky.halve(matrix, right)
    return [*out, *np.tril(matrix).ravel(), *right]


def whole_scan(rng: np.random.Generator) -> list[float]:
    """Return the outcome of the solver for one scan with noise."""
    kinds = np.array([GAP, GAP, GAP, SPOT_X, SPOT_Y, SPOT_X, SPOT_Y, RING])
    geometry = np.zeros((len(kinds), 17))
    for row, kind in zip(geometry, kinds, strict=True):
        probe, diode, ring_probe = random_rows(rng)
        made = {GAP: probe, RING: ring_probe}.get(int(kind), diode)
        row[: made.size] = made
    geometry[4], geometry[6] = geometry[3], geometry[5]
    rotation, translation = random_pose(rng)
    jacobian, residuals, moved = np.empty((len(kinds), 6)), np.empty(len(kinds)), np.empty(6)
    values = rng.normal(0, 1e-4, len(kinds))
    weights = rng.uniform(0.5, 2.0, len(kinds)) * 1e12
    outcome = solve.gauss_newton(
        kinds, geometry, values, weights, rotation, translation, jacobian, residuals, moved, 1e-7
    )
    return [outcome, *rotation.ravel(), *translation, *jacobian.ravel(), *residuals, *moved]


def arm(rng: np.random.Generator) -> list[float]:
    """Return the endpoints of a moving arm of two joints, and a beam that sags on either side of the second."""
    scans, sources = 12, np.array([0, -1, 1, -2])
    rotations = np.array([random_pose(rng)[0] for _ in range(7)])
    frames = np.concatenate([rotations[:5], rng.uniform(-1.0, 1.0, (5, 1, 3))], axis=1)
    beams = np.concatenate(
        [rotations[5:], rng.uniform(-1.0, 1.0, (2, 1, 3)), rng.uniform(-1e-4, 1e-4, (2, chain.BEAM_ROWS - 4, 3))],
        axis=1,
    )
    quaternions = rng.normal(size=(scans, 2, 4))
    quaternions /= np.linalg.norm(quaternions, axis=2, keepdims=True)
    poses = np.concatenate([rng.uniform(-1e-3, 1e-3, (scans, 2, 3)), quaternions], axis=2)
    poses[scans // 2, 1, 4] = math.nan
    roots = rng.normal(size=(scans + 1, 2, 6, 6)) * 1e-6
    covariances = roots @ np.swapaxes(roots, 2, 3)
    stamps = np.cumsum(rng.integers(1, 1000, scans))
    kept = np.zeros(chain_motion.KEPT, dtype=np.int64)
    kept[chain_motion.WINDOW] = 3000
    found, found_covariances = np.empty((scans, 7)), np.empty((scans, 6, 6))
    angles, faults = np.empty((scans, 2)), np.empty((scans, 2), dtype=np.int64)
    chain.endpoints(
        sources,
        frames,
        beams,
        covariances[-1],
        rotations[:2],
        np.array([0.1, 0.2, -9.8]),
        kept,
        np.zeros(scans, dtype=np.int64),
        np.zeros((scans, 6)),
        np.zeros(6),
        np.empty(6),
        0,
        stamps,
        poses,
        covariances[:-1],
        rng.uniform(-9.0, 9.0, (scans, 2)),
        found,
        found_covariances,
        angles,
        faults,
    )
    relative, relative_covariances = np.empty((scans, 7)), np.empty((scans, 6, 6))
    chain.relative_to(found[0], found, found_covariances, relative, relative_covariances)
    outputs = found, found_covariances, angles, faults, relative, relative_covariances
    return [number for each in outputs for number in each.ravel().tolist()]


def raw_scans(name: DesignName) -> FloatArray:
    """Return all that is made of noisy raw scans of a design, from voltages and currents to covariances."""
    posor = Posor(design(name, motion=True))
    count = 6
    rotations = np.array([rotation_from_native(1e-4, -2e-4, 2e-3 * n) for n in range(count)])
    translations = np.tile([2e-5, 1e-5, 0.7e-3], (count, 1))
    stamps = np.arange(1, count + 1, dtype=np.int64) * 1_000_000
    scans = scans_at(posor.stack, rotations, translations, stamps, noise=np.random.default_rng(8))
    scans.at_home[0] = 1
    found = posor.locate_all(scans)
    arrays = (found.rotations, found.covariances_random, found.covariances_systematic, found.figures)
    return np.concatenate([array.reshape(count, -1) for array in arrays], axis=1)


def records(name: DesignName) -> FloatArray:
    """Return the bytes that scans make which are rows of bytes, and the endpoint of an arm of one such joint."""
    posor = Posor(design(name, motion=True))
    count, stamps = 6, np.arange(1, 7, dtype=np.int64) * 1_000_000 - 2**31 * 10**9
    rotations = np.array([rotation_from_native(1e-4, -2e-4, 2e-3 * n) for n in range(count)])
    raw, columns = rows_of(scans_at(posor.stack, rotations, np.tile([2e-5, 1e-5, 0.7e-3], (count, 1)), stamps))
    raw.view(np.uint64)[:, 1], raw.view(np.int32)[:, 4] = 2**64 - 1, -(2**31) + 1
    raw.view(np.float64)[3, 3] = math.nan
    raw.view(np.int32)[4, :2] = 0
    out = np.zeros((count, OF_A_POSE.size), dtype=np.uint8)
    Records(posor, columns, out[0].copy()).locate(raw, out)
    lane = Chain(ARM, "endpoint").lane()
    chain = ChainRecords(lane, [OF_A_POSE])
    chain.rows[0] = out[1]
    worst, times = chain.run(1), np.empty(FIGURES)
    counted = figures_of(stamps // 1000, 2**62, times)
    return np.concatenate(
        [out.view(np.float64).ravel(), [worst, counted], times, lane.pose, lane.covariance.ravel(), lane.angles]
    )


def main(file: Path) -> None:
    """Save the outputs, and whether the kernels were compiled."""
    rng = np.random.default_rng(1985)
    rows = [one_by_one(rng) for _ in range(CASES)]
    scans = [whole_scan(rng) for _ in range(CASES)]
    arms = [arm(rng) for _ in range(CASES)]
    raw = [raw_scans(name) for name in get_args(DesignName)]
    of_records = [records(name) for name in get_args(DesignName)]
    outputs = {
        "rows": np.array(rows),
        "scans": np.array(scans),
        "arms": np.array(arms),
        "raw": np.array(raw),
        "records": np.array(of_records),
    }
    np.savez(file, allow_pickle=False, compiling=np.array(compiled.COMPILING), **outputs)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
