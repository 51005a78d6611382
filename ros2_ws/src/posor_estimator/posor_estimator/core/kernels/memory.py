"""What the estimator remembers from scan to scan, and what it is set to: two flat arrays and what they mean.

Flat arrays, so that a compiled run can stop anywhere, ask its caller for a start pose, and go on.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import in_place, inlined
from posor_estimator.core.kernels.eight import everywhere

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

# Layout of the memory.
KNOWN = 0  # 1 where there is a last pose
STAMP = 1  # its time [s], relative to the run's epoch
THETA = 2  # its theta [rad], turns counted
RATE = 3  # of theta [rad/s]
COUNTED = 4  # 1 where theta is counted from the home mark, or needs no count
GIVEN = 5  # 1 where the caller has just given the last pose as a start
ROTATION = 6  # nine entries, row by row
TRANSLATION = 15  # three entries [m]
VELOCITY = 18  # of the translation, three entries [m/s]
INTERVAL = 21  # time over which rate and velocity were found [s]; zero: not known
MEMORY = 22

LONGEST_GAP = 3.5
"""Intervals of the scans before, over which a motion is taken to go on."""

# Layout of the settings.
LIMIT = 0  # largest chi-square of the redundant readings
MOTION_TRANSLATION = 1  # fastest the target moves across [m/s]; infinite: not limited
MOTION_LEAN = 2  # fastest it leans [rad/s]
MOTION_THETA = 3  # fastest it turns [rad/s]
BUMP = 4  # angle of one bump [rad]; zero: theta is not counted
HOME = 5  # theta of the home mark [rad]
LAGGING = 6  # 1: tilts are turned by the theta of the scan before
SETTINGS = 7


@inlined
def wrapped(angle: float) -> float:
    """Return the angle [rad] in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@inlined
def theta_of(rotation: FloatArray) -> float:
    """Return the heading of the Y axis of T in R [rad] (``core.native``)."""
    return math.atan2(-rotation[0, 1], rotation[1, 1])


@inlined
def theta_remembered(memory: FloatArray) -> float:
    """Return the heading of the Y axis of the last pose [rad], without turns counted."""
    return math.atan2(-memory[ROTATION + 1], memory[ROTATION + 4])


@in_place
def turn_about_z(rotation: FloatArray, angle: float) -> None:
    """Turn a pose's rotation about the target's own Z by ``angle`` [rad], in place."""
    c, s = math.cos(angle), math.sin(angle)
    for i in range(3):
        x, y = rotation[i, 0], rotation[i, 1]
        rotation[i, 0] = c * x + s * y
        rotation[i, 1] = c * y - s * x


@inlined
def recall(memory: FloatArray, rotation: FloatArray, translation: FloatArray) -> None:
    """Write the last pose into ``rotation`` and ``translation``."""
    for i in range(3):
        translation[i] = memory[TRANSLATION + i]
        for j in range(3):
            rotation[i, j] = memory[ROTATION + 3 * i + j]


@inlined
def remember(memory: FloatArray, rotation: FloatArray, translation: FloatArray) -> None:
    """Keep a pose as the last one."""
    for i in range(3):
        memory[TRANSLATION + i] = translation[i]
        for j in range(3):
            memory[ROTATION + 3 * i + j] = rotation[i, j]


@inlined
def start_from_memory(
    stamp: float, settings: FloatArray, memory: FloatArray, rotation: FloatArray, translation: FloatArray
) -> None:
    """Write the start for a scan: the last pose, for a counted theta turned on at the last rate."""
    recall(memory, rotation, translation)
    if settings[BUMP] > 0.0 and memory[GIVEN] == 0.0:
        turn_about_z(rotation, memory[RATE] * (stamp - memory[STAMP]))


@inlined
def goes_on(elapsed: float, memory: FloatArray) -> bool:
    """Return whether, ``elapsed`` [s] after the last scan, the motion before it still says something."""
    going: bool = elapsed <= LONGEST_GAP * memory[INTERVAL]
    return going


@inlined
def carry_on(
    elapsed: float, settings: FloatArray, memory: FloatArray, rotation: FloatArray, translation: FloatArray
) -> None:
    """Move a start from ``start_from_memory`` on as the target moved before the last scan, for ``elapsed`` [s].

    So the solution is near and found in fewer steps.
    """
    for i in range(3):
        translation[i] += memory[VELOCITY + i] * elapsed
    if everywhere(settings[BUMP] == 0.0):
        turn_about_z(rotation, memory[RATE] * elapsed)


@inlined
def remember_motion(elapsed: float, theta: float, translation: FloatArray, memory: FloatArray) -> None:
    """Keep how the target has moved since the last pose, which the memory still holds, in ``elapsed`` [s]."""
    memory[RATE] = (theta - memory[THETA]) / elapsed
    for i in range(3):
        memory[VELOCITY + i] = (translation[i] - memory[TRANSLATION + i]) / elapsed


@in_place
def restart_if_back(stamp: float, memory: FloatArray) -> None:
    """Forget the last pose where time has not gone on: a replay has started over."""
    if memory[KNOWN] > 0.0 and memory[GIVEN] == 0.0 and not stamp > memory[STAMP]:
        memory[KNOWN] = 0.0
        memory[COUNTED] = 0.0


@in_place
def bumps_off(theta: float, settings: FloatArray) -> float:
    """Return by how many whole bumps the counted theta misses the home mark's, a turn being no miss."""
    bump = settings[BUMP]
    per_turn = round(2.0 * math.pi / bump)
    off = float(round((theta - settings[HOME]) / bump))
    return float(off - per_turn * math.floor(off / per_turn + 0.5))
