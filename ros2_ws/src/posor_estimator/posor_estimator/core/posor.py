"""A POSOR: a stack of sensors between two plates, and the estimator that inverts their model scan by scan."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space
from scipy.stats import chi2

from posor_estimator.core.calibration.model import Calibration, TiltAngle
from posor_estimator.core.estimate import Estimate
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.kernels import solve
from posor_estimator.core.kernels.solve import GAP
from posor_estimator.core.native import native_from_rotation, rotation_from_native
from posor_estimator.core.start import start_pose
from posor_estimator.errors import ScanError

if TYPE_CHECKING:
    from posor_estimator.core.scan import Scan
    from posor_estimator.core.types import FloatArray

LENGTH = 0.05
"""Lever [m] that makes a rotation comparable to a translation in the estimator's step and conditioning."""
TOLERANCE = 1e-9
"""A last step below this [m] leaves an error of its square over LENGTH, far below a picometre."""
ITERATIONS = 25
TILT_SETTLED = 1e-14
"""The previous-scan tilt is settled when theta moves by less than this [rad]."""


class Posor:
    """Turns scans into poses, one after the other.

    Each solution starts from the last one; the first starts from a closed form. ``locate`` never raises for a bad scan:
    it returns a LOST estimate that says why.
    """

    def __init__(self, calibration: Calibration, *, false_alarm: float = 1e-3) -> None:
        """Build the sensors of a calibration.

        Args:
            calibration: The POSOR's calibration, with its session already applied.
            false_alarm: Probability that the chi-square test of the redundant readings rejects a sound scan.

        """
        self.calibration = calibration
        self.sensors = [sensor.build() for sensor in calibration.sensors]
        self._kinds = np.concatenate([sensor.kinds for sensor in self.sensors])
        self._parameter_sigmas = np.concatenate([sensor.parameter_sigmas for sensor in self.sensors])
        redundancy = len(self._kinds) - 6
        self._residual_limit = float(chi2.isf(false_alarm, redundancy)) if redundancy > 0 else math.inf
        self._previous: pin.SE3 | None = None

    @property
    def reading_names(self) -> tuple[str, ...]:
        """Name of each linearised reading."""
        return tuple(name for sensor in self.sensors for name in sensor.reading_names)

    def reset(self) -> None:
        """Forget the last pose; the next scan starts from the closed form."""
        self._previous = None

    def locate(self, scan: Scan) -> Estimate:
        """Return the pose that this scan gives, starting from the pose of the scan before."""
        try:
            linearised = [sensor.linearise(scan) for sensor in self.sensors]
            rows = np.concatenate([sensor.rows(scan) for sensor in self.sensors])
        except ScanError as error:
            return Estimate.lost(scan.number, error.fault, str(error))
        values = np.concatenate([part.values for part in linearised])
        variances = np.concatenate([part.variances for part in linearised])
        start = self._previous or start_pose(self._kinds, rows, values) or pin.SE3.Identity()
        outcome, pose, jacobian, residuals = self._solve(rows, values, variances, start)
        if outcome != solve.CONVERGED:
            return self._failed(scan, outcome)
        estimate = self._judge(scan, pose, jacobian, residuals, variances)
        if estimate.T_R_T is not None:
            self._previous = pose
        return estimate

    def _failed(self, scan: Scan, outcome: int) -> Estimate:
        """Return the LOST estimate of a scan that the iteration could not solve; the next one starts afresh."""
        self.reset()
        if outcome == solve.ILL_CONDITIONED:
            reason = f"scan {scan.number}: the readings do not determine all six freedoms."
            return Estimate.lost(scan.number, Fault.ILL_CONDITIONED, reason)
        reason = f"scan {scan.number}: the estimate did not settle within {ITERATIONS} steps."
        return Estimate.lost(scan.number, Fault.NOT_CONVERGED, reason)

    def _solve(
        self, rows: FloatArray, values: FloatArray, variances: FloatArray, start: pin.SE3
    ) -> tuple[int, pin.SE3, FloatArray, FloatArray]:
        """Run the iteration; return its outcome, the pose, the rows' derivatives (m, 6) and residuals (m,) [m]."""
        rotation, translation = start.rotation.copy(), start.translation.copy()
        jacobian, residuals = np.empty((len(values), 6)), np.empty(len(values))
        weights = 1.0 / variances
        lagging = self.calibration.tilt_angle is TiltAngle.PREVIOUS_SCAN and self._previous is not None
        turn = 0.0
        for _ in range(ITERATIONS):
            outcome = solve.gauss_newton(
                self._kinds,
                _turned(self._kinds, rows, turn) if lagging else rows,
                values,
                weights,
                rotation,
                translation,
                jacobian,
                residuals,
                LENGTH,
                TOLERANCE,
                ITERATIONS,
            )
            pose = pin.SE3(rotation, translation)
            if not lagging or outcome != solve.CONVERGED:
                return outcome, pose, jacobian, residuals
            moved = native_from_rotation(start.rotation)[2] - native_from_rotation(rotation)[2] - turn
            turn += moved
            if abs(moved) < TILT_SETTLED:
                return outcome, pose, jacobian, residuals
        return solve.NOT_CONVERGED, pose, jacobian, residuals

    def _judge(
        self, scan: Scan, pose: pin.SE3, jacobian: FloatArray, residuals: FloatArray, variances: FloatArray
    ) -> Estimate:
        """Return the estimate with both parts of its covariance, its residual and its state."""
        whiten = 1.0 / np.sqrt(variances)
        white = jacobian * whiten[:, None]
        local = np.linalg.inv(white.T @ white)
        gain = local @ (white.T * whiten)
        to_parent = np.kron(np.eye(2), pose.rotation)
        by_parameter = np.zeros((len(residuals), self._parameter_sigmas.size))
        row = column = 0
        for sensor in self.sensors:
            block = sensor.residual_jacobian(scan, pose.rotation, pose.translation)
            by_parameter[row : row + block.shape[0], column : column + block.shape[1]] = block
            row += block.shape[0]
            column += block.shape[1]
        by_parameter *= self._parameter_sigmas
        moved = to_parent @ gain @ by_parameter
        redundant = null_space(white.T)
        seen = redundant.T @ (residuals * whiten)
        spread = redundant.T @ (by_parameter * whiten[:, None])
        residual = float(seen @ np.linalg.solve(np.eye(len(seen)) + spread @ spread.T, seen))
        passes = residual <= self._residual_limit
        return Estimate(
            scan=scan.number,
            state=State.OK if passes else State.LOST,
            faults=Fault.NONE if passes else Fault.RESIDUAL,
            reason=""
            if passes
            else f"scan {scan.number}: the redundant readings contradict one another, chi-square {residual:.3g}; "
            f"expected at most {self._residual_limit:.3g}.",
            T_R_T=pose if passes else None,
            covariance_random=to_parent @ local @ to_parent.T,
            covariance_systematic=moved @ moved.T,
            residual=residual,
            redundancy=len(seen),
        )


def _turned(kinds: FloatArray, rows: FloatArray, angle: float) -> FloatArray:
    """Return the rows with the directions fixed in the target turned about its Z by ``angle`` [rad]."""
    turn = rotation_from_native(0.0, 0.0, angle)
    turned = rows.copy()
    turned[kinds == GAP, 9:12] = rows[kinds == GAP, 9:12] @ turn.T
    turned[kinds != GAP, 12:15] = rows[kinds != GAP, 12:15] @ turn.T
    return turned
