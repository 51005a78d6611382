# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The faults of the storm: the change that each makes to some scans of a block.

Offsets are at least twice the minimal detectable bias of their probe. Faults of a cause have any size within its bound,
and one size, direction and choice of readings in an episode.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.model.scan import DIODES_ESTIMATED, HOME_BUMP, PROBES_ESTIMATED, SATURATED, Scans
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration
from posor_drivers.simulator.simulated_scans import DIODE_FIELD

from posor_lab.faults.cause_injection import draw_sizes, inject

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from posor.calibration.calibration_file import Calibration
    from posor.calibration.causes import Cause
    from posor.estimation.sensor_stack import Stack

OBSERVABLE = 2.0  # least error of a wrong reading, in minimal detectable biases
RANGES = {"gap_voltages": (-7.0, 7.0), "ring_voltages": (-7.0, 7.0), DIODE_FIELD: (0.0, 1.5e-4)}
"""Ranges of the converters [V], [A]."""
FLAGS = {"SATURATED": SATURATED, "PROBES_ESTIMATED": PROBES_ESTIMATED, "DIODES_ESTIMATED": DIODES_ESTIMATED}


@dataclass(frozen=True)
class Episode:
    """One fault of a block, in the scans ``part`` of its arrays; ``bias`` returns a minimal detectable bias [V].

    ``stack``: the sensors that the readings come from.
    """

    arrays: Mapping[str, Any]
    part: slice
    random: np.random.Generator
    bias: Callable[[str, int], float]
    stack: Stack

    def channel(self, name: str) -> tuple[slice, int]:
        """Return the part of a random channel."""
        return self.part, int(self.random.integers(self.arrays[name].shape[1]))

    def set_all(self, name: str, value: Any) -> None:
        """Set a field of all scans."""
        self.arrays[name][self.part] = value

    def set_channel(self, name: str, value: float) -> None:
        """Set a random channel of a field."""
        self.arrays[name][self.channel(name)] = value

    def add_offset(self, name: str) -> None:
        """Add 2 to 200 minimal detectable biases to a random channel."""
        part, channel = self.channel(name)
        factor = math.exp(self.random.uniform(math.log(OBSERVABLE), math.log(100.0 * OBSERVABLE)))
        self.arrays[name][part, channel] += self.random.choice([-1.0, 1.0]) * factor * self.bias(name, channel)

    def act(self, cause: Cause) -> None:
        """Add a fault of a cause."""
        changed = (*RANGES, "supply_voltages", "temperatures")
        fields = (*changed, "stamps_ns", "lit_sources")
        scans = Scans.from_fields(**{name: self.arrays[name][self.part] for name in fields})
        size = self.random.choice(draw_sizes(cause, 1.0, 2, self.random))
        scans = inject(cause, np.full(len(scans), size), scans, self.stack, self.random, alike=True)
        for name in changed:
            self.set_all(name, getattr(scans, name))

    def stick(self, name: str) -> None:
        """Repeat the first reading of a random channel."""
        part, channel = self.channel(name)
        self.arrays[name][part, channel] = self.arrays[name][part.start, channel]

    def randomise(self, name: str) -> None:
        """Set a random channel to random values of its converter."""
        part = self.channel(name)
        self.arrays[name][part] = self.random.uniform(*RANGES[name], self.arrays[name][part].shape)

    def freeze(self) -> None:
        """Repeat the first readings of all channels."""
        for name in RANGES:
            self.set_all(name, self.arrays[name][self.part.start])

    def slip(self, sources: int) -> None:
        """Shift the numbers of the light sources."""
        lit = self.arrays["lit_sources"][self.part]
        lit[:] = (lit + self.random.integers(1, sources)) % sources

    def set_flag(self, flag: int, part: slice | None = None) -> None:
        """Set a status flag."""
        self.arrays["statuses"][part or self.part] |= flag

    def go_home(self) -> None:
        """Set the home mark in at most five scans."""
        length = int(self.random.integers(1, 6))
        part = slice(self.part.start, min(self.part.stop, self.part.start + length))
        self.arrays["at_home"][part] = 1
        self.set_flag(HOME_BUMP, part)


def storm_faults(calibration: Calibration, causes: Iterable[Cause]) -> dict[str, Callable[[Episode], None]]:
    """Return the faults that a stack can have, by name; ``causes``: of faults, of the calibration."""
    faults: dict[str, Callable[[Episode], None]] = {
        "no scans": lambda episode: episode.set_all("sent", value=False),
        "all readings frozen": Episode.freeze,
    }
    environment = {
        "supply": ("supply_voltages", (16.0, 0.0, math.inf)),
        "temperature": ("temperatures", (313.0, 20.0, math.inf)),
    }
    for what, (name, values) in environment.items():
        unit = "V" if what == "supply" else "K"
        faults |= {f"{what} {value:g} {unit}": _call(Episode.set_all, name, value) for value in values}
    faults |= {f"cause {cause.name}": _call(Episode.act, cause) for cause in causes}
    faults |= {f"flag {name}": _call(Episode.set_flag, flag) for name, flag in FLAGS.items()}
    for sensor in calibration.sensors:
        name = field_of(sensor)
        what = {"gap_voltages": "gap probe", "ring_voltages": "ring probe"}.get(name, "diode")
        if isinstance(sensor, DiodesCalibration):
            faults["light-source index off"] = _call(Episode.slip, len(sensor.light_sources))
            faults["no light source lit"] = _call(Episode.set_all, "lit_sources", 255)
        else:
            faults[f"{what} offset"] = _call(Episode.add_offset, name)
        if sensor.bump_angle > 0.0:
            faults["spurious HOME"] = Episode.go_home
        faults[f"{what} stuck"] = _call(Episode.stick, name)
        faults[f"{what} garbage"] = _call(Episode.randomise, name)
        for text, value in (("zero", 0.0), ("not a number", math.nan), ("infinite", math.inf)):
            faults[f"{what} {text}"] = _call(Episode.set_channel, name, value)
    return faults


def _call(method: Callable[..., None], *arguments: Any) -> Callable[[Episode], None]:
    return lambda episode: method(episode, *arguments)


def field_of(sensor: Any) -> str:
    """Return the field of ``Scans`` that a sensor's readings are in."""
    if isinstance(sensor, DiodesCalibration):
        return DIODE_FIELD
    return "gap_voltages" if isinstance(sensor, GapProbesCalibration) else "ring_voltages"
