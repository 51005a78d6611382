# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Filter the endpoint of simulated arms with its two covariances, and count how often the truth is inside the region.

The random part is white noise of each scan. The systematic part is a constant: a consider state, which the filter never
estimates but whose uncertainty stays in the result. Beside it: the same filter with the sum taken as white noise.
``filter_positions`` takes the arrays of ``EndpointEstimates``, or those of received ``EndpointState`` messages.

Equations: S. F. Schmidt, Application of State-Space Methods to Navigation Problems, Advances in Control Systems 3
(1966); D. Simon, Optimal State Estimation (2006), section 10.3.2.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from posor_bringup.arms import load_checked_arm
from posor_lab.arm_study.filter_runs import RATE, filter_runs
from scipy.stats import chi2

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from posor_lab.arm_study.filter_runs import FilterRun

Array = NDArray[np.float64]
ARM = "five_axis"
POSES, SCANS = 6, 120  # of each arm, of each run
ACCELERATION = {False: 1e-4, True: 2e-3}  # standard deviation that the filter assumes at rest, in motion [m/s^2]
SPEED = 0.5  # standard deviation of the speed before the first scan [m/s]
SETTLED = 60  # scans after which the coverage is counted
CONSIDER, WHITE = "random white, systematic constant", "sum taken as white"
REGION = float(chi2.ppf(0.95, 3))


def filter_positions(
    times_s: Array, positions: Array, random: Array, systematic: Array, acceleration: float
) -> tuple[Array, Array]:
    """Return filtered positions (n, 3) and their covariances (n, 3, 3) from positions [m] and covariances of n scans.

    State: position and velocity, disturbed by an acceleration that is new in each period. A scan reads
    ``position + L u + noise`` with ``L L' = systematic`` and the consider state u, three constants of variance one.
    """
    H, one = np.eye(3, 6), np.eye(3)
    variances, axes = np.linalg.eigh(systematic)
    roots = axes * np.sqrt(np.maximum(variances, 0.0))[:, None] @ np.swapaxes(axes, 1, 2)
    x = np.concatenate([positions[0], np.zeros(3)])
    P = np.diag([0.0, 0.0, 0.0, SPEED**2, SPEED**2, SPEED**2]) + H.T @ (random[0] + systematic[0]) @ H
    C = H.T @ roots[0]  # covariance of the error of x with u
    found, covariances = [x[:3]], [P[:3, :3]]
    for n in range(1, len(times_s)):
        dt, L = times_s[n] - times_s[n - 1], roots[n]
        F = np.eye(6)
        F[:3, 3:] = dt * one
        G = np.vstack([0.5 * dt**2 * one, dt * one])
        x, P, C = F @ x, F @ P @ F.T + acceleration**2 * G @ G.T, F @ C
        cross = P @ H.T - C @ L.T  # covariance of the error of x with the innovation, negative
        S = H @ cross - L @ C.T @ H.T + systematic[n] + random[n]
        K = np.linalg.solve(S, cross.T).T
        x, P, C = x + K @ (positions[n] - H @ x), P - K @ S @ K.T, C + K @ (L - H @ C)
        found.append(x[:3])
        covariances.append(P[:3, :3])
    return np.array(found), np.array(covariances)


def filtered_errors(run: FilterRun, name: str) -> tuple[Array, Array]:
    """Return the errors (n, 3) of the filtered positions of a run and their covariances (n, 3, 3)."""
    random, systematic = run.endpoints.covariances_random, run.endpoints.covariances_systematic
    if name == WHITE:
        random, systematic = random + systematic, np.zeros_like(systematic)
    positions, parts = run.endpoints.poses[:, :3], (random[:, :3, :3], systematic[:, :3, :3])
    found, covariances = filter_positions(run.times_s, positions, *parts, ACCELERATION[run.in_motion])
    return found - run.truth, covariances


def find_inside(runs: Iterable[FilterRun]) -> Mapping[tuple[str, bool], NDArray[np.bool_]]:
    """Return which positions are inside their 95 % regions, (runs, n), by filter and motion."""
    inside: dict[tuple[str, bool], list[NDArray[np.bool_]]] = {}
    for run in runs:
        for name in (CONSIDER, WHITE):
            errors, covariances = filtered_errors(run, name)
            squares = np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])
            inside.setdefault((name, run.in_motion), []).append(squares <= REGION)
    return {key: np.array(rows) for key, rows in inside.items()}


def draw(run: FilterRun, inside: Mapping[tuple[str, bool], NDArray[np.bool_]], path: str) -> None:
    """Draw the error of z of one run with the bands of both filters, and the coverage against time."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    left.plot(run.times_s, 1e6 * (run.endpoints.poses[:, 2] - run.truth[:, 2]), ".", color="silver", label="scans")
    for name, colour in ((CONSIDER, "tab:blue"), (WHITE, "tab:red")):
        errors, covariances = filtered_errors(run, name)
        centre, band = 1e6 * errors[:, 2], 2e6 * np.sqrt(covariances[:, 2, 2])
        left.plot(run.times_s, centre, color=colour)
        left.fill_between(run.times_s, centre - band, centre + band, color=colour, alpha=0.25, label=f"{name}, 2 sigma")
        for in_motion, line in ((False, "-"), (True, "--")):
            share = 100.0 * inside[name, in_motion].mean(axis=0)
            right.plot(
                run.times_s, share, line, color=colour, label=f"{name}, {'in motion' if in_motion else 'at rest'}"
            )
    left.axhline(0.0, color="black", linewidth=0.8)
    left.set(title="error of one arm at rest", xlabel="time [s]", ylabel="z [um]")
    right.axhline(95.0, color="black", linewidth=0.8)
    right.set(title="inside the 95 % region", xlabel="time [s]", ylabel="share of the runs [%]", ylim=(0.0, 100.0))
    for panel in (left, right):
        panel.legend(fontsize=7)
    figure.savefig(path)


def main(arguments: Sequence[str] | None = None) -> Mapping[tuple[str, bool], float]:
    """Print and return the share of the positions inside their regions, by filter and motion."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--arms", type=int, default=60, help="number of drawn arms")
    parser.add_argument("--figure", metavar="FILE", help="picture to draw")
    options = parser.parse_args(arguments)
    runs = list(filter_runs(load_checked_arm(ARM), options.arms, POSES, SCANS))
    inside = find_inside(runs)
    shares = {key: float(np.mean(rows[:, SETTLED:])) for key, rows in inside.items()}
    print(f"Positions inside their 95 % region, {options.arms} simulated arms, {SETTLED / RATE:g} s after the start:")
    for name in (CONSIDER, WHITE):
        print(f"  {name:34} at rest {100.0 * shares[name, False]:.1f} %, in motion {100.0 * shares[name, True]:.1f} %")
    if options.figure:
        draw(runs[0], inside, options.figure)
    return shares


if __name__ == "__main__":
    main()
