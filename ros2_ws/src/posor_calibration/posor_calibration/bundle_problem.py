# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Residuals of a bundle fit: every reading of every scan, with the poses eliminated.

The pose of each scan is unknown, or known by a reference with its uncertainty. Gauss-Newton finds the pose for given
parameters. The remaining readings of the scan, and their derivatives with respect to the parameters, are projected
onto the complement of the pose's directions: as many numbers as the scan has readings beyond those of its pose, each of
standard deviation 1 (variable projection: Golub and Pereyra 1973, in the form of Kaufman 1975). With a reference, the
basis nearest to the readings is used, so that each number belongs to one reading and a robust loss can act on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from posor.calibration.parameter_covariance import covariance_square_root
from posor.errors import FitError
from posor.estimation.solver import LENGTH, TOLERANCE
from scipy.linalg import block_diag

from posor_calibration.data_checks import POSE_AXES
from posor_calibration.least_squares import Fit, fit_parameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.estimation.sensor_stack import Stack
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

    from posor_calibration.calibration_parameters import FreeParameters

POSE_SIZE = 6
MAX_ITERATIONS = 10
UNKNOWN_SIGMA = 1e-2
"""Standard uncertainty [m, rad] of a direction that a reference does not measure, far above that of the readings."""
LEAST_SIGMA = 1e-10  # least standard uncertainty of a reference [m, rad]: the size of an atom
LEVER = np.array([1.0, 1.0, 1.0, 1.0 / LENGTH, 1.0 / LENGTH, 1.0 / LENGTH])  # scales the tangent to lengths


class OutOfRangeError(Exception):
    """Scans leave the calibrated range as the parameters change; ``which`` scans, (n,)."""

    def __init__(self, which: BoolArray) -> None:
        super().__init__()
        self.which = which


@dataclass(frozen=True)
class PoseReference:
    """Poses of the target plate in the receiving plate by a reference instrument."""

    poses: list[pin.SE3]  # T_R_T of each scan, but for the mounting of the instrument's two frames, (n,)
    sigmas: FloatArray  # local tangent: along [m], about [rad] X, Y, Z of the target, (n, 6)
    mounting_sigmas: FloatArray  # of the instrument's frames on receiving and target plate, (12,); zero: exact


@dataclass(frozen=True)
class BundleData:
    """Scans and poses of a bundle fit."""

    scans: Scans  # scans, or the mean scan of each dwell, (n,)
    counts: FloatArray  # readings in each mean, (n,)
    poses: list[pin.SE3]  # approximate, (n,)
    reference: PoseReference | None
    left_out: int = 0  # scans that gave no pose, had no reference, or were thinned out
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.counts)

    def select(self, which: IntArray) -> BundleData:
        """Return some of the scans, by index, (k,)."""
        reference = self.reference
        if reference is not None:
            reference = replace(reference, poses=[reference.poses[i] for i in which], sigmas=reference.sigmas[which])
        return replace(
            self,
            scans=self.scans.select(which),
            counts=self.counts[which],
            poses=[self.poses[i] for i in which],
            reference=reference,
            left_out=self.left_out + len(self) - len(which),
        )


class BundleProblem:
    """Residuals and derivatives of a bundle fit.

    Attributes:
        names: The unknowns: free parameters, then those of the reference's mounting, (q,).
        units: (q,).
        start: Initial values, (q,).
        scales: Prior standard uncertainties, (q,).
        prior: Prior covariance, (q, q).
        per_scan: Residuals of each scan; with a reference, one for each reading.
        uninformative: Residuals that are always zero: one for each direction that the reference does not measure.

    """

    def __init__(self, stack: Stack, free: FreeParameters, data: BundleData) -> None:
        """Set up the problem; ``data`` are within the range of the ``stack``, the sensors before the fit.

        Raises FitError: without a reference, the scans have no more readings than their poses take.
        """
        scans, reference = data.scans, data.reference
        self._stack, self._free, self._scans, self._reference = stack, free, scans, reference
        self._poses = [pose.copy() for pose in data.poses]
        self._readings = [scans[n] for n in range(len(scans))]
        self._roots = np.sqrt(data.counts[:, None] / stack.linearise(scans).variances)
        mounting = np.zeros(0) if reference is None else reference.mounting_sigmas
        self._mounted = np.flatnonzero(mounting > 0.0)
        plates = [(("receiving", "target")[i // POSE_SIZE], POSE_AXES[i % POSE_SIZE]) for i in self._mounted.tolist()]
        mounting_names = [f"mounting of the reference on the {plate} plate, {axis}" for plate, axis in plates]
        self.names = (*free.names, *mounting_names)
        self.units = (*free.units, *("rad" if axis.startswith("about") else "m" for _, axis in plates))
        self.start = np.concatenate([free.start, np.zeros(len(plates))])
        self.scales = np.concatenate([free.sigmas, mounting[self._mounted]])
        self.prior = block_diag(free.covariance, np.diag(np.square(mounting[self._mounted])))
        self.per_scan = stack.readings - (POSE_SIZE if reference is None else 0)
        if self.per_scan < 1:
            raise FitError(
                f"the {stack.readings} readings of each scan are all needed for its pose",
                where="bundle",
                expected="a pose reference, or a POSOR with redundant readings",
            )
        self.uninformative = 0 if reference is None else int(np.count_nonzero(reference.sigmas >= UNKNOWN_SIGMA))
        # Square root of the prior information of each pose in the scaled tangent, (n, 6, 6).
        self._pose_prior = np.zeros((len(scans), POSE_SIZE, POSE_SIZE))
        if reference is not None:
            self._pose_prior[:] = np.eye(POSE_SIZE) / np.maximum(reference.sigmas, LEAST_SIGMA)[:, :, None] * LEVER
        self._last: tuple[bytes, FloatArray, FloatArray] | None = None

    def fit(self, names: Sequence[str] = (), **options: Any) -> Fit:
        """Fit the unknowns, by other names if given; options and errors of ``fit_parameters``, and OutOfRangeError."""
        how = {"jacobian": self.jacobian, "prior": self.prior, **options}
        return fit_parameters(self.residuals, self.start, names or self.names, self.units, self.scales, **how)

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        """Return the residuals (n * per_scan,), scan after scan; raises OutOfRangeError."""
        return self._evaluate_once(unknowns)[0]

    def jacobian(self, unknowns: FloatArray) -> FloatArray:
        """Return d(residual)/d(unknown), (n * per_scan, q); raises OutOfRangeError."""
        return self._evaluate_once(unknowns)[1]

    def _evaluate_once(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        key = unknowns.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = (key, *self._evaluate(unknowns))
        return self._last[1:]

    def _evaluate(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        own, mounting = unknowns[: len(self._free)], np.zeros(2 * POSE_SIZE)
        mounting[self._mounted] = unknowns[len(self._free) :]
        stack = self._stack.with_parameter_values(self._free.parameter_vector(own))
        readings = stack.linearise(self._scans)
        if not readings.valid.all():
            raise OutOfRangeError(~readings.valid)
        goals, prior = self._reference_poses(mounting), self._pose_prior
        for _ in range(MAX_ITERATIONS):
            residuals, by_pose = self._linearise_readings(stack, readings.values, readings.selected)
            off = self._reference_offsets(goals)
            normal = np.einsum("nia,nib->nab", by_pose, by_pose) + np.einsum("nia,nib->nab", prior, prior)
            right = np.einsum("nia,ni->na", by_pose, residuals) + np.einsum("nia,nib,nb->na", prior, prior, off)
            steps = np.linalg.solve(normal, right[..., None])[..., 0]
            if np.max(np.abs(steps)) < TOLERANCE:
                break
            self._poses = [pose * pin.exp6(step * LEVER) for pose, step in zip(self._poses, steps, strict=True)]
        basis = self._free.derivatives(own)
        by_own = np.array(
            [
                stack.residual_jacobian(scan, pose.rotation, pose.translation) @ basis
                for scan, pose in zip(self._readings, self._poses, strict=True)
            ]
        )
        by_unknown = np.zeros((*residuals.shape, len(self.names)))
        by_unknown[:, :, : len(own)] = self._roots[:, :, None] * by_own
        off_by_unknown = np.zeros((len(residuals), POSE_SIZE, len(self.names)))
        off_by_unknown[:, :, len(own) :] = self._offset_derivatives(goals, mounting)
        # The residuals are projected together with their derivatives, as one more column.
        both = np.concatenate([by_unknown, residuals[:, :, None]], axis=2)
        off_both = np.einsum("nia,nab->nib", prior, np.concatenate([off_by_unknown, off[:, :, None]], axis=2))
        gain = np.linalg.solve(normal, np.swapaxes(by_pose, 1, 2))
        projector = np.eye(residuals.shape[1]) - by_pose @ gain
        projected = projector @ both - np.swapaxes(gain, 1, 2) @ np.swapaxes(prior, 1, 2) @ off_both
        flat = (self._whiten(projector) @ projected).reshape(-1, len(self.names) + 1)
        return flat[:, -1], flat[:, :-1]

    def _whiten(self, projector: FloatArray) -> FloatArray:
        """Return the matrices that turn projected readings into independent numbers of variance 1, (n, per_scan, m)."""
        shares, directions = np.linalg.eigh(projector)
        shares, directions = shares[:, -self.per_scan :], directions[:, :, -self.per_scan :]
        roots = np.swapaxes(directions, 1, 2) / np.sqrt(shares)[:, :, None]
        return np.asarray(roots if self._reference is None else directions @ roots)

    def _linearise_readings(
        self, stack: Stack, values: FloatArray, active_rows: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return reading less prediction, and d(prediction)/d(scaled tangent), both over the noise, at all poses."""
        residuals, by_pose = values.copy(), np.empty((*values.shape, POSE_SIZE))
        for n, pose in enumerate(self._poses):
            predicted, by_pose[n] = stack.evaluate(active_rows[n], pose.rotation, pose.translation)
            residuals[n] -= predicted
        return residuals * self._roots, by_pose * self._roots[:, :, None] * LEVER

    def _reference_poses(self, mounting: FloatArray) -> list[pin.SE3]:
        """Return the poses by the reference for a mounting (12,), or the estimates themselves without one."""
        if self._reference is None:
            return self._poses
        before, after = pin.exp6(mounting[:POSE_SIZE]), pin.exp6(mounting[POSE_SIZE:])
        return [before * pose * after for pose in self._reference.poses]

    def _reference_offsets(self, goals: list[pin.SE3]) -> FloatArray:
        """Return the offset of each reference pose from the estimate, scaled tangent, (n, 6)."""
        if self._reference is None:
            return np.zeros((len(self._poses), POSE_SIZE))
        return np.array([pin.log6(pose.actInv(g)).vector / LEVER for pose, g in zip(self._poses, goals, strict=True)])

    def _offset_derivatives(self, goals: list[pin.SE3], mounting: FloatArray) -> FloatArray:
        """Return d(reference offset)/d(mounting), (n, 6, mounting unknowns)."""
        if not self._mounted.size:
            return np.zeros((len(self._poses), POSE_SIZE, 0))
        receiving, target = pin.Jexp6(mounting[:POSE_SIZE]), pin.Jexp6(mounting[POSE_SIZE:])
        before = pin.exp6(mounting[:POSE_SIZE])
        out = []
        for pose, goal in zip(self._poses, goals, strict=True):
            by_receiving = goal.inverse().act(before).toActionMatrix() @ receiving
            by_both = pin.Jlog6(pose.actInv(goal)) @ np.hstack([by_receiving, target])
            out.append(by_both[:, self._mounted] / LEVER[:, None])
        return np.array(out)


def add_unfitted_uncertainty(
    fit: Fit, problem: BundleProblem, every: FreeParameters, stack: Stack, data: BundleData
) -> Fit:
    """Return a bundle fit whose covariance includes parameters that are uncertain but were not fitted.

    The fit took them for exact. An error of such a parameter moves the result by the gain of the fit times its effect
    on the residuals (JCGM 102, 6.2; "consider" parameters: Schmidt 1966). They are not fitted along: the new values
    must make the instrument read right together with the unfitted values in the file. ``every`` are all uncertain
    parameters that affect the recording, ``stack`` the sensors before the fit.
    """
    index_of = {name: index for index, name in enumerate(fit.names)}
    if all(name in index_of for name in every.names):
        return fit
    whole = BundleProblem(stack, every, data)
    at = whole.start.copy()
    for index, name in enumerate(whole.names):
        if name in index_of:
            at[index] = fit.values[index_of[name]]
    others = [index for index, name in enumerate(whole.names) if name not in index_of]
    own = [whole.names.index(name) for name in fit.names]
    derivatives = np.sqrt(fit.weights)[:, None] * whole.jacobian(at)
    fitted = derivatives[:, own] * problem.scales
    effects = derivatives[:, others] @ covariance_square_root(whole.prior[np.ix_(others, others)])
    information = np.linalg.inv(problem.prior / np.outer(problem.scales, problem.scales))
    gain = problem.scales[:, None] * np.linalg.solve(fitted.T @ fitted + information, fitted.T @ effects)
    return replace(fit, covariance=fit.covariance + gain @ gain.T)
