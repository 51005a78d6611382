"""What scans say of the pose: transform, covariance, residual, state."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.fault import Fault, State
from posor_estimator.core.kernels.locate import FIGURES, NATIVE, POSE, RESIDUAL
from posor_estimator.core.kernels.readout import CODES, FAULTS, STATE
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
        outcomes: State, faults, and what was wrong with each sensor's readings, zero where nothing, shape (n, 2 + s).
        figures: What else is known of each scan, see ``poses``, ``natives`` and ``residuals``, shape (n, 14).

    """

    scans: NDArray[np.uint64]
    outcomes: IntArray
    rotations: FloatArray
    translations: FloatArray
    covariances_random: FloatArray
    covariances_systematic: FloatArray
    figures: FloatArray
    redundancy: int

    @staticmethod
    def room(scans: NDArray[np.uint64], sensors: int, redundancy: int) -> Estimates:
        """Return room for the estimates of some scans of a POSOR with so many sensors."""
        count = len(scans)
        return Estimates(
            scans=scans,
            outcomes=np.zeros((count, 2 + sensors), dtype=np.int64),
            rotations=np.empty((count, 3, 3)),
            translations=np.empty((count, 3)),
            covariances_random=np.empty((count, 6, 6)),
            covariances_systematic=np.empty((count, 6, 6)),
            figures=np.empty((count, FIGURES)),
            redundancy=redundancy,
        )

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.scans)

    @property
    def states(self) -> IntArray:
        """``State`` of each scan, shape (n,)."""
        return self.outcomes[:, STATE]

    @property
    def faults(self) -> IntArray:
        """``Fault`` of each scan, shape (n,)."""
        return self.outcomes[:, FAULTS]

    @property
    def codes(self) -> IntArray:
        """What was wrong with each sensor's readings (``Sensor.explain``), shape (n, s); after the first, zero."""
        return self.outcomes[:, CODES:]

    @property
    def poses(self) -> FloatArray:
        """``T_R_T`` as x, y, z [m] and the unit quaternion x, y, z, w, shape (n, 7)."""
        return self.figures[:, POSE:NATIVE]

    @property
    def natives(self) -> FloatArray:
        """The six native coordinates, shape (n, 6)."""
        return self.figures[:, NATIVE:RESIDUAL]

    @property
    def thetas(self) -> FloatArray:
        """The large rotation, turns counted [rad], shape (n,)."""
        return self.figures[:, RESIDUAL - 1]

    @property
    def residuals(self) -> FloatArray:
        """Chi-square of the redundant readings, shape (n,)."""
        return self.figures[:, RESIDUAL]

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
        """Return a copy of one scan's estimate, given the sentence on its fault."""
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
            covariance_random=self.covariances_random[index].copy(),
            covariance_systematic=self.covariances_systematic[index].copy(),
            residual=float(self.residuals[index]),
            redundancy=self.redundancy,
        )
