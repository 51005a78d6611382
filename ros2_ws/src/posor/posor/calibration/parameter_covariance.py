# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Covariance of a stack's parameters as a calibration file states it, and its square root.

The file states standard uncertainties, and each fit record the covariance of the values that it replaced, with one
another and with the values that it took as known. A value replaced again later has the covariance of the later record.
All other values are independent, but for the shared terms of the file (``calibration.shared_terms``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor.calibration.parameter_entries import parameter_entries
from posor.calibration.shared_terms import effect_on

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.calibration.parameter_entries import ParameterEntry
    from posor.numerics.array_types import FloatArray, IntArray

RELATIVE_ROUNDING = 1e-12
"""Relative to the largest eigenvalue of the correlations: smaller ones, also negative, are rounding of the file."""


def stated_covariance(calibration: Calibration, session: str = "") -> FloatArray:
    """Return the covariance of a stack's parameter vector, (p, p).

    ``calibration``: the calibration, its session applied or not. ``session``: name of the session; values replaced by
    it are found there. Raises CalibrationError: the session is unknown.
    """
    entries = parameter_entries(calibration, session)
    sigmas = np.array([0.0 if e is None else float(e.quantity.sigmas[e.index]) for e in entries])
    shared = _shared_effects(calibration, entries)
    return _correlation(calibration, entries) * np.outer(sigmas, sigmas) + shared @ shared.T


def shared_effects(calibration: Calibration, session: str = "") -> FloatArray:
    """Return the change of each parameter by one standard uncertainty of each shared term, (p, terms)."""
    return _shared_effects(calibration, parameter_entries(calibration, session))


def _shared_effects(calibration: Calibration, entries: Sequence[ParameterEntry | None]) -> FloatArray:
    effects = np.zeros((len(entries), len(calibration.shared)))
    for k, term in enumerate(calibration.shared.values()):
        named = {*term.relative, *term.change}
        for own, entry in zip(effects, entries, strict=True):
            if entry is not None and entry.key in named:
                own[k] += effect_on(term, entry.key, entry.quantity.array)[entry.index]
            if entry is not None and entry.index and entry.name in named:
                own[k] += effect_on(term, entry.name, entry.quantity.array[entry.index])
    return effects


def stated_correlation(calibration: Calibration, session: str = "") -> FloatArray:
    """Return the correlations of a stack's parameter vector without shared terms, (p, p), as ``stated_covariance``."""
    return _correlation(calibration, parameter_entries(calibration, session))


def _correlation(calibration: Calibration, entries: Sequence[ParameterEntry | None]) -> FloatArray:
    position = {entry.name: i for i, entry in enumerate(entries) if entry is not None}
    correlation = np.eye(len(entries))
    for record in calibration.fits:
        replaced = np.array(
            [i for name, i in position.items() if any(is_part(name, key) for key in record.replaced)], dtype=np.int64
        )
        correlation[replaced], correlation[:, replaced] = 0.0, 0.0
        correlation[replaced, replaced] = 1.0
        for stated in record.covariances:
            present = [k for k, name in enumerate(stated.entries) if name in position]
            where = np.array([position[stated.entries[k]] for k in present], dtype=np.int64)
            covariance = stated.matrix[np.ix_(present, present)]
            scale = np.sqrt(np.diag(covariance))
            block = covariance / np.outer(scale, scale)
            own = np.isin(where, replaced)
            correlation[np.ix_(where[own], where)] = block[own]
            correlation[np.ix_(where, where[own])] = block[:, own]
    return correlation


def is_part(name: str, key: str) -> bool:
    """Return whether a key is that of another key or of a part of its entry."""
    return name == key or name.startswith((f"{key}[", f"{key}."))


def covariance_square_root(covariance: FloatArray) -> FloatArray:
    """Return R (p, r) with ``R @ R.T`` the covariance (p, p); r is the rank."""
    sigmas = np.sqrt(np.diag(covariance))
    uncertain = np.flatnonzero(sigmas > 0.0)
    if not uncertain.size:
        return np.zeros((len(sigmas), 0))
    scale = np.outer(sigmas[uncertain], sigmas[uncertain])
    values, vectors = np.linalg.eigh(covariance[np.ix_(uncertain, uncertain)] / scale)
    significant = values > RELATIVE_ROUNDING * values[-1]
    root = np.zeros((len(sigmas), int(significant.sum())))
    root[uncertain] = sigmas[uncertain, None] * vectors[:, significant] * np.sqrt(values[significant])
    return root


@dataclass(frozen=True)
class CovarianceSquareRoot:
    """Sparse square root of the parameters' covariance: each parameter as a sum of standard normal factors."""

    # for each parameter its first factor, the number of consecutive factors (zero: exact parameter), and the index of
    # its first coefficient, (p, 3)
    spans: IntArray
    coefficients: FloatArray  # coefficients of the factors, parameter after parameter, (n,)
    factor_count: int  # number of independent standard normal factors
    shared: FloatArray  # coefficients of one more factor for each shared term, (p, terms)

    @staticmethod
    def of(
        sigmas: FloatArray, correlation: FloatArray | None = None, shared: FloatArray | None = None
    ) -> CovarianceSquareRoot:
        """Return the square root for standard uncertainties (p,) and correlations (p, p); None: independent.

        ``shared``: effects of shared terms, (p, terms), see ``shared_effects``; None: there is no term.

        A parameter without correlations has one factor of its own. Each block of correlated parameters has as many
        factors as its rank.
        """
        uncertain = np.flatnonzero(sigmas > 0.0)
        spans = np.zeros((sigmas.size, 3), dtype=np.int64)
        coefficients: list[FloatArray] = [np.zeros(0)]
        factors = stored = 0
        for block in _correlated_blocks(uncertain, correlation):
            root = sigmas[block, None]
            if correlation is not None and block.size > 1:
                root = root * covariance_square_root(correlation[np.ix_(block, block)])
            count = root.shape[1]
            spans[block, 0], spans[block, 1] = factors, count
            spans[block, 2] = stored + count * np.arange(block.size)
            coefficients.append(root.ravel())
            factors, stored = factors + count, stored + root.size
        shared = np.zeros((sigmas.size, 0)) if shared is None else shared
        return CovarianceSquareRoot(spans, np.concatenate(coefficients), factors, shared)

    def dense(self) -> FloatArray:
        """Return the square root as a matrix, (p, factor_count + terms)."""
        matrix = np.zeros((len(self.spans), self.factor_count))
        for row, (first, count, begin) in zip(matrix, self.spans, strict=True):
            row[first : first + count] = self.coefficients[begin : begin + count]
        return np.hstack([matrix, self.shared])


def _correlated_blocks(parameters: IntArray, correlation: FloatArray | None) -> list[IntArray]:
    """Split parameters (k,) into blocks without correlations between them, ordered by first parameter."""
    if correlation is None:
        return list(parameters[:, None])
    linked = correlation[np.ix_(parameters, parameters)] != 0.0
    labels, previous = np.arange(parameters.size), np.empty(0, dtype=np.int64)
    while not np.array_equal(labels, previous):  # each parameter takes the smallest label among its neighbours
        labels, previous = np.where(linked, labels, parameters.size).min(axis=1, initial=parameters.size), labels
    return [parameters[labels == label] for label in np.unique(labels)]
