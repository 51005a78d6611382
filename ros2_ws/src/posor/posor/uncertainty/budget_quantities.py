# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Outputs and inputs of an error budget.

Outputs: the six native coordinates, and the gap at chosen points of the plate. Inputs: the calibrated physical
quantities behind the parameters of a stack; a probe tip is one quantity with three coordinates.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor.model.native_coordinates import native_from_rotation, native_jacobian
from posor.model.reading_rows import GAP, ROW, ROW_PARAMETER_IDS, differentiate_rows, evaluate_rows
from posor.sensors.base import no_parameters

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.estimation.posor import Posor
    from posor.estimation.sensor_stack import Stack
    from posor.numerics.array_types import FloatArray
    from posor.sensors.base import SensorCalibration

NATIVE = (("x", "m"), ("y", "m"), ("gap", "m"), ("alpha", "rad"), ("beta", "rad"), ("theta", "rad"))
THETA = 5  # index of theta among the native coordinates


_PARAMETER_NAME = re.compile(r"(?P<array>\w+)\[(?P<first>\d*)")

_QUANTITIES_OF_PARTS: Mapping[str, tuple[str, str]] = {
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
"""Parameter arrays with a row for each part of a list in the calibration file: the list, and the name of a row."""

_WHOLE_QUANTITIES: Mapping[str, str] = {  # parameter arrays that are one quantity as a whole
    "plane_point": "target plane: point",
    "plane_tilt": "target plane: tilt",
    "mean_radius": "ring: mean radius",
    "cos": "ring: profile",
    "sin": "ring: profile",
}


@dataclass(frozen=True)
class PlatePoint:
    """A point of the receiving plate; its gap is the reading of an exact probe along Z of R."""

    x: float  # along X of R [m]
    y: float  # along Y of R [m]

    @property
    def name(self) -> str:
        """Name of the gap at the point."""
        return f"gap at ({1e3 * self.x:g}, {1e3 * self.y:g}) mm"


@dataclass(frozen=True)
class Output:
    """Name of an output quantity, and its unit, ``m`` or ``rad``."""

    name: str
    unit: str


class Outputs:
    """Outputs of a stack as functions of the pose and of the parameters.

    Gaps are measured to the target plane of the stack's gap probes, or to the plane Z = 0 of T without gap probes.
    """

    def __init__(self, stack: Stack, points: Sequence[PlatePoint]) -> None:
        """Prepare for the native coordinates and these points."""
        self.named = (*(Output(name, unit) for name, unit in NATIVE), *(Output(point.name, "m") for point in points))
        self._parameters = stack.parameters
        self._rows, ids = np.zeros(len(points), dtype=ROW), no_parameters(len(points))
        self._rows["kind"] = GAP
        self._rows["tip"][:, :2] = np.reshape([(point.x, point.y) for point in points], (-1, 2))
        self._rows["axis"] = 0.0, 0.0, 1.0
        gap_rows = np.flatnonzero(stack.reading_rows["kind"] == GAP)
        if gap_rows.size:
            probe = stack.reading_rows[gap_rows[0]]
            probe_ids = stack.row_parameters[gap_rows[0]].view(ROW_PARAMETER_IDS)[0]
            for field in ("plane_point", "tilt"):
                self._rows[field], ids[field] = probe[field], probe_ids[field]
        self._ids = ids["parameters"]
        self._known = np.nonzero(self._ids >= 0)

    def load_parameter_values(self, values: FloatArray) -> None:
        """Replace the parameter vector of the stack (shape (p,)) in place."""
        self._rows["parameters"][self._known] = values[self._ids[self._known]]

    def values(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return the outputs at ``T_R_T`` [m, rad], shape (k,)."""
        gaps, _ = evaluate_rows(self._rows, rotation, translation)
        return np.array([*translation, *native_from_rotation(rotation), *gaps])

    def by_motion(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return the derivatives with respect to a small motion of T in ROS order (axes of R), shape (k, 6)."""
        out = np.zeros((len(self.named), 6))
        out[:3, :3] = np.eye(3)
        out[3:6, 3:] = native_jacobian(rotation)
        out[6:] = evaluate_rows(self._rows, rotation, translation)[1] @ np.kron(np.eye(2), rotation.T)
        return out

    def by_parameters(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return the derivatives with respect to the stack's parameters at a fixed pose, shape (k, p)."""
        out = np.zeros((len(self.named), self._parameters))
        derivatives = differentiate_rows(self._rows, rotation, translation)
        for derivative, ids, gradient in zip(derivatives, self._ids, out[6:], strict=True):
            gradient[ids[ids >= 0]] += derivative[ids >= 0]
        return out


@dataclass(frozen=True)
class PhysicalQuantity:
    """Name of a calibrated quantity, and the indices of its components in the stack's parameter vector."""

    name: str
    parameters: tuple[int, ...]


def physical_quantities(posor: Posor) -> tuple[PhysicalQuantity, ...]:
    """Return all calibrated quantities of a POSOR; each parameter belongs to one of them.

    Quantities of other sensor types are named by the sensor, one for each row of a named array.
    """
    names = [
        _quantity_name(calibration, name)
        for calibration, sensor in zip(posor.calibration.sensors, posor.stack.sensors, strict=True)
        for name in sensor.parameter_names
    ]
    parameters: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        parameters.setdefault(name, []).append(index)
    return tuple(PhysicalQuantity(name, tuple(indices)) for name, indices in parameters.items())


def _quantity_name(calibration: SensorCalibration, parameter: str) -> str:
    match = _PARAMETER_NAME.match(parameter)
    if match is None:
        return f"{type(calibration).__name__}: {parameter}"
    array, first = match["array"], match["first"]
    if array in _QUANTITIES_OF_PARTS and first:
        parts, what = _QUANTITIES_OF_PARTS[array]
        listed = getattr(calibration, parts, None)
        if listed is not None:
            return f"{listed[int(first)].name}: {what}"
    if array in _WHOLE_QUANTITIES:
        return _WHOLE_QUANTITIES[array]
    return f"{getattr(calibration, 'type', type(calibration).__name__)}: {array}{f'[{first}]' if first else ''}"
