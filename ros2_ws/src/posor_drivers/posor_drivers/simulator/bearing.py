"""Error motions of a bearing: what its axis does as it turns, beside turning."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_drivers.simulator.poses import Poses

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray

    from posor_drivers.simulator.scenario import Bearing


def error_motions(bearing: Bearing, angles: FloatArray, random: np.random.Generator) -> Poses:
    """Return the error motions at joint angles [rad], (n,), in the axes of the bearing's fixed side.

    With k an order of the turn and phi, psi, chi phases drawn once:

        x, y      radial_k (cos, sin)(k theta + phi_k)
        z         axial_k cos(k theta + psi_k)
        about X,Y tilt_k (cos, sin)(k theta + chi_k)

    summed over the orders.
    """
    orders = np.array(bearing.orders, dtype=float)
    phases = random.uniform(0.0, 2.0 * np.pi, size=(3, len(orders)))
    radial, axial, tilt = (angles[:, None] * orders + of_kind for of_kind in phases)
    translations = np.column_stack(
        [
            np.cos(radial) @ bearing.radial.array,
            np.sin(radial) @ bearing.radial.array,
            np.cos(axial) @ bearing.axial.array,
        ]
    )
    leans = np.column_stack(
        [np.cos(tilt) @ bearing.tilt.array, np.sin(tilt) @ bearing.tilt.array, np.zeros(len(angles))]
    )
    return Poses.motions(translations, leans)
