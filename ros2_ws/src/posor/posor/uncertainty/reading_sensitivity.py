# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What an error of each reading does to the pose, and to the chi-square of the redundant readings."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from posor.model.scan import Scans

if TYPE_CHECKING:
    import pinocchio as pin

    from posor.estimation.posor import Posor
    from posor.model.scan import Scan
    from posor.numerics.array_types import FloatArray


class ReadingSensitivity(NamedTuple):
    """What a shift of each of the m linearised readings does."""

    gain: FloatArray  # change of the pose, (6, m), ROS order, axes of R [m/m, rad/m]
    chi_square: FloatArray  # chi-square for a square metre of shift, (m,)
    # share of a shift that the reading's own residual shows, (m,), from 0 to 1; their sum is the number of redundant
    # readings
    redundancy_numbers: FloatArray

    @classmethod
    def of(cls, gain: FloatArray, jacobian: FloatArray, rotation: FloatArray, chi_square: FloatArray) -> Self:
        """Return it from gain and derivatives of the readings in the local tangent, (m, 6) each."""
        turned = np.concatenate([rotation @ gain[:, :3].T, rotation @ gain[:, 3:].T])
        return cls(turned, chi_square, 1.0 - (jacobian * gain).sum(axis=1))


def sensitivity_at(posor: Posor, scan: Scan, T_R_T: pin.SE3) -> ReadingSensitivity:
    """Return the sensitivity at a pose; the readings of the scan are used for their variances only.

    Raises ScanError: a reading of the scan is invalid.
    """
    stack, rotation, translation = posor.stack, T_R_T.rotation, T_R_T.translation
    linearised = stack.linearise(Scans.of([scan]))
    if not linearised.valid[0]:
        raise stack.invalid_scan(scan, linearised)
    variances = linearised.variances[0]
    jacobian = stack.evaluate(linearised.selected[0], rotation, translation)[1]
    weights = 1.0 / variances
    gain = np.linalg.solve(jacobian.T @ (weights[:, None] * jacobian), (weights[:, None] * jacobian).T)
    parameters = stack.residual_jacobian(scan, rotation, translation) @ posor.parameter_square_root
    spreads = np.where(np.isnan([scan.supply_voltage, scan.temperature]), posor.settings["spreads"], 0.0)
    unmeasured = posor.model.workspace[0]["sensitivities"][: stack.readings] * spreads
    systematic = parameters @ parameters.T + unmeasured @ unmeasured.T
    whole = np.linalg.inv(np.diag(variances) + systematic)
    seen = whole - whole @ jacobian @ np.linalg.solve(jacobian.T @ whole @ jacobian, jacobian.T @ whole)
    return ReadingSensitivity.of(gain.T, jacobian, rotation, np.diagonal(seen).copy())
