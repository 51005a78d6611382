"""What a calibration file says of how its numbers vary together: standard uncertainties, and the fits' covariances.

Each fit record states the covariance of what it replaced, and of that with what it took for known. What a later record
replaces, that record states; what none states is independent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.calibration.entries import entries_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.calibration.entries import Entry
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

ROUNDING = 1e-12
"""Of the largest eigenvalue of the correlations: smaller ones, negative too, come from the digits written."""


def stated_covariance(calibration: Calibration, session: str = "") -> FloatArray:
    """Return the covariance of a stack's parameter vector, (p, p).

    Args:
        calibration: The calibration, its session applied or not.
        session: The session that holds; what it replaces is found there.

    Raises:
        CalibrationError: There is no such session.

    """
    entries = entries_of(calibration, session)
    sigmas = np.array([0.0 if e is None else float(e.quantity.sigmas[e.index]) for e in entries])
    return _correlation(calibration, entries) * np.outer(sigmas, sigmas)


def stated_correlation(calibration: Calibration, session: str = "") -> FloatArray:
    """Return the correlations of a stack's parameter vector, (p, p), likewise; what no file gives has none."""
    return _correlation(calibration, entries_of(calibration, session))


def _correlation(calibration: Calibration, entries: Sequence[Entry | None]) -> FloatArray:
    names = {entry.name: i for i, entry in enumerate(entries) if entry is not None}
    correlation = np.eye(len(entries))
    for record in calibration.fits:
        replaced = np.array(
            [i for name, i in names.items() if any(_is_part(name, key) for key in record.replaced)], dtype=np.int64
        )
        correlation[replaced], correlation[:, replaced] = 0.0, 0.0
        correlation[replaced, replaced] = 1.0
        for joint in record.covariances:
            known = [k for k, name in enumerate(joint.entries) if name in names]
            where = np.array([names[joint.entries[k]] for k in known], dtype=np.int64)
            matrix = joint.matrix[np.ix_(known, known)]
            scale = np.sqrt(np.diag(matrix))
            own = np.isin(where, replaced)
            told = matrix / np.outer(scale, scale)
            correlation[np.ix_(where[own], where)] = told[own]
            correlation[np.ix_(where, where[own])] = told[:, own]
    return correlation


def _is_part(name: str, key: str) -> bool:
    return name == key or name.startswith((f"{key}[", f"{key}."))


def root_of(covariance: FloatArray) -> FloatArray:
    """Return a square root (p, r) of a covariance (p, p), of as many columns as it has directions."""
    sigmas = np.sqrt(np.diag(covariance))
    known = np.flatnonzero(sigmas > 0.0)
    if not known.size:
        return np.zeros((len(sigmas), 0))
    values, vectors = np.linalg.eigh(covariance[np.ix_(known, known)] / np.outer(sigmas[known], sigmas[known]))
    kept = values > ROUNDING * values[-1]
    root = np.zeros((len(sigmas), int(kept.sum())))
    root[known] = sigmas[known, None] * vectors[:, kept] * np.sqrt(values[kept])
    return root
