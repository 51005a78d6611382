# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Phases of a scenario's motion: their file format, and the joint angles that they command.

Every phase starts at rest at the joint angles where the previous phase ended, and ends at rest. A spline ends at its
last waypoint; every other phase ends where it started.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from posor.calibration.file_model import EntryError, FrozenModel, format_value, select_model_by_key
from posor.calibration.quantity import ANY, Quantity, check_unit_vector, measured
from posor.errors import CalibrationError
from pydantic import Field, model_validator
from scipy.interpolate import CubicSpline

from posor_drivers.quantity_limits import NOT_NEGATIVE, POSITIVE, Seconds

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

    from posor_drivers.simulator.nominal_arm import NominalArm

JointNames = Annotated[tuple[str, ...], Field(min_length=1)]
_AT_CENTRE = 1e-6
"""Distance from the circle's axis, as share of the radius, below which no point of the circle is the nearest."""


def _check_once(joints: tuple[str, ...]) -> None:
    """Refuse a joint that is listed twice."""
    for index, joint in enumerate(joints):
        if joint in joints[:index]:
            raise EntryError(f"joint '{joint}' is listed twice", key=("joints", index), expected="each joint once")


def _check_count(key: str, quantity: Quantity, count: int, entry: str) -> None:
    """Refuse a list that does not have one number for each entry of another list."""
    found = quantity.array.shape[-1]
    if found != count:
        raise EntryError(f"{key} has {found} numbers", key=(key, "value"), expected=f"{count}, one for each {entry}")


class Rest(FrozenModel):
    """No motion."""

    kind: Literal["rest"]
    duration: Seconds

    def angles(self, times: FloatArray, start: FloatArray, _arm: NominalArm, _where: str) -> FloatArray:
        """Return the start angles at all times."""
        return np.tile(start, (len(times), 1))


class Spline(FrozenModel):
    """Cubic splines through waypoints, at rest at both ends.

    ``through`` has a row for each waypoint and a column for each of ``joints``; other joints stand still. ``at`` holds
    the time of each waypoint after the start of the phase, the last one its end; by default they are evenly spaced.
    """

    kind: Literal["spline"]
    duration: Seconds
    joints: JointNames
    through: Annotated[Quantity, measured("rad", ANY, ANY)]
    at: Annotated[Quantity, measured("s", ANY)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _check_once(self.joints)
        _check_count("through", self.through, len(self.joints), "joint")
        if self.at is not None:
            _check_count("at", self.at, len(self.through.array), "row of through")
            times = np.concatenate([[0.0], self.at.array])
            if not (np.all(np.diff(times) > 0.0) and times[-1] == self.duration.number):
                expected = f"ascending times from more than 0 s to {self.duration.number:g} s, the duration"
                raise EntryError(f"at {format_value(self.at.value)} s", key=("at", "value"), expected=expected)
        return self

    def angles(self, times: FloatArray, start: FloatArray, arm: NominalArm, _where: str) -> FloatArray:
        """Return the joint angles [rad], (n, j), at times after the start of the phase [s], (n,)."""
        columns = _columns(arm, self.joints)
        count = len(self.through.array)
        waypoint_times = self.duration.number * np.arange(1, count + 1) / count if self.at is None else self.at.array
        waypoints = np.vstack([start[columns], self.through.array])
        spline = CubicSpline(np.concatenate([[0.0], waypoint_times]), waypoints, bc_type="clamped")
        angles = np.tile(start, (len(times), 1))
        angles[:, columns] = spline(times)
        return angles


class Circle(FrozenModel):
    """The endpoint moves around a circle; ``approach`` is the time to reach it, and again the time to return.

    ``centre`` and ``axis`` are in the base frame. Of all joint angles that bring the endpoint to a point, those nearest
    to ``posture`` are used (columns as ``joints``; a joint without posture has its angle at the start of the phase).
    The circle starts at its point nearest to the endpoint in that posture.
    """

    kind: Literal["circle"]
    duration: Seconds
    approach: Seconds
    centre: Annotated[Quantity, measured("m", 3)]
    axis: Annotated[Quantity, measured("1", 3)]
    radius: Annotated[Quantity, measured("m"), POSITIVE]
    turns: Annotated[int, Field(strict=True, ge=1)] = 1
    joints: tuple[str, ...] = ()
    posture: Annotated[Quantity, measured("rad", ANY)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        check_unit_vector("axis", self.axis)
        _check_once(self.joints)
        if (self.posture is None) == bool(self.joints):
            raise EntryError("joints and posture do not go together", key=("joints",), expected="both or neither")
        if self.posture is not None:
            _check_count("posture", self.posture, len(self.joints), "joint")
        if not 2.0 * self.approach.number < self.duration.number:
            expected = f"less than {0.5 * self.duration.number:g} s, half the duration"
            raise EntryError(f"approach {self.approach.number:g} s", key=("approach", "value"), expected=expected)
        return self

    def angles(self, times: FloatArray, start: FloatArray, arm: NominalArm, where: str) -> FloatArray:
        """Return the joint angles [rad], (n, j), at times after the start of the phase [s], (n,).

        Raises:
            CalibrationError: The arm cannot reach the circle; ``where`` names the phase.

        """
        posture = start.copy()
        if self.posture is not None:
            posture[_columns(arm, self.joints)] = self.posture.array
        approach, duration = self.approach.number, self.duration.number
        near = arm.endpoint(posture[None, :]).translations[0]
        points = self._points(near, smooth_step((times - approach) / (duration - 2.0 * approach)))
        on_circle = arm.solve_angles(np.vstack([points, self._points(points[0], np.zeros(1))]), posture)
        if on_circle is None:
            centre = ", ".join(f"{x:g}" for x in self.centre.array)
            what = f"the arm cannot follow the circle of {self.radius.number:g} m about ({centre}) m from its posture"
            expected = "three joints or more, and a circle within reach, away from where the arm is stretched"
            raise CalibrationError(what, where=f"{where}, keys centre, radius, posture", expected=expected)
        share = smooth_step(np.minimum(times, duration - times) / approach)[:, None]
        approaching = start + share * (on_circle[-1] - start)
        moving = (times >= approach) & (times <= duration - approach)
        return np.where(moving[:, None], on_circle[:-1], approaching)

    def _points(self, near: FloatArray, shares: FloatArray) -> FloatArray:
        """Return points of the circle [m], (n, 3), at shares of all turns; share 0 is the point nearest to ``near``."""
        centre, axis, radius = self.centre.array, self.axis.array, self.radius.number
        offset = near - centre
        first = offset - axis * (axis @ offset)
        if np.linalg.norm(first) < radius * _AT_CENTRE:
            first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        first = first / np.linalg.norm(first)
        angle = (2.0 * np.pi * self.turns * shares)[:, None]
        return np.asarray(centre + radius * (np.cos(angle) * first + np.sin(angle) * np.cross(axis, first)))


class Dither(FrozenModel):
    """Small sines about the start angles under a Hann window over the duration.

    Each sine has one entry in ``joints``, ``amplitude`` and ``frequency``; sines of one joint add up.
    """

    kind: Literal["dither"]
    duration: Seconds
    joints: JointNames
    amplitude: Annotated[Quantity, measured("rad", ANY), NOT_NEGATIVE]
    frequency: Annotated[Quantity, measured("Hz", ANY), POSITIVE]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _check_count("amplitude", self.amplitude, len(self.joints), "entry of joints")
        _check_count("frequency", self.frequency, len(self.joints), "entry of joints")
        return self

    def angles(self, times: FloatArray, start: FloatArray, arm: NominalArm, _where: str) -> FloatArray:
        """Return the joint angles [rad], (n, j), at times after the start of the phase [s], (n,)."""
        angles = np.tile(start, (len(times), 1))
        window = np.sin(np.pi * times / self.duration.number) ** 2
        sines = zip(_columns(arm, self.joints), self.amplitude.array, self.frequency.array, strict=True)
        for column, amplitude, frequency in sines:
            angles[:, column] += amplitude * window * np.sin(2.0 * np.pi * frequency * times)
        return angles


Phase = Annotated[
    Rest | Spline | Circle | Dither,
    select_model_by_key("kind", {"rest": Rest, "spline": Spline, "circle": Circle, "dither": Dither}),
]


def smooth_step(shares: FloatArray) -> FloatArray:
    """Return ``10 s^3 - 15 s^4 + 6 s^5``: from 0 to 1 with zero velocity and acceleration at both ends."""
    s = np.clip(shares, 0.0, 1.0)
    return np.asarray(s**3 * (10.0 + s * (6.0 * s - 15.0)))


def _columns(arm: NominalArm, joints: tuple[str, ...]) -> list[int]:
    """Return the columns of joints in an array of joint angles."""
    return [arm.joints.index(name) for name in joints]
