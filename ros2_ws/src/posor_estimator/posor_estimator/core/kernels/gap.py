"""Gap probe: distance along the probe's axis to the target plane.

Thesis 5.3.1 (equation 5.3, exact here): with the tip ``o`` and the axis ``a`` seen from T, the plane through ``q`` with
normal ``m`` is met at the distance ``g = m.(q - o) / (m.a)``.

Row parameters (12): tip in R [m] 0:3, axis in R 3:6, plane point in T [m] 6:9, plane normal in T 9:12. Neither the axis
nor the normal need be of unit length for the derivatives to hold; with a unit axis the reading is in metres.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled
from posor_estimator.core.kernels.vector import cross, dot, rotate, rotate_back

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

PARAMETERS = 12


@compiled
def gap(row: FloatArray, rotation: FloatArray, translation: FloatArray, jacobian: FloatArray) -> float:
    """Return the gap [m] and write its derivative with respect to the local tangent into ``jacobian`` (6)."""
    tip = rotate_back(rotation, row[0:3] - translation)
    axis = rotate_back(rotation, row[3:6])
    normal = row[9:12]
    slant = dot(normal, axis)
    reading = dot(normal, row[6:9] - tip) / slant
    lever = cross(tip + reading * axis, normal)
    for i in range(3):
        jacobian[i] = normal[i] / slant
        jacobian[3 + i] = lever[i] / slant
    return reading


@compiled
def gap_parameters(row: FloatArray, rotation: FloatArray, translation: FloatArray, jacobian: FloatArray) -> None:
    """Write the derivative of the gap with respect to the row's twelve parameters into ``jacobian`` (12)."""
    tip = rotate_back(rotation, row[0:3] - translation)
    axis = rotate_back(rotation, row[3:6])
    normal = row[9:12]
    normal_R = rotate(rotation, normal)
    slant = dot(normal, axis)
    reading = dot(normal, row[6:9] - tip) / slant
    for i in range(3):
        jacobian[i] = -normal_R[i] / slant
        jacobian[3 + i] = -reading * normal_R[i] / slant
        jacobian[6 + i] = normal[i] / slant
        jacobian[9 + i] = (row[6 + i] - tip[i] - reading * axis[i]) / slant
