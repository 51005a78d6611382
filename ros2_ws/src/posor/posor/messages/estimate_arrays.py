"""Poses of joints and of the endpoint at many scans, as named arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray  # noqa: TC002  read by dataclasses

from posor.model.fault import Fault, State
from posor.numerics.array_types import FloatArray, IntArray  # noqa: TC001  read by dataclasses

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.estimation.estimate import Estimates
    from posor.estimation.posor import Posor
    from posor.messages.raw_scan import RecordedScans
    from posor.node_parameters import CovarianceKind
    from posor.numerics.array_types import BoolArray


class _Rows:
    """Base of dataclasses whose fields are arrays with one row for each scan."""

    covariances: FloatArray

    @property
    def standard_uncertainties(self) -> FloatArray:
        """Square roots of the variances: x, y, z [m], about X, Y, Z [rad], shape (n, 6)."""
        roots: FloatArray = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2))
        return roots

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(getattr(self, fields(self)[0].name))  # type: ignore[arg-type]

    def select(self, which: BoolArray | IntArray | slice) -> Self:
        """Return some of the rows."""
        return type(self)(*(getattr(self, field.name)[which] for field in fields(self)))  # type: ignore[arg-type]

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """Return the rows of several parts, one after the other; there must be at least one part."""
        parts = [part for part in parts if len(part)] or list(parts[:1])
        if len(parts) == 1:
            return parts[0]
        names = [field.name for field in fields(cls)]  # type: ignore[arg-type]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True)
class JointEstimates(_Rows):
    """Transforms of one joint, receiving plate to target plate, one for each of n scans.

    A scan whose state is LOST has NaN for every number of its pose, native coordinates, covariance and residual.

    Attributes:
        log_times_ns: When the scans were logged, shape (n,).
        order: Positions of the scans among those of all joints that were read together, shape (n,).
        header_stamps: Seconds and nanoseconds of the scans as recorded, shape (n, 2).
        stamps_ns: Middle of the exposure, shape (n,); 0: invalid.
        scans: Scan numbers, shape (n,).
        scan_statuses: ``posor_msgs/RawScan.status``, shape (n,).
        states: ``State``, shape (n,).
        faults: ``Fault`` flags, shape (n,).
        poses: x, y, z [m] and unit quaternion x, y, z, w, shape (n, 7).
        natives: x, y, gap [m], alpha, beta, theta [rad], see ``model.native_coordinates``, shape (n, 6).
        covariances: Of x, y, z [m] and small turns about X, Y, Z [rad], axes of the receiving plate (ROS order,
            REP-103), shape (n, 6, 6).
        residuals: Chi-square of the redundant readings, shape (n,).
        redundancies: Degrees of freedom of the residuals; 0 for a LOST scan, shape (n,).

    """

    log_times_ns: IntArray
    order: IntArray
    header_stamps: IntArray
    stamps_ns: IntArray
    scans: NDArray[np.uint64]
    scan_statuses: NDArray[np.uint32]
    states: NDArray[np.uint8]
    faults: NDArray[np.uint32]
    poses: FloatArray
    natives: FloatArray
    covariances: FloatArray
    residuals: FloatArray
    redundancies: NDArray[np.uint8]

    @staticmethod
    def lost(recorded: RecordedScans) -> JointEstimates:
        """Return estimates of scans that cannot be used: all LOST with bad readings."""
        count = len(recorded)
        return JointEstimates(
            log_times_ns=recorded.log_times_ns,
            order=recorded.order,
            header_stamps=recorded.header_stamps,
            stamps_ns=recorded.scans.stamps_ns,
            scans=recorded.scans.numbers,
            scan_statuses=recorded.statuses.astype(np.uint32),
            states=np.full(count, int(State.LOST), dtype=np.uint8),
            faults=np.full(count, int(Fault.BAD_READING), dtype=np.uint32),
            poses=np.full((count, 7), np.nan),
            natives=np.full((count, 6), np.nan),
            covariances=np.full((count, 6, 6), np.nan),
            residuals=np.full(count, np.nan),
            redundancies=np.zeros(count, dtype=np.uint8),
        )

    @staticmethod
    def none() -> JointEstimates:
        """Return no estimates."""
        integers, floats = np.empty(0, dtype=np.int64), np.empty(0)
        return JointEstimates(
            log_times_ns=integers,
            order=integers,
            header_stamps=np.empty((0, 2), dtype=np.int64),
            stamps_ns=integers,
            scans=integers.astype(np.uint64),
            scan_statuses=integers.astype(np.uint32),
            states=integers.astype(np.uint8),
            faults=integers.astype(np.uint32),
            poses=np.empty((0, 7)),
            natives=np.empty((0, 6)),
            covariances=np.empty((0, 6, 6)),
            residuals=floats,
            redundancies=integers.astype(np.uint8),
        )


@dataclass(frozen=True)
class EndpointEstimates(_Rows):
    """Poses of the endpoint at n stamps.

    Attributes:
        log_times_ns: When the last of the joints' scans was logged, shape (n,).
        stamps_ns: Middle of the exposure, shape (n,).
        poses: x, y, z [m] and unit quaternion x, y, z, w, in the base frame or relative to home, shape (n, 7).
        covariances: Of x, y, z [m] and small turns about X, Y, Z [rad], axes of the same frame, shape (n, 6, 6).
        angles: Of each joint about its nominal axis [rad], shape (n, joints).

    """

    log_times_ns: IntArray
    stamps_ns: IntArray
    poses: FloatArray
    covariances: FloatArray
    angles: FloatArray

    @staticmethod
    def none() -> EndpointEstimates:
        """Return no estimates, of an arm without a chain."""
        integers = np.empty(0, dtype=np.int64)
        return EndpointEstimates(integers, integers, np.empty((0, 7)), np.empty((0, 6, 6)), np.empty((0, 0)))


@dataclass(frozen=True)
class ArmEstimates:
    """Poses of all joints of an arm, and of its endpoint.

    Attributes:
        joints: By joint name.
        endpoint: Empty without a kinematic chain.
        chain: Names of the chain's joints, in the order of ``EndpointEstimates.angles``; empty without a chain.

    """

    joints: Mapping[str, JointEstimates]
    endpoint: EndpointEstimates
    chain: tuple[str, ...] = ()


def estimate_joint(posor: Posor, recorded: RecordedScans, kind: CovarianceKind) -> JointEstimates:
    """Return the transforms of recorded scans; scans of another frame or without a valid stamp are LOST.

    Args:
        posor: The estimator; it continues from the scan before.
        recorded: The scans.
        kind: Part of the uncertainty in the covariances.

    """
    usable = recorded.scans.stamps_ns != 0
    if recorded.frame != posor.calibration.frames.parent:
        usable[:] = False
    if usable.all():
        return _joint_estimates(recorded, posor.estimate_all(recorded.scans), kind)
    result = JointEstimates.lost(recorded)
    if usable.any():
        part = recorded.select(usable)
        found = _joint_estimates(part, posor.estimate_all(part.scans), kind)
        for field in fields(JointEstimates):
            getattr(result, field.name)[usable] = getattr(found, field.name)
    return result


def _joint_estimates(recorded: RecordedScans, estimates: Estimates, kind: CovarianceKind) -> JointEstimates:
    lost = estimates.states == int(State.LOST)
    parts = {"random": estimates.covariances_random, "systematic": estimates.covariances_systematic}
    return JointEstimates(
        log_times_ns=recorded.log_times_ns,
        order=recorded.order,
        header_stamps=recorded.header_stamps,
        stamps_ns=recorded.scans.stamps_ns,
        scans=recorded.scans.numbers,
        scan_statuses=recorded.statuses.astype(np.uint32),
        states=estimates.states.astype(np.uint8),
        faults=estimates.faults.astype(np.uint32),
        poses=estimates.poses,
        natives=estimates.natives,
        covariances=parts["random"] + parts["systematic"] if kind == "total" else parts[kind],
        residuals=np.where(lost, np.nan, estimates.residuals),
        redundancies=estimates.redundancies.astype(np.uint8),
    )
