# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Estimates of recorded scans: poses of joints and of the endpoint at many scans, as named arrays."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

from posor.errors import BagError
from posor.estimation.estimate import ESTIMATE, NO_STAMP, OTHER_FRAME, Estimates
from posor.model.fault import USABLE_STATES, Fault, State
from posor.numerics.array_types import FloatArray, IntArray, freeze_arrays
from posor.numerics.stamps import span_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.estimation.posor import Posor
    from posor.messages.raw_scan import RecordedScans
    from posor.numerics.array_types import BoolArray


@dataclass(frozen=True, repr=False, eq=False)
class EndpointEstimates:
    """Poses of the endpoint at n stamps, as read-only arrays.

    Attributes:
        log_times_ns: When the last of the joints' scans was logged, shape (n,).
        stamps_ns: Middle of the exposure, shape (n,).
        poses: x, y, z [m] and unit quaternion x, y, z, w, in the base frame or relative to home, shape (n, 7).
        covariances_random: White from scan to scan, of x, y, z [m] and small turns about X, Y, Z [rad], axes of the
            same frame, shape (n, 6, 6).
        covariances_systematic: The same, from calibrations and beams, common to all scans, shape (n, 6, 6).
        angles: Of each joint about its nominal axis [rad], shape (n, joints).
        stamp_shifts: Largest errors of the endpoint by errors of the stamps within their limits, along and about the
            axes of the same frame, shape (n, 6): a part of the protection level; zero: no limit is stated.
        protection_levels: Bounds of the errors along and about the axes of the same frame, shape (n, 6) [m], [rad];
            infinite: not bounded; NaN: not known.
        degraded: Whether the pose is DEGRADED: by a joint, a thermometer that cannot be used, accelerometers, which are
            not read offline, or a home that was not OK, shape (n,).

    """

    log_times_ns: IntArray
    stamps_ns: IntArray
    poses: FloatArray
    covariances_random: FloatArray
    covariances_systematic: FloatArray
    angles: FloatArray
    stamp_shifts: FloatArray
    protection_levels: FloatArray
    degraded: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.poses)

    def __repr__(self) -> str:
        return f"<{len(self)} EndpointEstimates, {self.angles.shape[1]} angles{span_text(self.stamps_ns)}>"

    def covariances(self) -> FloatArray:
        """Return the sums of the random and the systematic covariances, shape (n, 6, 6)."""
        return self.covariances_random + self.covariances_systematic

    @property
    def standard_uncertainties(self) -> FloatArray:
        """Square roots of the variances of ``covariances()``: x, y, z [m], about X, Y, Z [rad], shape (n, 6)."""
        return np.sqrt(np.diagonal(self.covariances(), axis1=1, axis2=2))

    def select(self, which: BoolArray | IntArray | slice) -> EndpointEstimates:
        """Return some of the poses."""
        return EndpointEstimates(*(getattr(self, field.name)[which] for field in fields(self)))

    @staticmethod
    def concatenate(parts: Sequence[EndpointEstimates]) -> EndpointEstimates:
        """Return the poses of several parts, one after the other; at least one part."""
        names = [field.name for field in fields(EndpointEstimates)]
        return EndpointEstimates(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @staticmethod
    def none() -> EndpointEstimates:
        """Return no estimates, of an arm without a chain."""
        integers, matrices = np.empty(0, dtype=np.int64), np.empty((0, 6, 6))
        vectors = np.empty((0, 6))
        poses, angles, degraded = np.empty((0, 7)), np.empty((0, 0)), np.empty(0, dtype=bool)
        return EndpointEstimates(integers, integers, poses, matrices, matrices, angles, vectors, vectors, degraded)


@dataclass(frozen=True, repr=False)
class ArmEstimates:
    """Poses of all joints of an arm, and of its endpoint.

    Attributes:
        joints: By joint name.
        endpoint: Empty without a kinematic chain.
        chain: Names of the chain's joints, in the order of ``EndpointEstimates.angles``; empty without a chain.
        notes: A sentence, without a full stop, for each thing of the bag that was left out or is not as recorded.
        temperatures: Of the thermometers in use [K], by name, by period of the stamps (``PERIOD_NS``).

    """

    joints: Mapping[str, Estimates]
    endpoint: EndpointEstimates
    chain: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    temperatures: Mapping[int, Mapping[str, float]] = field(default_factory=dict)

    def check_one_run(self, where: str) -> None:
        """Raise BagError: usable poses of a joint repeat or go back in time, as where a recording is twice in a bag.

        ``where``: the bag.
        """
        for name, estimates in self.joints.items():
            stamps_ns = estimates.stamps_ns[np.isin(estimates.states, USABLE_STATES)]
            if (back := np.flatnonzero(np.diff(stamps_ns) <= 0)).size:
                first, second = stamps_ns[back[0] : back[0] + 2].tolist()
                what = f"poses of {name} at {first} ns are followed by those at {second} ns"
                raise BagError(what, where=where, expected="one recording, each scan once")

    def endpoint_of_one_run(self, where: str) -> EndpointEstimates:
        """Return the endpoint. Raises BagError: there is none, or see ``check_one_run``; ``where``: the bag."""
        self.check_one_run(where)
        if not len(self.endpoint):
            what = "; ".join(["no scan has an endpoint", *self.notes])
            raise BagError(what, where=where, expected="sound poses of all joints at equal stamps")
        return self.endpoint

    def __repr__(self) -> str:
        lines = [f"  {name}: {part!r}" for name, part in {**self.joints, "endpoint": self.endpoint}.items()]
        return "\n".join([f"<ArmEstimates of {len(self.joints)} joints:", *lines]) + ">"


def estimate_joint(posor: Posor, recorded: RecordedScans) -> Estimates:
    """Return the transforms of recorded scans; scans of another frame or without a valid stamp are LOST.

    ``posor``: the estimator; it continues from the scan before.
    """
    scans = recorded.scans
    usable, code = scans.stamps_ns != 0, NO_STAMP
    if recorded.frame != posor.calibration.frames.parent:
        usable[:], code = False, OTHER_FRAME
    found = posor.estimate_all(scans if usable.all() else scans.select(usable), fault_effects=True)
    records, effects = found._records, found.fault_effects
    if not usable.all():
        records, effects = lost_records(recorded, code), posor.allocate_effects(len(scans))
        records[usable], effects[usable] = found._records, found.fault_effects
    return Estimates(
        records,
        scans,
        posor.reason,
        log_times_ns=recorded.log_times_ns,
        header_stamps=recorded.header_stamps,
        fault_effects=effects,
    )


def lost_records(recorded: RecordedScans, code: int) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """Return records of scans that are not estimated: LOST, every number of the pose NaN."""
    records = np.zeros(len(recorded), dtype=ESTIMATE)
    for name in (
        *("rotation", "translation", "pose", "native", "random", "systematic"),
        *("shared", "stamp_shift", "residual"),
    ):
        records[name] = np.nan
    records["number"], records["stamp_ns"] = recorded.scans.numbers, recorded.scans.stamps_ns
    records["state"], records["faults"] = int(State.LOST), int(Fault.BAD_READING)
    records["sensor"], records["code"] = -1, code
    return records
