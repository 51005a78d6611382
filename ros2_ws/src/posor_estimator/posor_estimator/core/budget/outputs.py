"""What a budget judges: the six native coordinates, and the gap at chosen points of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.kernels.rows import GAP, evaluate_row, row_parameters
from posor_estimator.core.native import native_from_rotation, native_jacobian

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.stack import Stack
    from posor_estimator.core.types import FloatArray

NATIVE = (("x", "m"), ("y", "m"), ("gap", "m"), ("alpha", "rad"), ("beta", "rad"), ("theta", "rad"))
THETA = 5
"""Where theta stands among them."""


@dataclass(frozen=True)
class PlatePoint:
    """A point of the receiving plate; its gap is what an exact probe there would read along Z of R.

    Attributes:
        x: Along X of R [m].
        y: Along Y of R [m].

    """

    x: float
    y: float

    @property
    def name(self) -> str:
        """What the gap there is called."""
        return f"gap at ({1e3 * self.x:g}, {1e3 * self.y:g}) mm"


@dataclass(frozen=True)
class Output:
    """One quantity that is judged: its name, and its unit, ``m`` or ``rad``."""

    name: str
    unit: str


class Outputs:
    """The judged quantities of a stack as functions of the pose and of the parameters.

    The surface whose gap is judged is the target plane that the stack's gap probes see; without any, the plane Z = 0 of
    T.
    """

    def __init__(self, stack: Stack, points: Sequence[PlatePoint]) -> None:
        """Lay out the native coordinates and the points."""
        self.named = (
            *(Output(name, unit) for name, unit in NATIVE),
            *(Output(point.name, "m") for point in points),
        )
        self._parameters = stack.parameters
        self._rows = np.zeros((len(points), stack.pool.rows.shape[1]))
        self._ids = np.full(self._rows.shape, -1, dtype=np.int64)
        seen = np.flatnonzero(stack.pool.kinds == GAP)
        for row, ids, point in zip(self._rows, self._ids, points, strict=True):
            if seen.size:
                row[6:11] = stack.pool.rows[seen[0], 6:11]
                ids[6:11] = stack.pool.ids[seen[0], 6:11]
            row[:6] = point.x, point.y, 0.0, 0.0, 0.0, 1.0

    def values(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return the quantities at ``T_R_T``, shape (k,)."""
        unused = np.empty(6)
        gaps = [evaluate_row(GAP, row, rotation, translation, np.zeros(6), unused) for row in self._rows]
        return np.array([*translation, *native_from_rotation(rotation), *gaps])

    def by_motion(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return their derivatives with respect to a small motion of T in ROS order (axes of R), shape (k, 6)."""
        out = np.zeros((len(self.named), 6))
        out[:3, :3] = np.eye(3)
        out[3:6, 3:] = native_jacobian(rotation)
        for row, derivative in zip(self._rows, out[6:], strict=True):
            evaluate_row(GAP, row, rotation, translation, np.zeros(6), derivative)
        out[6:] = out[6:] @ np.kron(np.eye(2), rotation.T)
        return out

    def by_parameters(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return their derivatives with respect to the stack's parameters at a fixed pose, shape (k, p)."""
        out = np.zeros((len(self.named), self._parameters))
        derivative = np.empty(self._rows.shape[1])
        for row, ids, of_output in zip(self._rows, self._ids, out[6:], strict=True):
            row_parameters(GAP, row, rotation, translation, derivative)
            of_output[ids[ids >= 0]] += derivative[ids >= 0]
        return out
