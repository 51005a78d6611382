# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Endpoint at recorded readings of encoders, with transforms that have arrived, as chain_node predicts it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.chain.encoder_filter import WAITS
from posor.chain.endpoint_predictor import EndpointPredictor

if TYPE_CHECKING:
    from posor.chain.kinematic_chain import Chain
    from posor.node_parameters import EncodersParameters
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

MEASURED = ("poses", "covariances_random", "covariances_systematic", "shared_effects")  # of a transform


class RecordedTransforms(NamedTuple):
    """Transforms of j joints in n scans."""

    stamps_ns: IntArray  # of the scans, (n,)
    arrivals_ns: IntArray  # stamp of the first reading of the encoders that comes after a scan's transforms, (n,)
    poses: FloatArray  # (n, j, 7), as ``EndpointEstimator.poses``
    covariances_random: FloatArray  # (n, j, 6, 6)
    covariances_systematic: FloatArray  # (n, j, 6, 6)
    shared_effects: FloatArray  # (n, j, T, 6)
    usable: BoolArray  # which transforms arrive and can be used, (n, j)


class PredictedEndpoints(NamedTuple):
    """Endpoint at n readings of the encoders, and a lead time after each; NaN where there is none."""

    poses: FloatArray  # in the base, (n, 7): x, y, z [m] and unit quaternion x, y, z, w
    covariances: FloatArray  # of x, y, z [m] and small turns about X, Y, Z [rad], axes of the base, (n, 6, 6)
    ahead: FloatArray  # poses a lead time later, (n, 7)
    ahead_covariances: FloatArray  # (n, 6, 6)


def predict_recorded(
    chain: Chain,
    parameters: EncodersParameters,
    stamps_ns: IntArray,
    angles: FloatArray,
    transforms: RecordedTransforms,
    terms: list[tuple[str, ...]],
    acceleration_window: float,
) -> PredictedEndpoints:
    """Return the endpoint at the readings of encoders.

    ``stamps_ns``: of the readings, (n,), increasing; ``angles``: [rad], (n, j), NaN: no reading; ``terms``: names of
    the shared terms of each joint; ``acceleration_window``: as in ``Chain.estimator``. Raises ParameterError: a
    parameter does not fit the joints.
    """
    predictor, scans = EndpointPredictor(chain, parameters), chain.estimator(acceleration_window)
    scans.use_terms(terms)
    poses, ahead = np.full((2, len(angles), 7), np.nan)
    covariances, ahead_covariances = np.full((2, len(angles), 6, 6), np.nan)
    waiting: list[tuple[int, int]] = []  # scan and joint
    next_scan = 0
    for n, stamp_ns in enumerate(stamps_ns.tolist()):
        while next_scan < len(transforms.stamps_ns) and transforms.arrivals_ns[next_scan] <= stamp_ns:
            usable = transforms.usable[next_scan]
            if usable.all():
                own = scans.workspace[2]
                for name in MEASURED:
                    getattr(own, name)[0] = getattr(transforms, name)[next_scan]
                scans.estimate(int(transforms.stamps_ns[next_scan]))
                predictor.use_arm_of(scans)
            waiting += [(next_scan, int(j)) for j in np.flatnonzero(usable)]
            next_scan += 1
        waiting = [each for each in waiting if _use(predictor, transforms, *each) == WAITS]
        if predictor.read(stamp_ns, angles[n]):
            poses[n], covariances[n] = predictor.present.pose, predictor.present.covariance()
            ahead[n], ahead_covariances[n] = predictor.ahead.pose, predictor.ahead.covariance()
    return PredictedEndpoints(poses, covariances, ahead, ahead_covariances)


def _use(predictor: EndpointPredictor, transforms: RecordedTransforms, scan: int, joint: int) -> int:
    measured = predictor.measurements
    for name in MEASURED:
        getattr(measured, name)[0, joint] = getattr(transforms, name)[scan, joint]
    measured.thetas[0, joint] = np.nan
    return predictor.use_transform(joint, int(transforms.stamps_ns[scan]))
