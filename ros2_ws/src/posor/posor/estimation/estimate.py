"""What scans say of the pose: transform, covariance, chi-square, state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor.model.fault import Fault, State
from posor.model.native_coordinates import native_from_rotation

if TYPE_CHECKING:
    import pinocchio as pin
    from numpy.typing import NDArray

    from posor.numerics.array_types import FloatArray, IntArray

ESTIMATE = np.dtype(
    [
        ("number", "u8"),  # of the scan
        ("stamp_ns", "i8"),
        ("state", "i8"),  # State
        ("faults", "i8"),  # Fault
        ("sensor", "i8"),  # whose readings are invalid; -1: none
        ("code", "i8"),  # of that sensor, see model.readings
        ("residual", "f8"),
        ("redundancy", "i8"),
        ("rotation", "f8", (3, 3)),
        ("translation", "f8", (3,)),
        ("pose", "f8", (7,)),
        ("native", "f8", (6,)),
        ("random", "f8", (6, 6)),
        ("systematic", "f8", (6, 6)),
    ],
    align=True,
)
"""The estimate of one scan as the kernels write it; fields as in ``Estimate`` and ``Estimates``."""


FIELDS = ESTIMATE.names or ()
_STATES = tuple(State)


class Estimate(NamedTuple):
    """The pose ``T_R_T`` that one scan gives.

    Attributes:
        scan: Number of the scan.
        state: Whether the pose can be used.
        faults: Why the state is not OK.
        reason: One sentence on the fault, empty when there is none.
        T_R_T: The pose; None when the state is LOST.
        theta: The large rotation, turns counted [rad]; NaN when the state is LOST.
        covariance_random: From the noise of the readings, (6, 6): x, y, z [m], about X, Y, Z [rad], axes of R, the
            small turn applied on the parent's side at the origin of T (ROS order, REP-103). JCGM 100, 5.1.
        covariance_systematic: From the uncertainties of the calibration parameters, the same order; common to all
            scans of one calibration. JCGM 100, 5.2.
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
        """(x, y, gap [m], alpha, beta, theta [rad]), see ``model.native_coordinates``; NaN when the state is LOST."""
        if self.T_R_T is None:
            return np.full(6, np.nan)
        alpha, beta, _ = native_from_rotation(self.T_R_T.rotation)
        return np.array([*self.T_R_T.translation, alpha, beta, self.theta])


@dataclass(frozen=True)
class Estimates:
    """The poses of n scans: the attributes of ``Estimate`` with a leading axis; NaN in those that are LOST.

    Attributes:
        records: The estimates as the kernels write them, shape (n,), dtype ESTIMATE; the properties are views of it.

    """

    records: NDArray[np.void]

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.records)

    @property
    def scans(self) -> NDArray[np.uint64]:
        """Number of each scan, shape (n,)."""
        return self.records["number"]

    @property
    def stamps_ns(self) -> IntArray:
        """Middle of each exposure [ns], shape (n,)."""
        return self.records["stamp_ns"]

    @property
    def states(self) -> IntArray:
        """``State`` of each scan, shape (n,)."""
        return self.records["state"]

    @property
    def faults(self) -> IntArray:
        """``Fault`` of each scan, shape (n,)."""
        return self.records["faults"]

    @property
    def rotations(self) -> FloatArray:
        """R_R_T, shape (n, 3, 3)."""
        return self.records["rotation"]

    @property
    def translations(self) -> FloatArray:
        """Origin of T in R [m], shape (n, 3)."""
        return self.records["translation"]

    @property
    def poses(self) -> FloatArray:
        """``T_R_T`` as x, y, z [m] and the unit quaternion x, y, z, w, shape (n, 7)."""
        return self.records["pose"]

    @property
    def natives(self) -> FloatArray:
        """The six native coordinates, shape (n, 6)."""
        return self.records["native"]

    @property
    def thetas(self) -> FloatArray:
        """The large rotation, turns counted [rad], shape (n,)."""
        return self.records["native"][:, 5]

    @property
    def residuals(self) -> FloatArray:
        """Chi-square of the redundant readings, shape (n,)."""
        return self.records["residual"]

    @property
    def redundancies(self) -> IntArray:
        """Degrees of freedom of each chi-square, zero of a LOST scan, shape (n,)."""
        return self.records["redundancy"]

    @property
    def covariances_random(self) -> FloatArray:
        """Random covariances, shape (n, 6, 6)."""
        return self.records["random"]

    @property
    def covariances_systematic(self) -> FloatArray:
        """Systematic covariances, shape (n, 6, 6)."""
        return self.records["systematic"]

    def at(self, index: int, reason: str) -> Estimate:
        """Return a copy of one scan's estimate, given the sentence on its fault."""
        import pinocchio as pin  # noqa: PLC0415  50 MB that a node does not need before its first scan

        fields = dict(zip(FIELDS, self.records.item(index), strict=True))
        state, faults = _STATES[fields["state"]], Fault(fields["faults"]) if fields["faults"] else Fault.NONE
        if state is State.LOST:
            return Estimate.lost(fields["number"], faults, reason)
        return Estimate(
            fields["number"],
            state,
            faults,
            reason,
            pin.SE3(fields["rotation"], fields["translation"]),
            float(fields["native"][5]),
            fields["random"].copy(),
            fields["systematic"].copy(),
            fields["residual"],
            fields["redundancy"],
        )
