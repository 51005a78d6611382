"""The residuals of a bundle fit: every reading of every scan, with the poses eliminated.

Each scan's pose is unknown but for what a reference says of it. For any parameters the pose is found by Gauss-Newton;
what is left of the scan's readings, and its derivative with respect to the parameters, is then taken across the pose's
own directions, in an orthonormal basis: as many numbers as the scan has readings more than its pose takes, each of
standard deviation 1 (variable projection: Golub and Pereyra 1973, in the form of Kaufman 1975). With a reference, the
basis is the one nearest to the readings, so that each number belongs to one reading and a robust loss knows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.linalg import block_diag

from posor_estimator.core.kernels.rows import evaluate_row
from posor_estimator.core.kernels.solve import LENGTH, TOLERANCE
from posor_estimator.core.plain_rows import PlainRows
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.unknowns import Unknowns
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.stack import Stack
    from posor_estimator.core.types import BoolArray, FloatArray, IntArray

POSE = 6
_TURNS = 10
UNKNOWN = 1e-2
"""Standard uncertainty of a reference that says nothing of a pose's direction [m, rad], far from what readings tell."""
_EXACT = 1e-10
"""A reference cannot be more certain than this [m, rad]: an atom's size."""
_LEVER = np.array([1.0, 1.0, 1.0, 1.0 / LENGTH, 1.0 / LENGTH, 1.0 / LENGTH])


class OutOfRangeError(Exception):
    """Scans leave the calibrated range as the parameters move; ``which`` of them, (n,) of truth values."""

    def __init__(self, which: BoolArray) -> None:
        super().__init__()
        self.which = which


@dataclass(frozen=True)
class PoseReference:
    """Poses of the target plate in the receiving plate, as something else measured them.

    Attributes:
        poses: ``T_R_T`` of each scan, but for how the instrument's two frames sit on the plates.
        sigmas: Standard uncertainty of each, local tangent (along [m], about [rad] X, Y, Z of the target), (n, 6).
        mounting_sigmas: How well it is known how the instrument's frames sit on the receiving and on the target plate:
            standard uncertainty (12,); zero: exactly.

    """

    poses: list[pin.SE3]
    sigmas: FloatArray
    mounting_sigmas: FloatArray


class BundleProblem:
    """Residuals and derivatives of a bundle fit.

    Attributes:
        names: The unknowns: the parameters', then those of the mounting.
        units: Their units.
        start: Where they begin, (q,).
        scales: Their standard uncertainty before the fit, (q,).
        prior: Their covariance before the fit, (q, q).
        per_scan: How many residuals each scan has; with a reference, one for each reading.
        idle: How many residuals say nothing: one for each direction of a pose that the reference does not tell.

    """

    def __init__(
        self,
        stack: Stack,
        unknowns: Unknowns,
        scans: Scans,
        counts: FloatArray,
        poses: list[pin.SE3],
        reference: PoseReference | None,
    ) -> None:
        """Set the problem up.

        Args:
            stack: The sensors as calibrated so far.
            unknowns: What may change.
            scans: The scans, all within the calibrated range, (n,).
            counts: Of how many readings each scan is the mean, (n,).
            poses: Where the search for each pose begins, (n,).
            reference: What something else says of the poses; None: nothing.

        """
        self._stack, self._unknowns, self._scans, self._reference = stack, unknowns, scans, reference
        self._poses = [pose.copy() for pose in poses]
        self._readings = [scans[n] for n in range(len(scans))]
        self._roots = np.sqrt(counts[:, None] / stack.linearise(scans)[1].variances)
        mounting = np.zeros(0) if reference is None else reference.mounting_sigmas
        self._mounted = np.flatnonzero(mounting > 0.0)
        self.names = (*unknowns.names, *(_mounting_name(int(i)) for i in self._mounted))
        self.units = (*unknowns.units, *("rad" if i % POSE > 2 else "m" for i in self._mounted))  # noqa: PLR2004
        self.start = np.concatenate([unknowns.start, np.zeros(len(self._mounted))])
        self.scales = np.concatenate([unknowns.sigmas, mounting[self._mounted]])
        self.prior = block_diag(unknowns.covariance, np.diag(np.square(mounting[self._mounted])))
        self.per_scan = stack.readings - (POSE if reference is None else 0)
        if self.per_scan < 1:
            raise FitError(
                f"{stack.readings} readings in each scan leave nothing to fit once they have told the pose",
                where="bundle",
                expected="a reference of the poses, or a POSOR with redundant readings",
            )
        self.idle = 0 if reference is None else int(np.count_nonzero(reference.sigmas >= UNKNOWN))
        # Of the prior of each pose: square root of its information in the scaled tangent, (n, 6, 6).
        self._prior = np.zeros((len(scans), POSE, POSE))
        if reference is not None:
            self._prior[:] = np.eye(POSE) / np.maximum(reference.sigmas, _EXACT)[:, :, None] * _LEVER
        self._last: tuple[bytes, FloatArray, FloatArray] | None = None

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        """Return the residuals (n * per_scan,), the scans one after the other."""
        return self._evaluated(unknowns)[0]

    def jacobian(self, unknowns: FloatArray) -> FloatArray:
        """Return d(residual)/d(unknown), (n * per_scan, q)."""
        return self._evaluated(unknowns)[1]

    def _evaluated(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        key = unknowns.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = (key, *self._evaluate(unknowns))
        return self._last[1:]

    def _evaluate(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        own, mounting = unknowns[: len(self._unknowns)], np.zeros(2 * POSE)
        mounting[self._mounted] = unknowns[len(self._unknowns) :]
        stack = self._stack.with_parameter_values(self._unknowns.values(own))
        codes, batch = stack.linearise(self._scans)
        if codes.any():
            raise OutOfRangeError(np.asarray(codes.any(axis=1)))
        goals = self._goals(mounting)
        for _ in range(_TURNS):
            residuals, across = self._readings_at(stack, batch.values, batch.chosen)
            off = self._off(goals)
            prior = self._prior
            normal = np.einsum("nia,nib->nab", across, across) + np.einsum("nia,nib->nab", prior, prior)
            pull = np.einsum("nia,ni->na", across, residuals) + np.einsum("nia,nib,nb->na", prior, prior, off)
            steps = np.linalg.solve(normal, pull[..., None])[..., 0]
            if np.max(np.abs(steps)) < TOLERANCE:
                break
            self._poses = [pose * pin.exp6(step * _LEVER) for pose, step in zip(self._poses, steps, strict=True)]
        basis = self._unknowns.basis(own)
        by_own = np.array(
            [
                stack.residual_jacobian(scan, pose.rotation, pose.translation) @ basis
                for scan, pose in zip(self._readings, self._poses, strict=True)
            ]
        )
        by_all = np.zeros((*residuals.shape, len(self.names)))
        by_all[:, :, : len(own)] = self._roots[:, :, None] * by_own
        off_by_all = np.zeros((len(residuals), POSE, len(self.names)))
        off_by_all[:, :, len(own) :] = self._off_by_mounting(goals, mounting)
        both = np.concatenate([by_all, residuals[:, :, None]], axis=2)
        off_both = np.einsum("nia,nab->nib", self._prior, np.concatenate([off_by_all, off[:, :, None]], axis=2))
        across_pose = np.linalg.solve(normal, np.swapaxes(across, 1, 2))  # H^-1 A'
        seen = np.eye(residuals.shape[1]) - across @ across_pose
        projected = seen @ both - np.swapaxes(across_pose, 1, 2) @ np.swapaxes(self._prior, 1, 2) @ off_both
        reduced = self._roots_of(seen) @ projected
        flat = reduced.reshape(-1, len(self.names) + 1)
        return flat[:, -1], flat[:, :-1]

    def _roots_of(self, seen: FloatArray) -> FloatArray:
        """Return what makes projected readings a set of independent ones of variance 1, (n, per_scan, m)."""
        shares, directions = np.linalg.eigh(seen)
        shares, directions = shares[:, -self.per_scan :], directions[:, :, -self.per_scan :]
        roots = np.swapaxes(directions, 1, 2) / np.sqrt(shares)[:, :, None]
        return np.asarray(roots if self._reference is None else directions @ roots)

    def _readings_at(self, stack: Stack, values: FloatArray, chosen: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return reading less prediction, and d(prediction)/d(scaled tangent), both over the noise, at all poses."""
        plain, still = PlainRows(stack), np.zeros(POSE)
        residuals, across = values.copy(), np.empty((*values.shape, POSE))
        for n, pose in enumerate(self._poses):
            rotation, translation = pose.rotation.copy(), pose.translation.copy()
            rows = stack.pool.rows[chosen[n]]
            plain.expand(rows, rotation, translation)
            for r, (kind, row) in enumerate(zip(stack.pool.kinds[chosen[n]], rows, strict=True)):
                residuals[n, r] -= evaluate_row(kind, row, rotation, translation, still, across[n, r])
        return residuals * self._roots, across * self._roots[:, :, None] * _LEVER

    def _goals(self, mounting: FloatArray) -> list[pin.SE3]:
        """Return where the reference says that the target is."""
        if self._reference is None:
            return self._poses
        before, after = pin.exp6(mounting[:POSE]), pin.exp6(mounting[POSE:])
        return [before * pose * after for pose in self._reference.poses]

    def _off(self, goals: list[pin.SE3]) -> FloatArray:
        """Return the way from each pose to where the reference says it is, scaled tangent, (n, 6)."""
        if self._reference is None:
            return np.zeros((len(self._poses), POSE))
        return np.array(
            [pin.log6(pose.actInv(goal)).vector / _LEVER for pose, goal in zip(self._poses, goals, strict=True)]
        )

    def _off_by_mounting(self, goals: list[pin.SE3], mounting: FloatArray) -> FloatArray:
        """Return the derivative of ``_off`` with respect to the mounting, (n, 6, mounting unknowns)."""
        if not self._mounted.size:
            return np.zeros((len(self._poses), POSE, 0))
        turned, held = pin.Jexp6(mounting[:POSE]), pin.Jexp6(mounting[POSE:])
        before = pin.exp6(mounting[:POSE])
        out = []
        for pose, goal in zip(self._poses, goals, strict=True):
            shift = pin.Jlog6(pose.actInv(goal))
            of_before = goal.inverse().act(before).toActionMatrix() @ turned
            out.append((shift @ np.hstack([of_before, held]))[:, self._mounted] / _LEVER[:, None])
        return np.array(out)


def _mounting_name(index: int) -> str:
    plate, what = ("receiving", "target")[index // POSE], ("x", "y", "z", "about x", "about y", "about z")[index % POSE]
    return f"mounting of the reference on the {plate} plate, {what}"
