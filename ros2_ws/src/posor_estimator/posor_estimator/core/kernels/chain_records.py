"""Measurements of joints as rows of numbers on their way into the chain: messages that are not taken apart.

Columns say where a row has what: the first of the seven numbers of the pose, theta, the first of the covariance's, all
in floats, and the joint's state, in bytes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import in_place, inlined
from posor_estimator.core.fault import State
from posor_estimator.core.kernels.chain import endpoints

if TYPE_CHECKING:
    from posor_estimator.core.types import ByteArray, FloatArray, IntArray

POSE, THETA, COVARIANCE, STATE = 0, 1, 2, 3
UNUSABLE, NO_ROOM = -1, -2
"""Instead of the worst state of the joints: there is no endpoint; nothing was done, ``seen`` must be made larger."""
DEGRADED = int(State.DEGRADED)


@inlined
def read_record(row: FloatArray, columns: IntArray, pose: FloatArray, covariance: FloatArray) -> float:
    """Write what a row says into ``pose`` (7,) and ``covariance`` (6, 6); return theta."""
    for k in range(7):
        pose[k] = row[columns[POSE] + k]
    there = row[columns[COVARIANCE] : columns[COVARIANCE] + 36]
    for i in range(6):
        for k in range(6):
            covariance[i, k] = there[6 * i + k]
    return float(row[columns[THETA]])


@in_place
def read_records(
    rows: FloatArray, columns: IntArray, j: int, poses: FloatArray, covariances: FloatArray, thetas: FloatArray
) -> None:
    """Read many measurements of one joint as ``chain.endpoints`` wants them.

    Args:
        rows: The measurements, shape (n, w).
        columns: See the module, shape (4,).
        j: Which joint of the chain it is.
        poses: To write, shape (n, joints, 7).
        covariances: To write, shape (n, joints, 6, 6).
        thetas: To write, shape (n, joints).

    """
    for n in range(rows.shape[0]):
        thetas[n, j] = read_record(rows[n], columns, poses[n, j], covariances[n, j])


@in_place
def endpoint_of_records(
    columns: IntArray,
    rows: FloatArray,
    octets: ByteArray,
    sources: IntArray,
    frames: FloatArray,
    beams: FloatArray,
    beam_covariances: FloatArray,
    origins: FloatArray,
    gravity: FloatArray,
    kept: IntArray,
    seen_ns: IntArray,
    seen: FloatArray,
    acceleration: FloatArray,
    centres: FloatArray,
    begin: int,
    stamps_ns: IntArray,
    poses: FloatArray,
    covariances: FloatArray,
    thetas: FloatArray,
    found: FloatArray,
    found_covariances: FloatArray,
    angles: FloatArray,
    faults: IntArray,
) -> int:
    """Find the endpoint of one scan, whose joints' measurements are rows.

    Args:
        columns: Of each joint's row, shape (j, 4).
        rows: Of the joints, shape (j, w).
        octets: The same, byte by byte, shape (j, 8 w).
        sources: See ``chain.endpoints``, as those that follow; for one scan.
        frames: See there.
        beams: See there.
        beam_covariances: See there.
        origins: See there.
        gravity: See there.
        kept: See there.
        seen_ns: See there.
        seen: See there.
        acceleration: See there.
        centres: See there.
        begin: See there.
        stamps_ns: See there.
        poses: Of the joints, written.
        covariances: Of the same, written.
        thetas: Of the joints, written.
        found: See there.
        found_covariances: See there.
        angles: See there.
        faults: See there; zero where a state is the reason.

    Returns:
        The worst state of the joints, UNUSABLE or NO_ROOM.

    """
    worst = 0
    for j in range(rows.shape[0]):
        worst = max(worst, int(octets[j, columns[j, STATE]]))
        faults[0, j] = 0
    if worst > DEGRADED:
        return UNUSABLE
    for j in range(rows.shape[0]):
        thetas[0, j] = read_record(rows[j], columns[j], poses[0, j], covariances[0, j])
    if (
        endpoints(
            sources,
            frames,
            beams,
            beam_covariances,
            origins,
            gravity,
            kept,
            seen_ns,
            seen,
            acceleration,
            centres,
            begin,
            stamps_ns,
            poses,
            covariances,
            thetas,
            found,
            found_covariances,
            angles,
            faults,
        )
        == 0
    ):
        return NO_ROOM
    return UNUSABLE if math.isnan(found[0, 0]) else worst
