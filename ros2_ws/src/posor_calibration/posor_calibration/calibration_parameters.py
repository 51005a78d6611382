# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a calibration file in a stack's parameter vector: which are fitted, and which stay fixed but uncertain."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.parameter_covariance import RELATIVE_ROUNDING, covariance_square_root, stated_covariance
from posor.calibration.parameter_entries import ParameterEntry, parameter_entries
from posor.errors import FitError
from posor.estimation.sensor_stack import Stack

from posor_calibration.procedure import JointCovariance, Replacement

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray, IntArray

    from posor_calibration.least_squares import Fit

SMALLEST_CORRELATION = 1e-3  # correlation below which two numbers are written as independent
UNIT_LENGTH_TOLERANCE = 1e-6
LEAST_VARIANCE = 1e-9  # share of a variance that is at least left open, however strong the correlations in a file are
LISTED_KEYS = 12


def first_parameter(calibration: Calibration, sensor: int) -> int:
    """Return where the parameters of a sensor, by index, begin in the stack's parameter vector."""
    return sum(part.build().parameter_values.size for part in calibration.sensors[:sensor])


def parameter_indices(calibration: Calibration, sensor: int, names: Sequence[str]) -> IntArray:
    """Return where parameters of a sensor, such as ``zero_shifts[1]``, stand in the stack's vector, (k,)."""
    known = calibration.sensors[sensor].build().parameter_names
    first = first_parameter(calibration, sensor)
    return np.array([first + known.index(name) for name in names], dtype=np.int64)


def replace_values(values: FloatArray, where: IntArray, new: FloatArray) -> FloatArray:
    """Return a copy of a parameter vector with some entries replaced."""
    out = values.copy()
    out[where] = new
    return out


class FixedParameters:
    """The numbers of a calibration that a procedure does not fit: fixed, but with their stated uncertainties.

    ``root`` is the square root of their covariance in the stack's parameter vector, (p, r).
    """

    def __init__(self, calibration: Calibration, fitted: IntArray, session: str = "") -> None:
        """Select all numbers but the ``fitted`` entries of the vector; the session is not yet applied."""
        covariance = stated_covariance(calibration, session)
        covariance[fitted], covariance[:, fitted] = 0.0, 0.0
        self.root = covariance_square_root(covariance)
        self._entries = parameter_entries(calibration, session)

    def effects(self, derivatives: FloatArray) -> FloatArray:
        """Return the ``fixed_effects`` of a fit (n, r) from d(residual)/d(parameter of the stack), (n, p)."""
        return np.asarray(derivatives @ self.root)

    def joint_covariance(self, entries: tuple[str, ...], fit: Fit, basis: FloatArray | None = None) -> JointCovariance:
        """Return the covariance of fitted numbers with the keys ``entries``, (k,), and with the fixed ones.

        ``fit`` was made with ``effects``; ``basis`` is d(number)/d(parameter of the fit), (k, p), None: its first
        parameters.
        """
        basis = np.eye(len(entries), len(fit.names)) if basis is None else basis
        return self.join(entries, basis @ fit.covariance @ basis.T, basis @ fit.cross_covariance)

    def join(self, entries: tuple[str, ...], covariance: FloatArray, cross_covariance: FloatArray) -> JointCovariance:
        """Return the same from the covariance of fitted numbers (k, k), and with the standard normal factors (k, r)."""
        # The sandwich covariance of a robust fit derives from no distribution: it may exceed full correlation.
        excess = 0.0
        if cross_covariance.size:
            excess = float(np.linalg.norm(np.linalg.solve(np.linalg.cholesky(covariance), cross_covariance), 2))
        cross = cross_covariance @ self.root.T / max(1.0, excess * (1.0 + RELATIVE_ROUNDING))
        fixed = self.root @ self.root.T
        sigmas = np.sqrt(np.diag(fixed))
        scale = np.outer(np.sqrt(np.diag(covariance)), np.where(sigmas > 0.0, sigmas, np.inf))
        correlation = np.max(np.abs(cross / scale), axis=0, initial=0.0)
        related = [
            (i, entry.name) for i, entry in enumerate(self._entries) if entry and correlation[i] > SMALLEST_CORRELATION
        ]
        where = [i for i, _ in related]
        return JointCovariance(
            (*entries, *(name for _, name in related)),
            np.block([[covariance, cross[:, where]], [cross[:, where].T, fixed[np.ix_(where, where)]]]),
        )


@dataclass(frozen=True)
class _Block:
    """Free parameters of one quantity of the file."""

    entries: tuple[ParameterEntry, ...]  # the numbers that they move, (k,)
    ids: IntArray  # where these stand in the parameter vector, (k,)
    basis: FloatArray  # d(number)/d(free parameter), (k, j)
    sigmas: FloatArray  # (j,)
    names: tuple[str, ...]  # (j,)
    is_direction: bool  # the numbers are a unit vector


class FreeParameters:
    """The numbers of a calibration file that a fit may change.

    The free parameters of a unit vector (unit 1, three components, length 1) are rotations about two axes across it.
    Any other number is a free parameter itself. Numbers without uncertainty are not free.

    Attributes:
        names: Such as ``sensors[0].probes[1].tip[2]``, (q,).
        units: (q,).
        start: Present values, (q,).
        sigmas: Stated standard uncertainties, (q,).
        covariance: As stated by the calibration and its fit records, (q, q).

    """

    def __init__(
        self,
        calibration: Calibration,
        session: str = "",
        patterns: Sequence[str] = ("*",),
        excluded: Sequence[str] = (),
        first: str = "",
    ) -> None:
        """Find the free parameters of a calibration whose session is not yet applied.

        Keys of the ``patterns`` may change and those of ``excluded`` may not; ``*`` stands for anything:
        ``sensors[0].probes[*].tip``. Quantities that the session replaces are found there. Parameters whose key matches
        ``first`` come before the others. Raises FitError: a pattern matches no quantity with an uncertainty;
        CalibrationError: the session is unknown.
        """
        stack = Stack([sensor.build() for sensor in calibration.for_session(session).sensors])
        self._values, sigmas = stack.parameter_values, stack.parameter_sigmas
        found = [(entry, i) for i, entry in enumerate(parameter_entries(calibration, session)) if entry is not None]
        self._blocks: list[_Block] = []
        matched: set[str] = set()
        for key, group in groupby(sorted(found, key=lambda pair: (pair[0].key, pair[0].index)), lambda p: p[0].key):
            matching = [] if any(_matches(e, key) for e in excluded) else [p for p in patterns if _matches(p, key)]
            members = list(group)
            entries, ids = tuple(entry for entry, _ in members), np.array([i for _, i in members])
            if matching and np.any(sigmas[ids] > 0.0):
                matched.update(matching)
                self._blocks.append(_make_block(entries, ids, self._values[ids], sigmas[ids]))
        for pattern in patterns:
            if pattern not in matched:
                free = {entry.key for entry, i in found if sigmas[i] > 0.0}
                keys = sorted(key for key in free if not any(_matches(e, key) for e in excluded))
                raise FitError(
                    f"'{pattern}' matches no quantity that has an uncertainty and affects the recording",
                    where=f"calibration '{calibration.name}'",
                    expected=", ".join(keys[:LISTED_KEYS]) + (" ..." if len(keys) > LISTED_KEYS else ""),
                )
        self._blocks.sort(key=lambda block: (not _matches(first, block.entries[0].key), int(block.ids[0])))
        self.names = tuple(name for block in self._blocks for name in block.names)
        self.units = tuple(
            "rad" if b.is_direction else _unit_of(e) for b in self._blocks for e in b.entries[: len(b.names)]
        )
        self.sigmas = np.concatenate([block.sigmas for block in self._blocks])
        self.start = np.concatenate(
            [np.zeros(len(b.names)) if b.is_direction else self._values[b.ids] for b in self._blocks]
        )
        self._fixed = FixedParameters(calibration, np.zeros(0, dtype=np.int64), session)
        root = np.linalg.pinv(self.derivatives(self.start)) @ self._fixed.root
        root /= np.linalg.norm(root, axis=1, keepdims=True)
        correlations = (root @ root.T + LEAST_VARIANCE * np.eye(len(root))) / (1.0 + LEAST_VARIANCE)
        self.covariance = correlations * np.outer(self.sigmas, self.sigmas)

    def __len__(self) -> int:
        return len(self.names)

    def parameter_vector(self, free: FloatArray) -> FloatArray:
        """Return the stack's parameter vector (p,) for free parameters (q,)."""
        out = self._values.copy()
        for block, part in self._split(free):
            if block.is_direction:
                rotated = out[block.ids] + block.basis @ part
                out[block.ids] = rotated / np.linalg.norm(rotated)
            else:
                out[block.ids] = part
        return out

    def derivatives(self, free: FloatArray) -> FloatArray:
        """Return d(parameter vector)/d(free parameters), (p, q)."""
        out = np.zeros((self._values.size, len(self)))
        first = 0
        for block, part in self._split(free):
            columns = slice(first, first + len(part))
            inner = block.basis
            if block.is_direction:
                rotated = self._values[block.ids] + inner @ part
                length = np.linalg.norm(rotated)
                inner = (inner - np.outer(rotated, rotated @ inner) / length**2) / length
            out[block.ids, columns] = inner
            first = columns.stop
        return out

    def file_changes(self, free: FloatArray, covariance: FloatArray) -> tuple[list[Replacement], JointCovariance]:
        """Return the changes to the calibration file for free parameters (q,) with a covariance (q, q)."""
        values, derivatives = self.parameter_vector(free), self.derivatives(free)
        replacements, ids, names = [], [], []
        for block in self._blocks:
            quantity, own = block.entries[0].quantity, derivatives[block.ids]
            sigmas = np.sqrt(np.einsum("ij,jk,ik->i", own, covariance, own))
            new_values, new_sigmas = quantity.array.copy(), quantity.sigmas.copy()
            for entry, where, sigma in zip(block.entries, block.ids, sigmas, strict=True):
                new_values[entry.index], new_sigmas[entry.index] = values[where], sigma
                if sigma > 0.0:
                    ids.append(where)
                    names.append(entry.name)
            replacements.append(Replacement(block.entries[0].key, new_values.tolist(), new_sigmas.tolist()))
        changed = derivatives[ids]
        return replacements, JointCovariance(tuple(names), changed @ covariance @ changed.T)

    def joint_covariance(self, covariance: FloatArray, count: int) -> JointCovariance:
        """Return the covariance of the first ``count`` parameters after a fit, and with the others, which stay fixed.

        ``covariance`` (q, q) is of all free parameters after the fit; each of the first is a number of the file.
        """
        derivatives = self.derivatives(self.start)
        cross = covariance[:count, count:] @ derivatives[:, count:].T @ np.linalg.pinv(self._fixed.root).T
        return self._fixed.join(self.names[:count], covariance[:count, :count], cross)

    def _split(self, free: FloatArray) -> list[tuple[_Block, FloatArray]]:
        ends = np.cumsum([len(block.names) for block in self._blocks])
        return list(zip(self._blocks, np.split(free, ends[:-1]), strict=True))


def _matches(pattern: str, key: str) -> bool:
    """Return whether a key fits a pattern in which ``*`` is anything, and ``[1]`` is literal unlike in ``fnmatch``."""
    return re.fullmatch(".*".join(re.escape(part) for part in pattern.split("*")), key) is not None


def _unit_of(entry: ParameterEntry) -> str:
    unit = entry.quantity.unit
    return unit.replace("^k", f"^{entry.index[-1]}") if entry.index else unit


def _make_block(entries: tuple[ParameterEntry, ...], ids: IntArray, values: FloatArray, sigmas: FloatArray) -> _Block:
    quantity = entries[0].quantity
    unit_length = abs(float(np.linalg.norm(values)) - 1.0) <= UNIT_LENGTH_TOLERANCE
    if quantity.unit == "1" and quantity.array.shape == (3,) and unit_length:
        across = np.linalg.svd(values[None, :])[2][1:].T
        squares, mixed = np.linalg.eigh(across.T @ (sigmas[:, None] ** 2 * across))
        uncertain = squares > 1e-12 * squares[-1]
        names = tuple(f"{entries[0].key} rotation {i + 1}" for i in range(int(uncertain.sum())))
        return _Block(
            entries, ids, (across @ mixed)[:, uncertain], np.sqrt(squares[uncertain]), names, is_direction=True
        )
    free = np.flatnonzero(sigmas > 0.0)
    members = tuple(entries[i] for i in free)
    names = tuple(entry.name for entry in members)
    return _Block(members, ids[free], np.eye(len(free)), sigmas[free], names, is_direction=False)
