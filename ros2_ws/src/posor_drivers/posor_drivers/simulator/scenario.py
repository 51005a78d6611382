"""The scenario file: how a simulated arm moves, what is imperfect in its mechanics and in its electronics.

Versions of the format:

1. First version: ``seed``, ``rate``, ``duration``, ``joints``, ``payload``, ``motion``, ``stage``, ``electronics``.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, Self

from posor_estimator.core.beams_file import TubeFile
from posor_estimator.core.calibration.entry import EntryError
from posor_estimator.core.calibration.load import load_document
from posor_estimator.core.calibration.model import Provenance
from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.core.calibration.quantity import ANY, Quantity, measured
from pydantic import Field, model_validator

from posor_drivers.simulator.electronics_file import ElectronicsFile
from posor_drivers.simulator.limits import NOT_NEGATIVE, POSITIVE
from posor_drivers.simulator.phases import Phase, Rest, Seconds, Spline

if TYPE_CHECKING:
    from pathlib import Path

    from posor_drivers.simulator.electronics_file import Contamination

VERSION = 1
FASTEST_HZ = 10_000
_SAME = 1e-9
"""Times [s] and angles [rad] that differ by less are the same: sums of decimal numbers."""


class Gear(FrozenModel):
    """``backlash``: how far the motor turns between pushing one way and the other [rad]."""

    backlash: Annotated[Quantity, measured("rad"), NOT_NEGATIVE]


class Encoder(FrozenModel):
    """``resolution``: the step of the encoder on the motor, seen at the joint [rad]."""

    resolution: Annotated[Quantity, measured("rad"), POSITIVE]


class Bearing(FrozenModel):
    """Error motions of the axis: harmonics of the joint's angle, their phases drawn from the seed.

    One amplitude for each of ``orders`` (whole numbers of periods in a turn): ``radial`` and ``tilt`` go around,
    ``axial`` goes to and fro.
    """

    orders: Annotated[tuple[Annotated[int, Field(strict=True, ge=1)], ...], Field(min_length=1)]
    radial: Annotated[Quantity, measured("m", ANY), NOT_NEGATIVE]
    axial: Annotated[Quantity, measured("m", ANY), NOT_NEGATIVE]
    tilt: Annotated[Quantity, measured("rad", ANY), NOT_NEGATIVE]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for key, quantity in (("radial", self.radial), ("axial", self.axial), ("tilt", self.tilt)):
            if quantity.array.size != len(self.orders):
                expected = f"{len(self.orders)}, one for each of orders"
                raise EntryError(f"{key} has {quantity.array.size} amplitudes", key=(key, "value"), expected=expected)
        return self


class Structure(TubeFile):
    """The structural link after a joint: a tube to the next joint, clamped to this one, and a mass at its end."""

    shear_modulus: Annotated[Quantity, measured("Pa"), POSITIVE]
    end_mass: Annotated[Quantity, measured("kg"), NOT_NEGATIVE]


class JointScenario(FrozenModel):
    """One joint and the structural link after it; what is left out is perfect (a link: rigid and without mass).

    ``start`` is the angle at which the motion begins and ends.
    """

    start: Annotated[Quantity, measured("rad")] = Quantity(value=0.0, unit="rad")
    gear: Gear | None = None
    encoder: Encoder | None = None
    bearing: Bearing | None = None
    structure: Structure | None = None


class Payload(FrozenModel):
    """What the endpoint carries."""

    mass: Annotated[Quantity, measured("kg"), NOT_NEGATIVE]


class StageFile(FrozenModel):
    """A micromanipulator stage at the end of the arm, along X, Y and Z of the endpoint.

    ``stroke`` is to either side of the middle, ``speed`` the fastest, ``resolution`` the step at which it stands.
    ``command_age``: a command whose stamp is further from the present is refused.
    """

    stroke: Annotated[Quantity, measured("m"), POSITIVE]
    speed: Annotated[Quantity, measured("m/s"), POSITIVE]
    resolution: Annotated[Quantity, measured("m"), POSITIVE]
    command_age: Annotated[Quantity, measured("s"), POSITIVE] = Quantity(value=0.5, unit="s")


class Scenario(FrozenModel):
    """A scenario as written. It repeats after ``duration``, for ever.

    The joints are those of the arm; the first phase of ``motion`` begins where every joint has its ``start`` angle, and
    the last one ends there.
    """

    format: Literal["posor_scenario"]
    version: Literal[1]
    name: str
    provenance: Provenance
    seed: Annotated[int, Field(strict=True, ge=0)]
    rate: Annotated[Quantity, measured("Hz")]
    duration: Seconds
    joints: Annotated[dict[str, JointScenario], Field(min_length=1)]
    payload: Payload = Payload(mass=Quantity(value=0.0, unit="kg"))
    motion: Annotated[tuple[Phase, ...], Field(min_length=1)]
    stage: StageFile | None = None
    electronics: ElectronicsFile

    @model_validator(mode="after")
    def _in_time(self) -> Self:
        rate = self.rate.number
        if not (rate.is_integer() and 1 <= rate <= FASTEST_HZ):
            expected = f"a whole number from 1 to {FASTEST_HZ}"
            raise EntryError(f"rate {rate:g} Hz", key=("rate", "value"), expected=expected)
        ticks = self.duration.number * rate
        if abs(ticks - round(ticks)) > _SAME * rate or round(ticks) < 1:
            expected = f"a whole number of ticks of {1.0 / rate:g} s"
            raise EntryError(f"duration {self.duration.number:g} s", key=("duration", "value"), expected=expected)
        total = math.fsum(phase.duration.number for phase in self.motion)
        if abs(total - self.duration.number) > _SAME:
            expected = f"{self.duration.number:g} s, the duration of the scenario"
            raise EntryError(f"the phases take {total:g} s", key=("motion",), expected=expected)
        for index, dirt in enumerate(self.electronics.contamination):
            self._check_dirt(index, dirt)
        return self

    def _check_dirt(self, index: int, dirt: Contamination) -> None:
        key = ("electronics", "contamination", index)
        if dirt.end.number > self.duration.number + _SAME:
            expected = f"at most {self.duration.number:g} s, the duration of the scenario"
            raise EntryError(f"until {dirt.end.number:g} s", key=(*key, "until", "value"), expected=expected)
        self._check_joint(dirt.joint, (*key, "joint"))

    @model_validator(mode="after")
    def _returns(self) -> Self:
        angles = {name: joint.start.number for name, joint in self.joints.items()}
        moved: dict[str, int] = {}
        for index, phase in enumerate(self.motion):
            if isinstance(phase, Rest):
                continue
            for at, joint in enumerate(phase.joints):
                self._check_joint(joint, ("motion", index, "joints", at))
            if isinstance(phase, Spline):
                angles.update(zip(phase.joints, map(float, phase.through.array[-1]), strict=True))
                moved.update(dict.fromkeys(phase.joints, index))
        for name, angle in angles.items():
            start = self.joints[name].start.number
            if abs(angle - start) > _SAME:
                key = ("motion", moved[name], "through")
                what = f"the motion ends with joint '{name}' at {angle:g} rad"
                raise EntryError(what, key=key, expected=f"{start:g} rad, where it begins")
        return self

    def _check_joint(self, name: str, key: tuple[str | int, ...]) -> None:
        if name not in self.joints:
            raise EntryError(f"joint '{name}'", key=key, expected=f"one of {', '.join(self.joints)}")

    @property
    def ticks_per_second(self) -> int:
        """The rate [Hz], a whole number."""
        return round(self.rate.number)

    @property
    def cycle_ticks(self) -> int:
        """After how many ticks everything repeats."""
        return round(self.duration.number * self.rate.number)


def load_scenario(path: Path) -> Scenario:
    """Read and validate a scenario file (YAML, SI).

    Raises:
        CalibrationError: The file cannot be read, is not YAML, or says something that cannot be.

    """
    keys = "format, version, name, provenance, seed, rate, duration, joints, motion, electronics"
    return load_document(path, "scenario file", keys, VERSION, Scenario.model_validate)[0]
