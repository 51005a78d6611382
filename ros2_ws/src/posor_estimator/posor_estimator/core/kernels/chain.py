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

import numpy as np

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.chain_covariance import add_along, add_turned, carry, mirror
from posor_estimator.core.kernels.chain_motion import WINDOW, accelerations, begin_anew, has_room, take
from posor_estimator.core.kernels.chain_pose import fault_of, go_on, rotation_of, turn_on, write_pose
from posor_estimator.core.kernels.vector import (
    Vector,
    apply_tangent,
    at,
    minus,
    plus,
    rotate,
    rotate_back,
    times,
    within,
)

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

SPAN, SHIFT_GAIN, START_GAIN, END_GAIN, SAG_GAIN, SAG_TURN_GAIN = 0, 4, 7, 10, 13, 16
"""Rows of a beam: the beam that does not sag (rotation, translation); then what a specific force [m/s^2] in the axes of
its start does: shift of the end against the start, turn of the start, turn of the end in axes of the end, and one
standard deviation of the sag, translation and turn in axes of the start."""
BEAM_ROWS = 19


@compiled
def go_along_beam(
    beam: FloatArray, force: Vector, step: FloatArray, rotation: FloatArray, translation: FloatArray
) -> None:
    """Go from the plate at a beam's start to that at its end, both moved by the sag under a specific force [m/s^2].

    ``step`` is scratch, (6,), its first half zero.
    """
    step[3], step[4], step[5] = times(-1.0, rotate(beam[START_GAIN:], force))
    apply_tangent(rotation, translation, step)
    along = rotate(rotation, plus(within(beam, SPAN + 3), rotate(beam[SHIFT_GAIN:], force)))
    for i in range(3):
        translation[i] += along[i]
    turn_on(rotation, beam)
    step[3], step[4], step[5] = rotate(beam[END_GAIN:], force)
    apply_tangent(rotation, translation, step)


@compiled
def walk(
    sources: IntArray,
    frames: FloatArray,
    beams: FloatArray,
    beam_covariances: FloatArray,
    gravity: FloatArray,
    poses: FloatArray,
    covariances: FloatArray,
    acceleration: FloatArray,
    work: FloatArray,
    step: FloatArray,
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
        acceleration: Of the beams [m/s^2], (b, 3), axes of the base.
        work: Scratch, (13, 3).
        step: Scratch, (6,), its first half zero.
        centres: Centres of the beams on the way to write [m], (b, 3), axes of the base.
        pose: Of the endpoint in the base to write, (7,).
        covariance: Of the endpoint to write, (6, 6), ROS order, axes of the base.

    """
    rotation, parent, straight, turn = work[:3], work[3:6], work[6:9], work[9:12]
    translation = work[12]
    work[:] = 0.0
    covariance[:] = 0.0
    for i in range(3):
        rotation[i, i] = 1.0
        straight[i, i] = 1.0
    last = at(translation, 0)
    for element in range(sources.shape[0]):
        go_on(rotation, translation, frames[element])
        turn_on(straight, frames[element])
        parent[:] = rotation
        source = sources[element]
        if source >= 0:
            along = rotate(rotation, within(poses, source))
            for i in range(3):
                translation[i] += along[i]
            rotation_of(poses[source], turn)
            turn_on(rotation, turn)
            turn_on(straight, turn)
            here = at(translation, 0)
            carry(covariance, minus(here, last))
            add_turned(covariance, parent, covariances[source])
        else:
            # How a beam lies under gravity is reckoned as if no beam before it sagged: the rest is of second order.
            b = -1 - source
            beam = beams[b]
            centre = plus(at(translation, 0), times(0.5, rotate(rotation, within(beam, SPAN + 3))))
            f = rotate_back(straight, minus(at(gravity, 0), within(acceleration, b)))
            for i in range(3):
                centres[b, i] = centre[i]
            go_along_beam(beam, f, step, rotation, translation)
            turn_on(straight, beam)
            here = at(translation, 0)
            carry(covariance, minus(here, last))
            add_turned(covariance, parent, beam_covariances[b])
            shift = rotate(parent, rotate(beam[SAG_GAIN:], f))
            add_along(covariance, shift, rotate(parent, rotate(beam[SAG_TURN_GAIN:], f)))
        last = here
    go_on(rotation, translation, frames[sources.shape[0]])
    carry(covariance, minus(at(translation, 0), last))
    mirror(covariance)
    write_pose(rotation, translation, pose)


@compiled
def joint_angle(pose: FloatArray, origin: FloatArray, theta: float, turn: FloatArray) -> float:
    """Return how far a joint is turned about its nominal axis [rad]: the heading of its target's Y axis about that.

    Turns are those that have been counted in theta, the same heading about Z of the receiving plate.

    Args:
        pose: Of the target plate in the receiving plate, (7,).
        origin: Rotation of the joint's origin in the receiving plate, (3, 3).
        theta: Counted [rad]; NaN: not counted, the angle is in (-pi, pi].
        turn: Scratch, (3, 3).

    """
    rotation_of(pose, turn)
    heading = turn[0, 1], turn[1, 1], turn[2, 1]
    x, y, _ = rotate_back(origin, heading)
    if math.isnan(theta):
        return math.atan2(-x, y)
    return theta + math.atan2(y * heading[0] - x * heading[1], y * heading[1] + x * heading[0])


@compiled
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
    work = np.empty((13, 3))
    step = np.zeros(6)
    centres = np.zeros(acceleration.shape)
    moving = kept[WINDOW] > 0
    count: int = stamps_ns.shape[0]
    for n in range(begin, count):
        sound = True
        for j in range(faults.shape[1]):
            faults[n, j] = fault_of(poses[n, j], covariances[n, j])
            sound = sound and faults[n, j] == 0
        if not sound:
            found[n] = math.nan
            found_covariances[n] = math.nan
            angles[n] = math.nan
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
            work,
            step,
            centres,
            found[n],
            found_covariances[n],
        )
        if moving:
            take(stamps_ns[n], centres, kept, seen_ns, seen)
        for j in range(faults.shape[1]):
            angles[n, j] = joint_angle(poses[n, j], origins[j], thetas[n, j], work)
    return count


@compiled
def relative_to(
    home: FloatArray, poses: FloatArray, covariances: FloatArray, found: FloatArray, found_covariances: FloatArray
) -> None:
    """Write poses (n, 7) and their covariances (n, 6, 6) in the axes of another, home (7,), which counts as exact."""
    work = np.empty((10, 3))
    back, rotation, turn, translation = work[:3], work[3:6], work[6:9], work[9]
    rotation_of(home, turn)
    for i in range(3):
        for j in range(3):
            back[i, j] = turn[j, i]
    for n in range(poses.shape[0]):
        place = rotate(back, minus(within(poses, n), at(home, 0)))
        for i in range(3):
            translation[i] = place[i]
        rotation[:] = back
        rotation_of(poses[n], turn)
        turn_on(rotation, turn)
        write_pose(rotation, translation, found[n])
        found_covariances[n] = 0.0
        add_turned(found_covariances[n], back, covariances[n])
        mirror(found_covariances[n])
