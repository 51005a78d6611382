# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The scenario file: motion of a simulated arm, and the imperfections of its mechanics and electronics.

Versions of the format:

1. First version: ``seed``, ``rate``, ``duration``, ``joints``, ``payload``, ``motion``, ``stage``, ``electronics``;
   later ``faults``, ``truth``, ``temperatures``, ``thermometer_period`` and ``vibrations``, which may be left out.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from posor.calibration.calibration_file import Provenance
from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.quantity import ANY, Quantity, measured
from posor.calibration.yaml_document import load_document
from posor.chain.beam_entries import TubeFile
from posor.errors import ParameterError
from pydantic import Field, model_validator

from posor_drivers.quantity_limits import NOT_NEGATIVE, POSITIVE, Seconds, TickRate
from posor_drivers.simulator.electronics_settings import ElectronicsSettings
from posor_drivers.simulator.faults import SimulatedFault
from posor_drivers.simulator.motion_phases import Phase, Rest, Spline
from posor_drivers.simulator.truth_model import SHARED

if TYPE_CHECKING:
    from pathlib import Path

    from posor.numerics.array_types import FloatArray

    from posor_drivers.simulator.nominal_arm import NominalArm

VERSION = 1
LARGEST_AMPLITUDE = 0.01  # of a vibration [m]; a larger one is usually of another unit
_TOLERANCE = 1e-9
"""Times [s] and angles [rad] that differ by less are equal; sums of decimal numbers are not exact."""


class Gear(FrozenModel):
    """``backlash``: motor angle between pushing one way and the other [rad]."""

    backlash: Annotated[Quantity, measured("rad"), NOT_NEGATIVE]


class Encoder(FrozenModel):
    """``resolution``: step of the motor's encoder, as an angle of the joint [rad]."""

    resolution: Annotated[Quantity, measured("rad"), POSITIVE]


class Bearing(FrozenModel):
    """Error motions of the axis: harmonics of the joint angle with phases drawn from the seed.

    One amplitude for each of ``orders`` (periods in a turn): ``radial`` and ``tilt`` rotate, ``axial`` oscillates.
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
    """Structural link after a joint: a tube clamped to this joint, with a mass at its end."""

    shear_modulus: Annotated[Quantity, measured("Pa"), POSITIVE]
    end_mass: Annotated[Quantity, measured("kg"), NOT_NEGATIVE]


class JointScenario(FrozenModel):
    """One joint and the structural link after it. A missing part is perfect; a missing link is rigid and massless.

    ``start`` is the angle at which the motion starts and ends.
    """

    start: Annotated[Quantity, measured("rad")] = Quantity(value=0.0, unit="rad")
    gear: Gear | None = None
    encoder: Encoder | None = None
    bearing: Bearing | None = None
    structure: Structure | None = None


class Payload(FrozenModel):
    """Load at the endpoint."""

    mass: Annotated[Quantity, measured("kg"), NOT_NEGATIVE]


class BeamTemperature(FrozenModel):
    """Temperature at the middle of a measuring beam, from that at which the URDF holds.

    A sine about ``offset`` with ``amplitude``, of whole ``periods`` in a cycle of the scenario, from ``phase`` on.
    """

    offset: Annotated[Quantity, measured("K")] = Quantity(value=0.0, unit="K")
    amplitude: Annotated[Quantity, measured("K"), NOT_NEGATIVE] = Quantity(value=0.0, unit="K")
    periods: Annotated[int, Field(strict=True, ge=1)] = 1
    phase: Annotated[Quantity, measured("rad")] = Quantity(value=0.0, unit="rad")

    def deviations(self, shares: FloatArray) -> FloatArray:
        """Return the deviations [K] at shares of a cycle, (n,)."""
        angles = 2.0 * math.pi * self.periods * shares + self.phase.number
        return np.asarray(self.offset.number + self.amplitude.number * np.sin(angles))


class LinkVibration(FrozenModel):
    """Vibration of the structural link after a joint in its first bending mode.

    The end of the link moves by ``amplitude`` across the link, in the part of ``direction`` (axes of the link's start)
    that is across, as a sine of ``frequency`` from ``phase`` on. It repeats with the cycle of the scenario.
    """

    frequency: Annotated[Quantity, measured("Hz"), POSITIVE]
    amplitude: Annotated[Quantity, measured("m"), NOT_NEGATIVE]
    direction: Annotated[Quantity, measured("1", 3)]
    phase: Annotated[Quantity, measured("rad")] = Quantity(value=0.0, unit="rad")

    @model_validator(mode="after")
    def _check_amplitude(self) -> Self:
        if self.amplitude.number > LARGEST_AMPLITUDE:
            expected = f"at most {LARGEST_AMPLITUDE:g} m (in um or mm?)"
            raise EntryError(f"amplitude {self.amplitude.number:g} m", key=("amplitude",), expected=expected)
        return self

    def displacements(self, times: FloatArray) -> FloatArray:
        """Return the displacements of the link's end [m] at times [s], (n,)."""
        angles = 2.0 * math.pi * self.frequency.number * times + self.phase.number
        return np.asarray(self.amplitude.number * np.sin(angles))


class StageSettings(FrozenModel):
    """A micromanipulator stage at the end of the arm, along X, Y and Z of the endpoint.

    ``stroke`` is the travel to either side, ``speed`` the greatest speed, ``resolution`` the step of the position. A
    command whose stamp differs from the present by more than ``command_age`` is refused.
    """

    stroke: Annotated[Quantity, measured("m"), POSITIVE]
    speed: Annotated[Quantity, measured("m/s"), POSITIVE]
    resolution: Annotated[Quantity, measured("m"), POSITIVE]
    command_age: Annotated[Quantity, measured("s"), POSITIVE] = Quantity(value=0.5, unit="s")


class Scenario(FrozenModel):
    """Contents of a scenario file; the scenario repeats after ``duration``.

    ``joints`` are those of the arm. ``truth`` names the model of the readings, see ``truth_model``. The first phase of
    ``motion`` starts, and the last one ends, where every joint has its ``start`` angle.
    """

    format: Literal["posor_scenario"]
    version: Literal[1]
    name: str
    provenance: Provenance
    seed: Annotated[int, Field(strict=True, ge=0)]
    rate: TickRate
    duration: Seconds
    joints: Annotated[dict[str, JointScenario], Field(min_length=1)]
    payload: Payload = Payload(mass=Quantity(value=0.0, unit="kg"))
    motion: Annotated[tuple[Phase, ...], Field(min_length=1)]
    stage: StageSettings | None = None
    temperatures: dict[str, BeamTemperature] = Field(default_factory=dict)  # by beam; others: drawn, constant
    thermometer_period: Seconds = Quantity(value=1.0, unit="s")  # between two readings of each thermometer
    vibrations: dict[str, LinkVibration] = Field(default_factory=dict)  # by joint, of the link after it
    electronics: ElectronicsSettings
    truth: str = SHARED
    faults: tuple[SimulatedFault, ...] = ()

    @model_validator(mode="after")
    def _check_times(self) -> Self:
        rate, duration = self.rate.number, self.duration.number
        ticks = duration * rate
        if abs(ticks - round(ticks)) > _TOLERANCE * rate or round(ticks) < 1:
            expected = f"a whole number of ticks of {1.0 / rate:g} s"
            raise EntryError(f"duration {duration:g} s", key=("duration", "value"), expected=expected)
        total = math.fsum(phase.duration.number for phase in self.motion)
        if abs(total - duration) > _TOLERANCE:
            expected = f"{duration:g} s, the duration of the scenario"
            raise EntryError(f"the phases take {total:g} s", key=("motion",), expected=expected)
        dirt = self.electronics.contamination
        for key, timed in ((("electronics", "contamination"), dirt), (("faults",), self.faults)):
            for i, entry in enumerate(timed):
                if entry.end.number > duration + _TOLERANCE:
                    expected = f"at most {duration:g} s, the duration of the scenario"
                    raise EntryError(
                        f"until {entry.end.number:g} s", key=(*key, i, "until", "value"), expected=expected
                    )
                self._check_joint(entry.joint, (*key, i, "joint"))
        return self

    @model_validator(mode="after")
    def _check_return_to_start(self) -> Self:
        angles = {name: joint.start.number for name, joint in self.joints.items()}
        last_phase: dict[str, int] = {}
        for index, phase in enumerate(self.motion):
            if isinstance(phase, Rest):
                continue
            for position, joint in enumerate(phase.joints):
                self._check_joint(joint, ("motion", index, "joints", position))
            if isinstance(phase, Spline):
                angles.update(zip(phase.joints, map(float, phase.through.array[-1]), strict=True))
                last_phase.update(dict.fromkeys(phase.joints, index))
        for name, angle in angles.items():
            start = self.joints[name].start.number
            if abs(angle - start) > _TOLERANCE:
                what = f"the motion ends with joint '{name}' at {angle:g} rad"
                key = ("motion", last_phase[name], "through")
                raise EntryError(what, key=key, expected=f"{start:g} rad, its angle at the start")
        return self

    @model_validator(mode="after")
    def _check_vibrations(self) -> Self:
        for name, vibration in self.vibrations.items():
            self._check_joint(name, ("vibrations", name))
            periods = vibration.frequency.number * self.duration.number
            if abs(periods - round(periods)) > _TOLERANCE * periods:
                what = f"frequency {vibration.frequency.number:g} Hz"
                expected = f"a whole number of periods in {self.duration.number:g} s, the duration of the scenario"
                raise EntryError(what, key=("vibrations", name, "frequency"), expected=expected)
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
        """Number of ticks after which the motion repeats."""
        return round(self.duration.number * self.rate.number)

    def at_rate(self, rate: int) -> Scenario:
        """Return the scenario at another rate [Hz].

        Raises:
            ParameterError: The scenario does not take a whole number of ticks at this rate.

        """
        duration = self.duration.number
        if abs(duration * rate - round(duration * rate)) > _TOLERANCE * rate:
            what = f"{rate} Hz does not fit the scenario '{self.name}'"
            expected = f"a whole number of ticks in {duration:g} s"
            raise ParameterError(what, where="parameter 'simulated.rate'", expected=expected)
        return self.model_copy(update={"rate": Quantity(value=float(rate), unit="Hz")})

    def commanded_angles(self, arm: NominalArm, source: str) -> FloatArray:
        """Return the commanded joint angles at each tick of a cycle [rad], (n, j).

        ``arm`` is needed for circles; ``source`` names the scenario in error messages.

        Raises:
            CalibrationError: The arm cannot follow a circle.

        """
        times = np.arange(self.cycle_ticks) / self.ticks_per_second
        angles = np.empty((len(times), len(arm.joints)))
        start = np.array([self.joints[name].start.number for name in arm.joints])
        begin = 0.0
        for index, phase in enumerate(self.motion):
            end = begin + phase.duration.number
            # The tick at the boundary of two phases belongs to the later one.
            during = (times >= begin) & (times < end) if index + 1 < len(self.motion) else times >= begin
            where = f"{source}, key motion[{index}] ({phase.kind})"
            angles[during] = phase.angles(times[during] - begin, start, arm, where)
            if isinstance(phase, Spline):
                start = start.copy()
                start[[arm.joints.index(name) for name in phase.joints]] = phase.through.array[-1]
            begin = end
        return angles


def load_scenario(path: Path) -> Scenario:
    """Read and validate a scenario file (YAML, SI).

    Raises:
        CalibrationError: The file cannot be read, is not YAML, or holds an invalid entry.

    """
    keys = "format, version, name, provenance, seed, rate, duration, joints, motion, electronics"
    return load_document(path, "scenario file", keys, VERSION, Scenario.model_validate)[0]
