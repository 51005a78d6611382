# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Control law: joint offsets from measured endpoints, limited in size and rate, with a stop that lasts.

With q the angles where the controller has the joints when the POSORs are read, and e(q) the joint errors that the
endpoint shows there (``NominalRobot.joint_errors``), the offsets follow -e(q) through a low-pass. A correction moves q
and the endpoint alike, so e(q) does not contain it: there is no feedback, hence nothing that a dead time makes
unstable. A dead time T leaves what e changes during T. With f the low-passed -e(q) and g a low-pass of f with the time
constant ``lead_time``, the offsets are 2 f - g: g lags by the lead time, so they are what f will be after it if f goes
on evenly. An extrapolation beyond the largest offset is limited to it: the correction stops only where -e(q) is beyond.

Without encoders q is what was commanded a dead time T' before: then the offsets x enter e(q) by x(t - T') - x(t - T).
The gain of this loop is less than the error of T' over the time constant of f, and less than twice that with a lead
time. So it is stable if the time constant exceeds the error of the dead time; with a lead time twice this error.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from posor.parameter_model import ParameterGroup

if TYPE_CHECKING:
    import pinocchio as pin

    from posor.correction.nominal_robot import NominalRobot
    from posor.numerics.array_types import FloatArray


MOST_SAMPLES = 4096  # of joint angles that are kept


class CorrectionLimits(ParameterGroup):
    """What the offsets may do, and when they stop."""

    max_offset: Annotated[float, Field(gt=0.0, le=0.1)] = Field(
        default=5e-3, description="largest offset of a joint [rad]; a larger one is refused, and the correction stops"
    )
    max_rate: Annotated[float, Field(gt=0.0, le=10.0)] = Field(
        default=0.02, description="largest rate at which an offset changes [rad/s]"
    )
    time_constant: Annotated[float, Field(ge=0.0, le=10.0)] = Field(
        default=0.02, description="time constant of the low-pass of the joint errors [s]; 0: none"
    )
    lead_time: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=0.0,
        description="time by which the joint errors are extrapolated [s], the dead time of the robot from a command to "
        "its motion; twice the error of 'dead_time' must then be less than the time constant; 0: not extrapolated",
    )
    max_age: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.1, description="longest time without a usable endpoint [s]; then the correction stops"
    )


class AngleHistory:
    """Joint angles of the last while, and their values between two times."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, FloatArray]] = deque(maxlen=MOST_SAMPLES)

    def add(self, time_ns: int, angles: FloatArray) -> None:
        """Add angles; where the time goes back, all earlier ones are forgotten."""
        if self._samples and time_ns <= self._samples[-1][0]:
            self._samples.clear()
        self._samples.append((time_ns, angles))

    @property
    def newest_ns(self) -> int:
        """Time of the newest angles [ns]; zero: there are no angles."""
        return self._samples[-1][0] if self._samples else 0

    def at(self, time_ns: int) -> FloatArray | None:
        """Return the angles at a time by linear interpolation; None: they are not known."""
        if self._samples and time_ns == self._samples[-1][0]:
            return self._samples[-1][1]
        for (after_ns, after), (before_ns, before) in pairwise(reversed(self._samples)):
            if before_ns <= time_ns < after_ns:
                return np.asarray(before + (time_ns - before_ns) / (after_ns - before_ns) * (after - before))
        return None


class JointCorrection:
    """The offsets of one robot.

    Attributes:
        offsets: In force, (j,) [rad], to be added to the planned angles.
        stopped: Why the offsets do not change any more; empty: they follow.
        limited: Number of steps in which the rate was limited.

    """

    def __init__(self, robot: NominalRobot, limits: CorrectionLimits | None = None) -> None:
        """Create the law; ``start`` starts it."""
        self._robot, self._limits = robot, limits or CorrectionLimits()
        self.offsets: FloatArray = np.zeros(len(robot.joints))
        self.stopped = "not started"
        self.limited = 0
        self._refusal = ""

    def start(self, time_s: float) -> None:
        """Follow from a steady time [s] on, from the present offsets."""
        self._goal = self._past = self._ahead = self.offsets
        self._usable_s = time_s
        self._measured_s = -math.inf
        self._refusal = "none was received"
        self.stopped = ""

    def stop(self, reason: str) -> None:
        """Hold the offsets until the next start. The first reason stays."""
        self.stopped = self.stopped or reason

    def refuse_endpoint(self, reason: str) -> None:
        """Remember why an endpoint is not used, for the sentence on a stop."""
        self._refusal = reason

    def add_endpoint(self, time_s: float, angles: FloatArray, measured: pin.SE3) -> None:
        """Use a measured endpoint at a steady time [s]; ``angles`` (j,): of the controller when it was measured."""
        if self.stopped:
            return
        wanted = -self._robot.joint_errors(angles, measured)
        worst, limit = int(np.argmax(np.abs(wanted))), self._limits.max_offset
        if not abs(wanted[worst]) <= limit:
            self.stop(f"joint {self._robot.joints[worst]} needs an offset of {wanted[worst]:.3g} rad; limit {limit:g}")
            return
        self._goal = self._goal + self._weight(self._limits.time_constant, time_s) * (wanted - self._goal)
        self._past = self._past + self._weight(self._limits.lead_time, time_s) * (self._goal - self._past)
        self._ahead = np.clip(2.0 * self._goal - self._past, -limit, limit)  # the extrapolation is no need
        self._measured_s = self._usable_s = time_s

    def _weight(self, constant_s: float, time_s: float) -> float:
        """Return the weight of a new value in a low-pass; after a gap the value is taken as it is."""
        since_s = time_s - self._measured_s
        return 1.0 if constant_s == 0.0 or since_s > self._limits.max_age else -math.expm1(-since_s / constant_s)

    def step(self, time_s: float, duration_s: float) -> FloatArray:
        """Return the offsets to command at a steady time [s]; they change at most as the rate allows in a duration [s].

        ``duration_s`` is the time by which the plan goes on, not that since the last step, which may have been late.
        """
        if not self.stopped and time_s - self._usable_s > self._limits.max_age:
            self.stop(f"no usable endpoint for {time_s - self._usable_s:.2f} s: {self._refusal}")
        largest = self._limits.max_rate * duration_s
        if self.stopped or largest <= 0.0:
            return self.offsets
        change = self._ahead - self.offsets
        if (ratio := float(np.max(np.abs(change))) / largest) > 1.0:
            self.limited += 1
            change = change / ratio
        self.offsets = self.offsets + change
        return self.offsets
