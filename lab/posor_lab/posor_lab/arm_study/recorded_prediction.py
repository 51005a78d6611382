# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Endpoint at recorded readings of encoders, with transforms that have arrived, as chain_node predicts it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.chain.encoder_filter import WAITS
from posor.chain.endpoint_predictor import EndpointPredictor
from posor.errors import ShapeError
from posor.numerics.array_types import freeze_arrays

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.kinematic_chain import Chain
    from posor.node_parameters import EncodersParameters
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray


class RecordedTransforms(NamedTuple):
    """Transforms of j joints in n scans."""

    stamps_ns: IntArray  # of the scans, (n,)
    arrivals_ns: IntArray  # stamp of the first reading of the encoders that comes after a scan's transforms, (n,)
    poses: FloatArray  # (n, j, 7), as ``EndpointEstimator.poses``
    covariances_random: FloatArray  # (n, j, 6, 6)
    covariances_systematic: FloatArray  # (n, j, 6, 6)
    shared_effects: FloatArray  # (n, j, T, 6)
    usable: BoolArray  # which transforms arrive and can be used, (n, j)


@dataclass(frozen=True, repr=False, eq=False)
class PredictedEndpoints:
    """Endpoint at n readings of the encoders, and a lead time after each; NaN where there is none. Read-only arrays.

    Attributes:
        stamps_ns: Of the readings, (n,).
        poses: In the base, (n, 7): x, y, z [m] and unit quaternion x, y, z, w.
        covariances: Of x, y, z [m] and small turns about X, Y, Z [rad], axes of the base, (n, 6, 6).
        twists: Velocity [m/s] and angular velocity [rad/s], axes of the endpoint, (n, 6).
        twist_covariances: (n, 6, 6).
        ahead: Poses a lead time later, (n, 7).
        ahead_covariances: (n, 6, 6).
        faults: Of each joint, (n, j): zero, or why there is no endpoint (``chain.encoder_filter``).
        held: Which joints had no transform for longer than the stated gap, (n, j).

    """

    stamps_ns: IntArray
    poses: FloatArray
    covariances: FloatArray
    twists: FloatArray
    twist_covariances: FloatArray
    ahead: FloatArray
    ahead_covariances: FloatArray
    faults: IntArray
    held: BoolArray

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def __len__(self) -> int:
        return len(self.poses)

    def __repr__(self) -> str:
        return f"<{len(self)} PredictedEndpoints, {np.isfinite(self.poses[:, 0]).sum()} with a pose>"

    @property
    def usable(self) -> BoolArray:
        """Which have a pose, (n,)."""
        usable: BoolArray = np.all(self.faults == 0, axis=1)
        return usable

    def select(self, which: BoolArray | IntArray | slice) -> PredictedEndpoints:
        """Return some of them."""
        return PredictedEndpoints(*(getattr(self, field.name)[which] for field in fields(self)))


def predict_recorded(
    chain: Chain,
    parameters: EncodersParameters,
    stamps_ns: IntArray,
    angles: FloatArray,
    transforms: RecordedTransforms,
    *,
    terms: Sequence[tuple[str, ...]] = (),
    acceleration_window: float = 0.0,
) -> PredictedEndpoints:
    """Return the endpoint at the readings of encoders.

    ``stamps_ns``: of the readings, (n,), increasing; ``angles``: [rad], (n, j), NaN: no reading; ``terms``: names of
    the shared terms of each joint; ``acceleration_window``: as in ``Chain.estimator``. Raises ParameterError: a
    parameter does not fit the joints; ShapeError: an array does not.
    """
    predictor, scans = EndpointPredictor(chain, parameters), chain.estimator(acceleration_window)
    joints = len(predictor.joints)
    for name, array, shape in (
        ("stamps_ns", stamps_ns, (len(angles),)),
        ("angles", angles, (len(angles), joints)),
        ("poses", transforms.poses, (len(transforms.stamps_ns), joints, 7)),
    ):
        if array.shape != shape:
            raise ShapeError(name, received=array.shape, expected=f"{shape}")
    scans.use_terms(list(terms) or [()] * joints)
    poses, ahead = np.full((2, len(angles), 7), np.nan)
    twists = np.full((len(angles), 6), np.nan)
    covariances, ahead_covariances, twist_covariances = np.full((3, len(angles), 6, 6), np.nan)
    faults, held = np.zeros((len(angles), joints), dtype=np.int64), np.zeros((len(angles), joints), dtype=bool)
    waiting: list[tuple[int, int]] = []  # scan and joint
    next_scan = 0
    for n, stamp_ns in enumerate(stamps_ns.tolist()):
        while next_scan < len(transforms.stamps_ns) and transforms.arrivals_ns[next_scan] <= stamp_ns:
            usable = transforms.usable[next_scan]
            if usable.all():
                own = scans.workspace[2]
                for name in ("poses", "covariances_random", "covariances_systematic", "shared_effects"):
                    getattr(own, name)[0] = getattr(transforms, name)[next_scan]
                scans.estimate(int(transforms.stamps_ns[next_scan]))
                predictor.use_arm_of(scans)
            waiting += [(next_scan, int(j)) for j in np.flatnonzero(usable)]
            next_scan += 1
        waiting = [each for each in waiting if _use(predictor, transforms, *each) == WAITS]
        if predictor.read(stamp_ns, angles[n]):
            poses[n], covariances[n] = predictor.present.pose, predictor.present.covariance()
            ahead[n], ahead_covariances[n] = predictor.ahead.pose, predictor.ahead.covariance()
            twists[n], twist_covariances[n] = predictor.twist
        faults[n], held[n] = predictor.faults, predictor.held
    found = poses, covariances, twists, twist_covariances, ahead, ahead_covariances, faults, held
    return PredictedEndpoints(np.array(stamps_ns), *found)


def _use(predictor: EndpointPredictor, transforms: RecordedTransforms, scan: int, joint: int) -> int:
    measured = predictor.measurements
    for name in ("poses", "covariances_random", "covariances_systematic", "shared_effects"):
        getattr(measured, name)[0, joint] = getattr(transforms, name)[scan, joint]
    measured.thetas[0, joint] = np.nan
    return predictor.use_transform(joint, int(transforms.stamps_ns[scan]))
