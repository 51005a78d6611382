# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reliability of a POSOR after Baarda: which faults are detected at a pose, and the effect of those that are not.

The estimator tests the redundant readings by one chi-square (``estimation.scan_checks``). An error b of a single
reading makes it non-central, lambda = c b^2 with c of ``ReadingSensitivity.chi_square``. lambda_0 is the lambda at
which the non-central chi-square with r degrees of freedom, the number of redundant readings, is below the limit of the
test with the probability ``missed_detection``. Hence

    minimal detectable bias  b = sqrt(lambda_0 / c),    undetected shift of the pose  G b,

G the estimator's gain. If no other reading checks a reading, its redundancy number and c are zero up to rounding, and
its bias is not detectable. Beside the single readings, ``effects`` are those of all causes of faults of the calibration
(``estimation.fault_effects``).

Source: W. Baarda, *A testing procedure for use in geodetic networks*, Delft 1968 (internal and external reliability).
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor.chain.fault_bounds import SMALLEST, largest_of_pair
from posor.estimation.fault_effects import LEAST_SHOWN_SHARE, MISSED_DETECTION
from posor.estimation.fault_model import SECOND
from posor.model.native_coordinates import native_from_rotation
from posor.model.scan import Scans
from posor.numerics.array_types import freeze_arrays
from posor.uncertainty.first_order import check_place, require_determined
from posor.uncertainty.reading_sensitivity import sensitivity_at

if TYPE_CHECKING:
    import pinocchio as pin
    from numpy.typing import NDArray

    from posor.estimation.fault_hypotheses import Hypotheses
    from posor.estimation.posor import Posor
    from posor.model.scan import Scan
    from posor.numerics.array_types import FloatArray

_NO_COEFFICIENT = 1e-9  # coefficients below this share of the largest are rounding errors of zero


@dataclass(frozen=True, repr=False)
class Reliability:
    """Reliability of the m linearised readings of a POSOR at one pose; the arrays are read-only.

    Attributes:
        names: Of the readings.
        redundancy_numbers: Share of a reading's error that its own residual shows, (m,), from 0 to 1; their sum is the
            number of redundant readings.
        biases: Minimal detectable bias of each reading [m], (m,); infinite: not detectable.
        gains: Change of the pose by one metre of bias, (m, 6), ROS order, axes of R [m/m, rad/m].
        shifts: Change of the pose by the minimal detectable bias, (m, 6) [m, rad]; infinite: not bounded.
        false_alarm: Probability that the test rejects a sound scan, see ``Posor``.
        missed_detection: Probability that the test passes a bias of the minimal detectable size.
        hypotheses: The causes of faults, and what they move.
        effects: What each of the hypotheses may do to the pose unseen, (C, 7), see ``estimation.fault_effects``.

    """

    names: tuple[str, ...]
    redundancy_numbers: FloatArray
    biases: FloatArray
    gains: FloatArray
    shifts: FloatArray
    false_alarm: float
    missed_detection: float
    hypotheses: Hypotheses
    effects: NDArray[np.float32]

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def cause_effects(self) -> dict[str, FloatArray]:
        """Return the largest undetected change of the pose by each cause, (6,), ROS order; infinite: not bounded."""
        largest = {cause.name: np.zeros(6) for cause in self.hypotheses.causes}
        columns, effects = self.hypotheses.model.columns, self.effects.astype(float)
        sizes = np.abs(effects[:, :6])
        tiny = SMALLEST * sizes.max(axis=1, keepdims=True)
        sizes = np.where(np.isinf(effects[:, 6:]), np.where(sizes > tiny, math.inf, 0.0), sizes)
        for c, number in enumerate(self.hypotheses.of_columns):
            own = sizes[c]
            if columns[c]["kind"] & SECOND:
                cuts = effects[c - 1 : c + 1, 6].tolist()
                pairs = zip(sizes[c - 1].tolist(), sizes[c].tolist(), strict=True)
                if max(cuts) < math.inf:
                    own = np.array([largest_of_pair(one, other, *cuts) for one, other in pairs])
            name = self.hypotheses.causes[number].name
            largest[name] = np.maximum(largest[name], own)
        return largest

    def __repr__(self) -> str:
        """Return the number of readings, and how many of them are not checked."""
        unchecked = int(np.count_nonzero(np.isinf(self.biases)))
        return f"<Reliability of {len(self.names)} readings, {unchecked} without a detectable bias>"


def joint_reliability(posor: Posor, scan: Scan, T_R_T: pin.SE3) -> Reliability:
    """Return the reliability of a POSOR at a pose.

    Args:
        posor: The POSOR, whose limit of chi-square sets the probability of a false alarm.
        scan: A valid scan at the pose.
        T_R_T: The pose.

    Raises:
        ParameterError: An argument has the wrong type.
        ScanError: A reading of the scan is invalid.
        FitError: The readings do not determine all six freedoms at this pose.

    """
    check_place(posor, T_R_T, "joint_reliability")
    require_determined(posor.stack, posor.stack.linearise(Scans.of([scan])), T_R_T)
    sensitivity = sensitivity_at(posor, scan, T_R_T)
    root = float(posor.settings["noncentrality_root"])
    gains, biases = sensitivity.gain.T, np.full(len(sensitivity.gain.T), math.inf)
    checked = sensitivity.redundancy_numbers > LEAST_SHOWN_SHARE
    biases[checked] = root / np.sqrt(sensitivity.chi_square[checked])
    other = copy.deepcopy(posor)
    other.settings["residual_limit"] = math.inf
    theta = native_from_rotation(T_R_T.rotation)[2]
    estimates = other.estimate_each(Scans.of([scan]), np.array([theta]), fault_effects=True)
    return Reliability(
        names=posor.stack.reading_names,
        redundancy_numbers=sensitivity.redundancy_numbers,
        biases=biases,
        gains=gains,
        shifts=_shifts(gains, biases),
        false_alarm=posor.false_alarm,
        missed_detection=MISSED_DETECTION,
        hypotheses=posor.hypotheses,
        effects=estimates.fault_effects[0],
    )


def _shifts(gains: FloatArray, biases: FloatArray) -> FloatArray:
    """Return the change of the pose by each bias, (m, 6); infinite ones act only through gains that are not zero."""
    magnitudes, finite = np.abs(gains), np.isfinite(biases)[:, None]
    unbounded = ~finite & (magnitudes > _NO_COEFFICIENT * magnitudes.max(axis=1, keepdims=True))
    return np.where(unbounded, math.inf, gains * np.where(finite, biases[:, None], 0.0))
