"""What a calibration file says of how its numbers vary together: standard uncertainties, and the fits' covariances.

Each fit record states the covariance of what it replaced, and of that with what it took for known. What a later record
replaces, that record states; what none states is independent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.calibrate.entries import entries_of
from posor_estimator.core.calibrate.replacement import JointCovariance

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray, IntArray

ROUNDING = 1e-12
"""Of the largest eigenvalue of the correlations: smaller ones, negative too, come from the digits written."""
TOGETHER = 1e-3
"""Correlation below which two numbers are taken for independent in a file."""


def stated_covariance(calibration: Calibration, session: str = "") -> FloatArray:
    """Return the covariance of a stack's parameter vector, (p, p).

    Args:
        calibration: The calibration, its session not yet applied.
        session: The session that holds; what it replaces is found there.

    Raises:
        CalibrationError: There is no such session.

    """
    entries = entries_of(calibration, session)
    sigmas = np.array([0.0 if e is None else float(e.quantity.sigmas[e.index]) for e in entries])
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
    return correlation * np.outer(sigmas, sigmas)


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


class Taken:
    """What a procedure takes for known of a calibration: all numbers but those that it finds.

    Attributes:
        root: Square root of their covariance in the stack's parameter vector, (p, r).

    """

    def __init__(self, calibration: Calibration, found: IntArray, session: str = "") -> None:
        """Take the numbers of a calibration, its session not yet applied, but for entries ``found`` of its vector."""
        covariance = stated_covariance(calibration, session)
        covariance[found], covariance[:, found] = 0.0, 0.0
        self.root = root_of(covariance)
        self._entries = entries_of(calibration, session)

    def effects(self, derivatives: FloatArray) -> FloatArray:
        """Return what ``fit`` wants of d(residual)/d(parameter), (n, p): by standard normal deviates, (n, r)."""
        return np.asarray(derivatives @ self.root)

    def joint(self, entries: tuple[str, ...], fit: Fit, basis: FloatArray | None = None) -> JointCovariance:
        """Return how what was found varies together, and with what was taken for known.

        Args:
            entries: Key of each number that was found, (k,).
            fit: Given the ``effects``; its first parameters are these numbers.
            basis: d(number)/d(parameter of the fit), (k, p), where they are not.

        """
        basis = np.eye(len(entries), len(fit.names)) if basis is None else basis
        return self.beside(entries, basis @ fit.covariance @ basis.T, basis @ fit.across)

    def beside(self, entries: tuple[str, ...], own: FloatArray, across: FloatArray) -> JointCovariance:
        """Return the same from the covariance of what was found (k, k), and with the standard deviates (k, r)."""
        # A robust fit's covariance is derived from no distribution: it may claim more correlation than there can be.
        most = float(np.linalg.norm(np.linalg.solve(np.linalg.cholesky(own), across), 2)) if across.size else 0.0
        pushed = across @ self.root.T / max(1.0, most * (1.0 + ROUNDING))
        taken = self.root @ self.root.T
        sigmas = np.sqrt(np.diag(taken))
        scale = np.outer(np.sqrt(np.diag(own)), np.where(sigmas > 0.0, sigmas, np.inf))
        likeness = np.max(np.abs(pushed / scale), axis=0, initial=0.0)
        near = [(i, entry.name) for i, entry in enumerate(self._entries) if entry and likeness[i] > TOGETHER]
        where = [i for i, _ in near]
        return JointCovariance(
            (*entries, *(name for _, name in near)),
            np.block([[own, pushed[:, where]], [pushed[:, where].T, taken[np.ix_(where, where)]]]),
        )
