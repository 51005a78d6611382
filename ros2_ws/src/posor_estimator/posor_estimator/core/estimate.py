"""What scans say of the pose: transform, covariance, residual, state."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.fault import Fault, State
from posor_estimator.core.native import native_from_rotation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from posor_estimator.core.types import FloatArray, IntArray


@dataclass(frozen=True)
class Estimate:
    """The pose ``T_R_T`` that one scan gives.

    Attributes:
        scan: Number of the scan.
        state: Whether the pose may be used.
        faults: Why not, or why only with care.
        reason: One sentence on the fault, empty when there is none.
        T_R_T: The pose; None when the state is LOST.
        theta: The large rotation, turns counted [rad]; NaN when the state is LOST.
        covariance_random: From the readings' noise, (6, 6): x, y, z [m], about X, Y, Z [rad], axes of R, the small turn
            applied on the parent's side at the origin of T (ROS order, REP-103). JCGM 100, 5.1.
        covariance_systematic: From the calibration parameters' uncertainties, the same order; common to all scans of
            one calibration. JCGM 100, 5.2.
        residual: Chi-square of the redundant readings, weighted by their random and systematic variances.
        redundancy: Degrees of freedom of the residual.

    """

    scan: int
    state: State
    faults: Fault
    reason: str
    T_R_T: pin.SE3 | None
    theta: float
    covariance_random: FloatArray
    covariance_systematic: FloatArray
    residual: float
    redundancy: int

    @staticmethod
    def lost(scan: int, faults: Fault, reason: str) -> Estimate:
        """Return the estimate of a scan that gives no pose."""
        unknown, nan = np.full((6, 6), np.nan), float("nan")
        return Estimate(scan, State.LOST, faults, reason, None, nan, unknown, unknown, nan, 0)

    @property
    def native(self) -> FloatArray:
        """(x, y, gap [m], alpha, beta, theta [rad]), see ``core.native``; NaN when the state is LOST."""
        if self.T_R_T is None:
            return np.full(6, np.nan)
        alpha, beta, _ = native_from_rotation(self.T_R_T.rotation)
        return np.array([*self.T_R_T.translation, alpha, beta, self.theta])


@dataclass(frozen=True)
class Estimates:
    """The poses of n scans: the attributes of ``Estimate`` with a leading axis; NaN in every LOST one.

    Attributes:
        rotations: R_R_T, shape (n, 3, 3).
        translations: Origin of T in R [m], shape (n, 3).

    """

    scans: NDArray[np.uint64]
    states: IntArray
    faults: IntArray
    rotations: FloatArray
    translations: FloatArray
    thetas: FloatArray
    covariances_random: FloatArray
    covariances_systematic: FloatArray
    residuals: FloatArray
    redundancy: int

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.scans)

    @staticmethod
    def joined(parts: Sequence[Estimates]) -> Estimates:
        """Return estimates end to end; there must be at least one part."""
        arrays = {
            f.name: np.concatenate([getattr(part, f.name) for part in parts])
            for f in fields(Estimates)
            if f.name != "redundancy"
        }
        return Estimates(redundancy=parts[0].redundancy, **arrays)

    def one(self, index: int, reason: str) -> Estimate:
        """Return one scan's estimate, given the sentence on its fault."""
        state, faults, scan = State(int(self.states[index])), Fault(int(self.faults[index])), int(self.scans[index])
        if state is State.LOST:
            return Estimate.lost(scan, faults, reason)
        return Estimate(
            scan=scan,
            state=state,
            faults=faults,
            reason=reason,
            T_R_T=pin.SE3(self.rotations[index], self.translations[index]),
            theta=float(self.thetas[index]),
            covariance_random=self.covariances_random[index],
            covariance_systematic=self.covariances_systematic[index],
            residual=float(self.residuals[index]),
            redundancy=self.redundancy,
        )
