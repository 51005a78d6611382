"""What one scan says of the pose: transform, covariance, residual, state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.fault import Fault, State
from posor_estimator.core.native import native_from_rotation

if TYPE_CHECKING:
    import pinocchio as pin

    from posor_estimator.core.types import FloatArray


@dataclass(frozen=True)
class Estimate:
    """The pose ``T_R_T`` that one scan gives.

    Attributes:
        scan: Number of the scan.
        state: Whether the pose may be used.
        faults: Why not, or why only with care.
        reason: One sentence on the first fault, empty when there is none.
        T_R_T: The pose; None when the state is LOST.
        covariance_random: From the readings' noise, (6, 6): x, y, z [m], about X, Y, Z [rad], axes of R, the small turn
            applied on the parent's side at the origin of T (ROS order, REP-103). JCGM 100, 5.1.
        covariance_systematic: From the calibration parameters' uncertainties, the same order; common to all scans of
            one calibration.
        residual: Chi-square of the redundant readings, weighted by their random and systematic variances.
        redundancy: Degrees of freedom of the residual.

    """

    scan: int
    state: State
    faults: Fault
    reason: str
    T_R_T: pin.SE3 | None
    covariance_random: FloatArray
    covariance_systematic: FloatArray
    residual: float
    redundancy: int

    @staticmethod
    def lost(scan: int, faults: Fault, reason: str) -> Estimate:
        """Return the estimate of a scan that gives no pose."""
        unknown = np.full((6, 6), np.nan)
        return Estimate(scan, State.LOST, faults, reason, None, unknown, unknown, float("nan"), 0)

    @property
    def native(self) -> FloatArray:
        """(x, y, gap [m], alpha, beta, theta [rad]), see ``core.native``; NaN when the state is LOST."""
        if self.T_R_T is None:
            return np.full(6, np.nan)
        return np.concatenate([self.T_R_T.translation, native_from_rotation(self.T_R_T.rotation)])
