"""Reliability of a POSOR after Baarda: which error of a single reading is detected, and the effect of smaller ones.

The estimator tests the redundant readings by one chi-square (``estimation.scan_checks``). An error b of a single
reading makes it non-central, lambda = c b^2 with c of ``ReadingSensitivity.chi_square``. lambda_0 is the lambda at
which the non-central chi-square with r degrees of freedom, the number of redundant readings, is below the limit of the
test with the probability ``missed_detection``. Hence

    minimal detectable bias  b = sqrt(lambda_0 / c),    undetected shift of the pose  G b,

G the estimator's gain. If no other reading checks a reading, its redundancy number and c are zero up to rounding, and
its bias is not detectable.

Source: W. Baarda, *A testing procedure for use in geodetic networks*, Delft 1968 (internal and external reliability).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import chdtrc, chndtrinc

from posor.errors import check_probability
from posor.model.scan import Scans
from posor.numerics.array_types import freeze_arrays
from posor.uncertainty.first_order import check_place, require_determined
from posor.uncertainty.reading_sensitivity import sensitivity_at

if TYPE_CHECKING:
    import pinocchio as pin

    from posor.estimation.posor import Posor
    from posor.model.scan import Scan
    from posor.numerics.array_types import FloatArray
    from posor.uncertainty.reading_sensitivity import ReadingSensitivity

MISSED_DETECTION = 1e-2  # probability that a bias of the minimal detectable size passes the test of one scan
UNCHECKED = 1e-4  # a reading with a smaller redundancy number is not checked: biases of hundreds of sigmas would pass
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
        false_alarm: Probability that the test rejects a sound scan.
        missed_detection: Probability that the test passes a bias of the minimal detectable size.

    """

    names: tuple[str, ...]
    redundancy_numbers: FloatArray
    biases: FloatArray
    gains: FloatArray
    shifts: FloatArray
    false_alarm: float
    missed_detection: float

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        freeze_arrays(self)

    def __repr__(self) -> str:
        """Return the number of readings, and how many of them are not checked."""
        unchecked = int(np.count_nonzero(np.isinf(self.biases)))
        return f"<Reliability of {len(self.names)} readings, {unchecked} without a detectable bias>"


def joint_reliability(
    posor: Posor, scan: Scan, T_R_T: pin.SE3, missed_detection: float = MISSED_DETECTION
) -> Reliability:
    """Return the reliability of a POSOR at a pose.

    Args:
        posor: The POSOR, whose limit of chi-square sets the probability of a false alarm.
        scan: A valid scan at the pose; its readings are used for their sensitivities only.
        T_R_T: The pose.
        missed_detection: Probability that a bias of the minimal detectable size is missed, between 0 and 1.

    Raises:
        ParameterError: ``missed_detection`` is not a probability, or an argument has the wrong type.
        ScanError: A reading of the scan is invalid.
        FitError: The readings do not determine all six freedoms at this pose.

    """
    check_place(posor, T_R_T, "joint_reliability")
    check_probability(missed_detection, "joint_reliability, missed_detection")
    require_determined(posor.stack, posor.stack.linearise(Scans.of([scan])), T_R_T)
    return reliability(posor, sensitivity_at(posor, scan, T_R_T), missed_detection)


def reliability(
    posor: Posor, sensitivity: ReadingSensitivity, missed_detection: float = MISSED_DETECTION
) -> Reliability:
    """Return the reliability of a POSOR from its sensitivity; arguments as ``joint_reliability``."""
    false_alarm, root = 0.0, math.inf
    if math.isfinite(posor.residual_limit):
        false_alarm = float(chdtrc(posor.redundancy, posor.residual_limit))
        root = math.sqrt(noncentrality(posor.redundancy, posor.residual_limit, missed_detection))
    gains, biases = sensitivity.gain.T, np.full(len(sensitivity.gain.T), math.inf)
    checked = sensitivity.redundancy_numbers > UNCHECKED
    biases[checked] = root / np.sqrt(sensitivity.chi_square[checked])
    return Reliability(
        names=posor.stack.reading_names,
        redundancy_numbers=sensitivity.redundancy_numbers,
        biases=biases,
        gains=gains,
        shifts=_shifts(gains, biases),
        false_alarm=false_alarm,
        missed_detection=missed_detection,
    )


def _shifts(gains: FloatArray, biases: FloatArray) -> FloatArray:
    """Return the change of the pose by each bias, (m, 6); infinite ones act only through gains that are not zero."""
    magnitudes, finite = np.abs(gains), np.isfinite(biases)[:, None]
    unbounded = ~finite & (magnitudes > _NO_COEFFICIENT * magnitudes.max(axis=1, keepdims=True))
    return np.where(unbounded, math.inf, gains * np.where(finite, biases[:, None], 0.0))


@lru_cache
def noncentrality(redundant: int, limit: float, missed_detection: float) -> float:
    """Return the non-centrality at which chi-square of ``redundant`` degrees of freedom passes a limit that rarely."""
    return float(chndtrinc(limit, redundant, missed_detection))


def transformed(matrix: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return ``matrix @ v`` of each vector v, (..., n); infinite components act only through coefficients not zero."""
    finite = np.isfinite(vectors)
    products = np.where(finite, vectors, 0.0) @ matrix.T
    unbounded = ~finite @ (np.abs(matrix) > _NO_COEFFICIENT * np.abs(matrix).max(initial=0.0)).T
    return np.where(unbounded, math.inf, products)
