"""The physical quantities behind the parameters: a tip is one quantity, although it has three coordinates."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.posor import Posor
    from posor_estimator.core.sensors.base import SensorCalibration

_NAME = re.compile(r"(?P<array>\w+)\[(?P<first>\d*)")

_OF_EACH: Mapping[str, tuple[str, str]] = {
    "tips": ("probes", "tip"),
    "axes": ("probes", "axis"),
    "volts_to_gap": ("probes", "linearisation"),
    "zero_shifts": ("probes", "zero shift"),
    "supply": ("probes", "supply voltage"),
    "temperature": ("probes", "temperature"),
    "origins": ("diodes", "place (axes offset)"),
    "x_axes": ("diodes", "axes (flatness, squareness)"),
    "y_axes": ("diodes", "axes (flatness, squareness)"),
    "maps": ("diodes", "map"),
    "source_origins": ("light_sources", "place"),
    "source_directions": ("light_sources", "direction"),
}
"""Parameter arrays that have a row for each part of a list in the calibration file: the list, and what the row is."""

_OF_ALL: Mapping[str, str] = {
    "plane_point": "target plane: point",
    "plane_tilt": "target plane: tilt",
    "mean_radius": "ring: mean radius",
    "cos": "ring: profile",
    "sin": "ring: profile",
}
"""Parameter arrays that are one quantity as a whole."""


@dataclass(frozen=True)
class PhysicalQuantity:
    """A calibrated quantity: its name, and where its components stand in the stack's parameter vector."""

    name: str
    parameters: tuple[int, ...]


def physical_quantities(posor: Posor) -> tuple[PhysicalQuantity, ...]:
    """Return all calibrated quantities of a POSOR, each parameter in one of them.

    A sensor type that is not one of ours keeps its own names, one quantity for each row of a named array.
    """
    found: dict[str, list[int]] = {}
    at = 0
    for calibration, sensor in zip(posor.calibration.sensors, posor.stack.sensors, strict=True):
        for name in sensor.parameter_names:
            found.setdefault(_quantity_name(calibration, name), []).append(at)
            at += 1
    return tuple(PhysicalQuantity(name, tuple(where)) for name, where in found.items())


def _quantity_name(calibration: SensorCalibration, parameter: str) -> str:
    match = _NAME.match(parameter)
    if match is None:
        return f"{type(calibration).__name__}: {parameter}"
    array, first = match["array"], match["first"]
    if array in _OF_EACH and first:
        parts, what = _OF_EACH[array]
        listed = getattr(calibration, parts, None)
        if listed is not None:
            return f"{listed[int(first)].name}: {what}"
    if array in _OF_ALL:
        return _OF_ALL[array]
    return f"{getattr(calibration, 'type', type(calibration).__name__)}: {array}{f'[{first}]' if first else ''}"
