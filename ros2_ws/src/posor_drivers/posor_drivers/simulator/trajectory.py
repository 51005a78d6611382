"""From the phases of a motion to commanded joint angles at each tick of the cycle."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.errors import CalibrationError
from scipy.interpolate import CubicSpline

from posor_drivers.simulator.phases import Circle, Dither, Spline

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.types import FloatArray

    from posor_drivers.simulator.nominal import NominalArm
    from posor_drivers.simulator.phases import Phase
    from posor_drivers.simulator.scenario import Scenario


def smooth(shares: FloatArray) -> FloatArray:
    """Return ``10 s^3 - 15 s^4 + 6 s^5``: from 0 to 1, at rest and without acceleration at both ends."""
    s = np.clip(shares, 0.0, 1.0)
    return np.asarray(s**3 * (10.0 + s * (6.0 * s - 15.0)))


def commanded_angles(scenario: Scenario, arm: NominalArm, source: str) -> FloatArray:
    """Return the commanded angle of each joint at each tick of a cycle [rad], (n, joints).

    Args:
        scenario: What the arm does.
        arm: Its kinematics, for circles.
        source: What to call the scenario in complaints, such as its file.

    Raises:
        CalibrationError: The arm cannot follow a circle.

    """
    times = np.arange(scenario.cycle_ticks) / scenario.ticks_per_second
    angles = np.empty((len(times), len(arm.joints)))
    present = np.array([scenario.joints[name].start.number for name in arm.joints])
    begin = 0.0
    for index, phase in enumerate(scenario.motion):
        end = begin + phase.duration.number
        # Where the arm is at the end of a phase is the next one's to say; only the end of the last is the first tick.
        during = (times >= begin) & (times < end) if index + 1 < len(scenario.motion) else times >= begin
        where = f"{source}, key motion[{index}] ({phase.kind})"
        angles[during] = _angles(phase, times[during] - begin, present, arm, where)
        if isinstance(phase, Spline):
            present = present.copy()
            present[_columns(arm, phase.joints)] = phase.through.array[-1]
        begin = end
    return angles


def _columns(arm: NominalArm, joints: Sequence[str]) -> list[int]:
    return [arm.joints.index(name) for name in joints]


def _angles(phase: Phase, times: FloatArray, present: FloatArray, arm: NominalArm, where: str) -> FloatArray:
    """Return the angles (n, joints) of a phase that begins at the present ones, at times since its beginning [s]."""
    if isinstance(phase, Circle):
        return _around(phase, times, present, arm, where)
    angles = np.tile(present, (len(times), 1))
    if isinstance(phase, Spline):
        columns = _columns(arm, phase.joints)
        knots = np.concatenate([[0.0], phase.times])
        spline = CubicSpline(knots, np.vstack([present[columns], phase.through.array]), bc_type="clamped")
        angles[:, columns] = spline(times)
    elif isinstance(phase, Dither):
        window = np.sin(np.pi * times / phase.duration.number) ** 2
        for column, amplitude, frequency in zip(
            _columns(arm, phase.joints), phase.amplitude.array, phase.frequency.array, strict=True
        ):
            angles[:, column] += amplitude * window * np.sin(2.0 * np.pi * frequency * times)
    return angles


def _around(phase: Circle, times: FloatArray, present: FloatArray, arm: NominalArm, where: str) -> FloatArray:
    """Return the angles of a circle of the endpoint: approach, turns, return."""
    posture = present.copy()
    if phase.posture is not None:
        posture[_columns(arm, phase.joints)] = phase.posture.array
    approach, duration = phase.approach.number, phase.duration.number
    shares = smooth((times - approach) / (duration - 2.0 * approach))
    points = circle_points(phase, arm.endpoint(posture[None, :]).translations[0], shares)
    on_circle = arm.angles_for(np.vstack([points, circle_points(phase, points[0], np.zeros(1))]), posture)
    if on_circle is None:
        centre = ", ".join(f"{x:g}" for x in phase.centre.array)
        raise CalibrationError(
            f"the arm cannot follow the circle of {phase.radius.number:g} m about ({centre}) m from its posture",
            where=f"{where}, keys centre, radius, posture",
            expected="three joints or more, and a circle within reach, away from where the arm is stretched",
        )
    away = smooth(np.minimum(times, duration - times) / approach)[:, None]
    between = present + away * (on_circle[-1] - present)
    moving = (times >= approach) & (times <= duration - approach)
    return np.where(moving[:, None], on_circle[:-1], between)


def circle_points(phase: Circle, near: FloatArray, shares: FloatArray) -> FloatArray:
    """Return points of a circle [m], (n, 3), from the one nearest to a given place on.

    Args:
        phase: The circle.
        near: The place, in the base frame [m], (3,).
        shares: How much of all turns has been run, from 0 to 1, (n,).

    """
    centre, axis, radius = phase.centre.array, phase.axis.array, phase.radius.number
    away = near - centre
    first = away - axis * (axis @ away)
    if np.linalg.norm(first) < radius * _CENTRAL:  # no point is the nearest
        first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first = first / np.linalg.norm(first)
    around = (2.0 * np.pi * phase.turns * shares)[:, None]
    return np.asarray(centre + radius * (np.cos(around) * first + np.sin(around) * np.cross(axis, first)))


_CENTRAL = 1e-6
