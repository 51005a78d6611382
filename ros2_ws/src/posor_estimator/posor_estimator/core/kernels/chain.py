"""From the joints to the endpoint: one walk along the arm, with the sag of its beams and all covariances.

An arm is laid out by ``core.chain_layout``: k elements on the way, joints and beams, of j joints and b beams.

* ``sources`` (k,): whose transform an element is: joint j as j, beam b as ``-1 - b``.
* ``frames`` (k + 1, 4, 3): the fixed part before each element, and that after the last one: rotation, translation [m].
* ``beams`` (b, 19, 3): see ``SPAN`` and those after it; ``beam_covariances`` (b, 6, 6): of ``MeasuringBeam``.
* ``origins`` (j, 3, 3): rotation of each joint's origin in its parent link.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import in_place, inlined
from posor_estimator.core.kernels.chain_covariance import (
    NOTHING,
    carried,
    with_one_along,
    with_turned,
    write_covariance,
)
from posor_estimator.core.kernels.chain_motion import WINDOW, accelerations, begin_anew, has_room, take
from posor_estimator.core.kernels.chain_pose import fault_of, rotation_of, write_pose
from posor_estimator.core.kernels.matrix import Matrix, applied, matrix, product, row_times, transposed, turned_by
from posor_estimator.core.kernels.vector import Vector, at, minus, plus, times, within

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

SPAN, SHIFT_GAIN, START_GAIN, END_GAIN, SAG_GAIN, SAG_TURN_GAIN = 0, 4, 7, 10, 13, 16
"""Rows of a beam: the beam that does not sag (rotation, translation); then what a specific force [m/s^2] in the axes of
its start does: shift of the end against the start, turn of the start, turn of the end in axes of the end, and one
standard deviation of the sag, translation and turn in axes of the start."""
BEAM_ROWS = 19
UNTURNED: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@inlined
def go_along_beam(beam: FloatArray, force: Vector, rotation: Matrix, translation: Vector) -> tuple[Matrix, Vector]:
    """Go from the plate at a beam's start to that at its end, both moved by the sag under a specific force [m/s^2]."""
    rotation = turned_by(rotation, times(-1.0, applied(matrix(beam, START_GAIN), force)))
    span = plus(within(beam, SPAN + 3), applied(matrix(beam, SHIFT_GAIN), force))
    translation = plus(translation, applied(rotation, span))
    rotation = product(rotation, matrix(beam, SPAN))
    return turned_by(rotation, applied(matrix(beam, END_GAIN), force)), translation


@inlined
def walk(
    sources: IntArray,
    frames: FloatArray,
    beams: FloatArray,
    beam_covariances: FloatArray,
    gravity: FloatArray,
    poses: FloatArray,
    covariances: FloatArray,
    acceleration: FloatArray,
    centres: FloatArray,
    pose: FloatArray,
    covariance: FloatArray,
) -> None:
    """Walk along the arm once.

    Args:
        sources: See the module.
        frames: See the module.
        beams: See the module.
        beam_covariances: See the module.
        gravity: [m/s^2], (3,), axes of the base.
        poses: Of the joints, receiving plate to target plate, (j, 7): x, y, z [m], quaternion x, y, z, w.
        covariances: Of the same, (j, 6, 6), ROS order, axes of the receiving plate.
        acceleration: Of the beams [m/s^2], (3 b,), axes of the base.
        centres: Centres of the beams on the way to write [m], (3 b,), axes of the base.
        pose: Of the endpoint in the base to write, (7,).
        covariance: Of the endpoint to write, (6, 6), ROS order, axes of the base.

    """
    rotation = straight = UNTURNED
    last = translation = (0.0, 0.0, 0.0)
    blocks = NOTHING
    for element in range(sources.shape[0]):
        frame = frames[element]
        fixed = matrix(frame, 0)
        translation = plus(translation, applied(rotation, within(frame, 3)))
        parent = rotation = product(rotation, fixed)
        straight = product(straight, fixed)
        source = sources[element]
        if source >= 0:
            translation = plus(translation, applied(rotation, within(poses, source)))
            turn = rotation_of(poses[source])
            rotation, straight = product(rotation, turn), product(straight, turn)
            blocks = with_turned(carried(blocks, minus(translation, last)), parent, covariances[source])
        else:
            # How a beam lies under gravity is reckoned as if no beam before it sagged: the rest is of second order.
            b = -1 - source
            beam = beams[b]
            centre = plus(translation, times(0.5, applied(rotation, within(beam, SPAN + 3))))
            centres[3 * b], centres[3 * b + 1], centres[3 * b + 2] = centre
            f = row_times(minus(at(gravity, 0), at(acceleration, 3 * b)), straight)
            rotation, translation = go_along_beam(beam, f, rotation, translation)
            straight = product(straight, matrix(beam, SPAN))
            blocks = with_turned(carried(blocks, minus(translation, last)), parent, beam_covariances[b])
            shift = applied(parent, applied(matrix(beam, SAG_GAIN), f))
            blocks = with_one_along(blocks, shift, applied(parent, applied(matrix(beam, SAG_TURN_GAIN), f)))
        last = translation
    frame = frames[sources.shape[0]]
    translation = plus(translation, applied(rotation, within(frame, 3)))
    write_covariance(carried(blocks, minus(translation, last)), covariance)
    write_pose(product(rotation, matrix(frame, 0)), translation, pose)


@inlined
def joint_angle(poses: FloatArray, origins: FloatArray, j: int, theta: float) -> float:
    """Return how far a joint is turned about its nominal axis [rad]: the heading of its target's Y axis about that.

    Turns are those that have been counted in theta, the same heading about Z of the receiving plate.

    Args:
        poses: Of the target plates in the receiving plates, (j, 7).
        origins: Rotations of the joints' origins in the receiving plates, (j, 3, 3).
        j: Which joint.
        theta: Counted [rad]; NaN: not counted, the angle is in (-pi, pi].

    """
    turn = rotation_of(poses[j])
    heading = turn[0][1], turn[1][1], turn[2][1]
    x, y, _ = row_times(heading, matrix(origins[j], 0))
    if math.isnan(theta):
        return math.atan2(-x, y)
    return theta + math.atan2(y * heading[0] - x * heading[1], y * heading[1] + x * heading[0])


@in_place
def endpoints(
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
    """Write the endpoints of scans from ``begin`` on; all arrays of scans have n rows, see ``walk`` for the rest.

    A scan with a joint whose numbers are none gets NaN, its faults say which joint, and the motion does without it.

    Args:
        sources: See the module.
        frames: See the module.
        beams: See the module.
        beam_covariances: See the module.
        origins: See the module.
        gravity: See ``walk``.
        kept: See ``chain_motion``; a window of zero: accelerations are left as they are given.
        seen_ns: See ``chain_motion``.
        seen: See ``chain_motion``.
        acceleration: See ``walk``.
        centres: See ``walk``; room.
        begin: The scan to begin with.
        stamps_ns: Of the scans, (n,).
        poses: (n, j, 7).
        covariances: (n, j, 6, 6).
        thetas: Of the joints [rad], (n, j), see ``joint_angle``.
        found: Poses of the endpoint to write, (n, 7).
        found_covariances: Their covariances to write, (n, 6, 6).
        angles: Angles of the joints to write [rad], (n, j).
        faults: Of the joints to write, (n, j).

    Returns:
        n when done; the number of the scan for which ``seen`` must be made larger.

    """
    moving = kept[WINDOW] > 0
    count: int = stamps_ns.shape[0]
    for n in range(begin, count):
        sound = True
        for j in range(faults.shape[1]):
            faults[n, j] = fault_of(poses[n, j], covariances[n, j])
            sound = sound and faults[n, j] == 0
        if not sound:
            write_none(found[n], found_covariances[n], angles[n])
            continue
        if moving:
            if not has_room(kept, seen_ns, seen):
                return n
            begin_anew(stamps_ns[n], kept, seen_ns)
            accelerations(kept, seen_ns, seen, acceleration)
        walk(
            sources,
            frames,
            beams,
            beam_covariances,
            gravity,
            poses[n],
            covariances[n],
            acceleration,
            centres,
            found[n],
            found_covariances[n],
        )
        if moving:
            take(stamps_ns[n], centres, kept, seen_ns, seen)
        for j in range(faults.shape[1]):
            angles[n, j] = joint_angle(poses[n], origins, j, thetas[n, j])
    return count


@in_place
def write_none(pose: FloatArray, covariance: FloatArray, angles: FloatArray) -> None:
    """Make every number of a scan NaN: there is no endpoint."""
    for i in range(7):
        pose[i] = math.nan
    for i in range(6):
        for j in range(6):
            covariance[i, j] = math.nan
    for i in range(angles.shape[0]):
        angles[i] = math.nan


@in_place
def relative_to(
    home: FloatArray, poses: FloatArray, covariances: FloatArray, found: FloatArray, found_covariances: FloatArray
) -> None:
    """Write poses (n, 7) and their covariances (n, 6, 6) in the axes of another, home (7,), which counts as exact."""
    back = transposed(rotation_of(home))
    for n in range(poses.shape[0]):
        place = applied(back, minus(within(poses, n), at(home, 0)))
        write_pose(product(back, rotation_of(poses[n])), place, found[n])
        write_covariance(with_turned(NOTHING, back, covariances[n]), found_covariances[n])
