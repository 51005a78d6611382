"""The phases of a scenario's motion, as the file says them; ``trajectory`` turns them into joint angles.

Every phase begins at the joint angles at which the one before has ended, at rest, and ends at rest. A spline ends at
its last waypoint, all others where they began.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from posor_estimator.core.calibration.choice import chosen_by
from posor_estimator.core.calibration.entry import EntryError, shown
from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.core.calibration.quantity import ANY, Quantity, check_unit_vector, measured
from pydantic import Field, model_validator

from posor_drivers.simulator.limits import NOT_NEGATIVE, POSITIVE

Seconds = Annotated[Quantity, measured("s"), POSITIVE]
JointNames = Annotated[tuple[str, ...], Field(min_length=1)]


def _check_once(joints: tuple[str, ...]) -> None:
    for index, joint in enumerate(joints):
        if joint in joints[:index]:
            raise EntryError(f"joint '{joint}' stands twice", key=("joints", index), expected="each joint once")


def _check_count(key: str, quantity: Quantity, count: int, of: str) -> None:
    found = quantity.array.shape[-1]
    if found != count:
        raise EntryError(f"{key} has {found} numbers", key=(key, "value"), expected=f"{count}, one for each {of}")


class Rest(FrozenModel):
    """Nothing moves."""

    kind: Literal["rest"]
    duration: Seconds


class Spline(FrozenModel):
    """Through waypoints: cubic splines, at rest at the beginning and at the end.

    ``through`` has a row for each waypoint and a column for each of ``joints``; other joints stay where they are.
    ``at`` says when each is reached, counted from the beginning of the phase, the last at its end; without it they are
    evenly spaced.
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
                raise EntryError(f"at {shown(self.at.value)} s", key=("at", "value"), expected=expected)
        return self

    @property
    def times(self) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """When each waypoint is reached [s]."""
        if self.at is not None:
            return np.array(self.at.array)
        count = len(self.through.array)
        return self.duration.number * np.arange(1, count + 1) / count


class Circle(FrozenModel):
    """The endpoint runs around a circle: ``approach`` to get there, the turns, and ``approach`` to get back.

    ``centre`` and ``axis`` are in the base frame. Of all joint angles that bring the endpoint to a place the ones
    nearest to ``posture`` are taken (columns as ``joints``; a joint that is not named, and without a posture every
    joint, has the angle at which the phase begins). The circle begins at its point nearest to the posture's endpoint.
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


class Dither(FrozenModel):
    """Small sines about where the arm stands, swelling and fading (Hann window over the duration).

    One entry of ``joints``, ``amplitude`` and ``frequency`` for each sine; those of one joint add up.
    """

    kind: Literal["dither"]
    duration: Seconds
    joints: JointNames
    amplitude: Annotated[Quantity, measured("rad", ANY), NOT_NEGATIVE]
    frequency: Annotated[Quantity, measured("Hz", ANY), POSITIVE]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for key, quantity in (("amplitude", self.amplitude), ("frequency", self.frequency)):
            _check_count(key, quantity, len(self.joints), "entry of joints")
        return self


Phase = Annotated[
    Rest | Spline | Circle | Dither,
    chosen_by("kind", {"rest": Rest, "spline": Spline, "circle": Circle, "dither": Dither}),
]
