"""What a procedure takes for known of a calibration, and how what it finds varies together with that."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.calibrate.replacement import JointCovariance
from posor_estimator.core.calibration.entries import entries_of
from posor_estimator.core.calibration.stated import ROUNDING, root_of, stated_covariance

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray, IntArray

TOGETHER = 1e-3
"""Correlation below which two numbers are taken for independent in a file."""


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
