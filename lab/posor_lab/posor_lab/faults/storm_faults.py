"""The faults of the storm: what each does to some scans of a block.

Offsets are at least twice the minimal detectable bias of their probe.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from posor.model.scan import DIODES_ESTIMATED, HOME_BUMP, PROBES_ESTIMATED, SATURATED
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration
from posor_drivers.simulator.simulated_scans import DIODE_FIELD

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np
    from posor.calibration.calibration_file import Calibration

OBSERVABLE = 2.0
"""Least error of a wrong reading, in minimal detectable biases."""
RANGES = {"gap_voltages": (-7.0, 7.0), "ring_voltages": (-7.0, 7.0), DIODE_FIELD: (0.0, 1.5e-4)}
"""Of the converters [V], [A]."""


@dataclass(frozen=True)
class Episode:
    """One fault of a block, in the scans ``part`` of its arrays; ``bias`` returns a minimal detectable bias [V]."""

    arrays: Mapping[str, Any]
    part: slice
    random: np.random.Generator
    bias: Callable[[str, int], float]

    def __getitem__(self, name: str) -> Any:
        return self.arrays[name]

    def channel(self, name: str) -> tuple[slice, int]:
        """Return the part of a random channel."""
        return self.part, int(self.random.integers(self.arrays[name].shape[1]))

    def size(self) -> tuple[int, ...]:
        """Return the number of scans as a shape."""
        return (self.part.stop - self.part.start,)


def _offset(name: str) -> Callable[[Episode], None]:
    def change(episode: Episode) -> None:
        part, channel = episode.channel(name)
        factor = math.exp(episode.random.uniform(math.log(OBSERVABLE), math.log(100.0 * OBSERVABLE)))
        episode[name][part, channel] += episode.random.choice([-1.0, 1.0]) * factor * episode.bias(name, channel)

    return change


def _value(name: str, value: float) -> Callable[[Episode], None]:
    def change(episode: Episode) -> None:
        episode[name][episode.channel(name)] = value

    return change


def _stuck(name: str) -> Callable[[Episode], None]:
    def change(episode: Episode) -> None:
        part, channel = episode.channel(name)
        episode[name][part, channel] = episode[name][part.start, channel]

    return change


def _garbage(name: str) -> Callable[[Episode], None]:
    def change(episode: Episode) -> None:
        part = episode.channel(name)
        episode[name][part] = episode.random.uniform(*RANGES[name], episode[name][part].shape)

    return change


def _frozen(episode: Episode) -> None:
    for name in RANGES:
        episode[name][episode.part] = episode[name][episode.part.start]


def _slip(sources: int) -> Callable[[Episode], None]:
    def change(episode: Episode) -> None:
        lit = episode["lit_sources"][episode.part]
        lit[:] = (lit + episode.random.integers(1, sources)) % sources

    return change


def _whole(name: str, value: float) -> Callable[[Episode], None]:
    def change(episode: Episode) -> None:
        episode[name][episode.part] = value

    return change


def _flag(flag: int) -> Callable[[Episode], None]:
    def change(episode: Episode) -> None:
        episode["statuses"][episode.part] |= flag

    return change


def _home(episode: Episode) -> None:
    length = int(episode.random.integers(1, 6))
    part = slice(episode.part.start, min(episode.part.stop, episode.part.start + length))
    episode["at_home"][part] = 1
    episode["statuses"][part] |= HOME_BUMP


def _off(episode: Episode) -> None:
    episode["sent"][episode.part] = False


def storm_faults(calibration: Calibration) -> dict[str, Callable[[Episode], None]]:
    """Return the faults that a stack can have, by name."""
    faults: dict[str, Callable[[Episode], None]] = {"no scans": _off, "all readings frozen": _frozen}
    for value in (16.0, 0.0, math.inf):
        faults[f"supply {value:g} V"] = _whole("supply_voltages", value)
    for value in (313.0, 20.0, math.inf):
        faults[f"temperature {value:g} K"] = _whole("temperatures", value)
    flags = {"SATURATED": SATURATED, "PROBES_ESTIMATED": PROBES_ESTIMATED, "DIODES_ESTIMATED": DIODES_ESTIMATED}
    faults |= {f"flag {name}": _flag(flag) for name, flag in flags.items()}
    for sensor in calibration.sensors:
        if isinstance(sensor, DiodesCalibration):
            field, what = DIODE_FIELD, "diode"
            faults["light-source index off"] = _slip(len(sensor.light_sources))
            faults["no light source lit"] = _whole("lit_sources", 255)
        else:
            field = field_of(sensor)
            what = "gap probe" if field == "gap_voltages" else "ring probe"
            faults[f"{what} offset"] = _offset(field)
        if sensor.bump_angle > 0.0:
            faults["spurious HOME"] = _home
        faults |= {
            f"{what} stuck": _stuck(field),
            f"{what} garbage": _garbage(field),
            f"{what} zero": _value(field, 0.0),
            f"{what} not a number": _value(field, math.nan),
            f"{what} infinite": _value(field, math.inf),
        }
    return faults


def field_of(sensor: Any) -> str:
    """Return the field of ``Scans`` that a sensor's readings are in."""
    if isinstance(sensor, DiodesCalibration):
        return DIODE_FIELD
    return "gap_voltages" if isinstance(sensor, GapProbesCalibration) else "ring_voltages"
