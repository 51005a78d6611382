"""What a fit may change of a stack's parameter vector: numbers by themselves, and directions that keep their length."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.calibrate.replacement import JointCovariance, Replacement
from posor_estimator.core.calibrate.stated import Taken
from posor_estimator.core.calibration.entries import Entry, entries_of
from posor_estimator.core.stack import Stack
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.calibration.quantity import Quantity
    from posor_estimator.core.types import FloatArray, IntArray

_UNIT_WITHIN = 1e-6
_UNKNOWN = 1e-9
"""Of a variance: what is left open at least."""
_DIRECTION = 3


@dataclass(frozen=True)
class _Block:
    """Unknowns that belong to one quantity.

    Attributes:
        entries: The numbers that they move.
        ids: Where those stand in the parameter vector, (k,).
        basis: d(number)/d(unknown), (k, j).
        is_direction: Whether the numbers keep the length 1.

    """

    entries: tuple[Entry, ...]
    ids: IntArray
    basis: FloatArray
    sigmas: FloatArray
    names: tuple[str, ...]
    is_direction: bool


class Unknowns:
    """The unknowns of a fit.

    A quantity of unit 1 with three components and the length 1 is a direction: its unknowns are turns about two axes
    across it. Every other number is an unknown itself. What the calibration says has no uncertainty is no unknown.

    Attributes:
        names: Name of each, such as ``sensors[0].probes[1].tip[2]``, (q,).
        units: Unit of each, (q,).
        start: Where they are now, (q,).
        sigmas: Standard uncertainty of each as the calibration states it, (q,).
        covariance: How they vary together, as the calibration and the records of its fits state it, (q, q).

    """

    def __init__(
        self,
        calibration: Calibration,
        session: str = "",
        patterns: Sequence[str] = ("*",),
        held: Sequence[str] = (),
        first: str = "",
    ) -> None:
        """Find the unknowns.

        Args:
            calibration: The calibration, its session not yet applied.
            session: The session that holds; what it replaces is found there.
            patterns: Keys of quantities that may change, ``*`` for anything: ``sensors[0].probes[*].tip``.
            held: Keys of quantities that stay as they are all the same.
            first: Keys of unknowns that come before the others.

        Raises:
            FitError: A pattern fits no quantity with an uncertainty.
            CalibrationError: There is no such session.

        """
        stack = Stack([sensor.build() for sensor in calibration.for_session(session).sensors])
        self._values, sigmas = stack.parameter_values, stack.parameter_sigmas
        known = entries_of(calibration, session)
        found = [(entry, i) for i, entry in enumerate(known) if entry is not None]
        self._blocks: list[_Block] = []
        matched: set[str] = set()
        for key, group in groupby(sorted(found, key=lambda pair: (pair[0].key, pair[0].index)), lambda p: p[0].key):
            fitting = [] if any(_fits(h, key) for h in held) else [p for p in patterns if _fits(p, key)]
            members = list(group)
            entries, ids = tuple(entry for entry, _ in members), np.array([i for _, i in members])
            if fitting and np.any(sigmas[ids] > 0.0):
                matched.update(fitting)
                self._blocks.append(_block(entries, ids, self._values[ids], sigmas[ids]))
        for pattern in patterns:
            if pattern not in matched:
                free = (entry.key for entry, i in found if sigmas[i] > 0.0)
                keys = sorted({key for key in free if not any(_fits(h, key) for h in held)})
                raise FitError(
                    f"'{pattern}' fits no quantity that has an uncertainty and that the recording depends on",
                    where=f"calibration '{calibration.name}'",
                    expected=", ".join(keys[:12]) + (" ..." if len(keys) > 12 else ""),  # noqa: PLR2004  a line full
                )
        self._blocks.sort(key=lambda block: (not _fits(first, block.entries[0].key), int(block.ids[0])))
        self.names = tuple(name for block in self._blocks for name in block.names)
        self.units = tuple(
            "rad" if b.is_direction else _unit(e) for b in self._blocks for e in b.entries[: len(b.names)]
        )
        self.sigmas = np.concatenate([block.sigmas for block in self._blocks])
        self.start = np.concatenate(
            [np.zeros(2)[: len(b.names)] if b.is_direction else self._values[b.ids] for b in self._blocks]
        )
        self._taken = Taken(calibration, np.zeros(0, dtype=np.int64), session)
        own = np.linalg.pinv(self.basis(self.start)) @ self._taken.root
        own /= np.linalg.norm(own, axis=1, keepdims=True)
        # No combination is known exactly, whatever the digits of a file make of strong correlations.
        correlations = (own @ own.T + _UNKNOWN * np.eye(len(own))) / (1.0 + _UNKNOWN)
        self.covariance = correlations * np.outer(self.sigmas, self.sigmas)

    def __len__(self) -> int:
        """Return the number of unknowns."""
        return len(self.names)

    def beside(self, covariance: FloatArray, count: int) -> JointCovariance:
        """Return how the first unknowns, that were found, vary together and with the others, that stay as they were.

        Args:
            covariance: Of all unknowns after the fit, (q, q).
            count: How many were found; each is a number by itself.

        """
        basis = self.basis(self.start)
        across = covariance[:count, count:] @ basis[:, count:].T @ np.linalg.pinv(self._taken.root).T
        return self._taken.beside(self.names[:count], covariance[:count, :count], across)

    def values(self, unknowns: FloatArray) -> FloatArray:
        """Return the stack's parameter vector for unknowns (q,), (p,)."""
        out = self._values.copy()
        for block, part in self._parts(unknowns):
            if block.is_direction:
                turned = out[block.ids] + block.basis @ part
                out[block.ids] = turned / np.linalg.norm(turned)
            else:
                out[block.ids] = part
        return out

    def basis(self, unknowns: FloatArray) -> FloatArray:
        """Return d(parameter vector)/d(unknowns), (p, q)."""
        out = np.zeros((self._values.size, len(self)))
        first = 0
        for block, part in self._parts(unknowns):
            columns = slice(first, first + len(part))
            inner = block.basis
            if block.is_direction:
                turned = self._values[block.ids] + inner @ part
                length = np.linalg.norm(turned)
                inner = (inner - np.outer(turned, turned @ inner) / length**2) / length
            out[block.ids, columns] = inner
            first = columns.stop
        return out

    def result(self, unknowns: FloatArray, covariance: FloatArray) -> tuple[list[Replacement], JointCovariance]:
        """Return what unknowns (q,) with a covariance (q, q) make of the calibration file."""
        values, basis = self.values(unknowns), self.basis(unknowns)
        replacements, ids, names = [], [], []
        for block in self._blocks:
            quantity = block.entries[0].quantity
            of_block = basis[block.ids]
            sigmas = np.sqrt(np.einsum("ij,jk,ik->i", of_block, covariance, of_block))
            replacements.append(
                Replacement(
                    block.entries[0].key,
                    _filled(quantity.array, block.entries, values[block.ids]),
                    _filled(quantity.sigmas, block.entries, sigmas),
                )
            )
            for entry, where, sigma in zip(block.entries, block.ids, sigmas, strict=True):
                if sigma > 0.0:
                    ids.append(where)
                    names.append(entry.name)
        pushed = basis[ids]
        return replacements, JointCovariance(tuple(names), pushed @ covariance @ pushed.T)

    def _parts(self, unknowns: FloatArray) -> list[tuple[_Block, FloatArray]]:
        ends = np.cumsum([len(block.names) for block in self._blocks])
        return list(zip(self._blocks, np.split(unknowns, ends[:-1]), strict=True))


def _fits(pattern: str, key: str) -> bool:
    return re.fullmatch(".*".join(re.escape(part) for part in pattern.split("*")), key) is not None


def _unit(entry: Entry) -> str:
    unit = entry.quantity.unit
    return unit.replace("^k", f"^{entry.index[-1]}") if entry.index else unit


def _block(entries: tuple[Entry, ...], ids: IntArray, values: FloatArray, sigmas: FloatArray) -> _Block:
    quantity: Quantity = entries[0].quantity
    unit_length = abs(float(np.linalg.norm(values)) - 1.0) <= _UNIT_WITHIN
    if quantity.unit == "1" and quantity.array.shape == (_DIRECTION,) and unit_length:
        across = np.linalg.svd(values[None, :])[2][1:].T
        squares, mixed = np.linalg.eigh(across.T @ (sigmas[:, None] ** 2 * across))
        told = squares > 1e-12 * squares[-1]
        return _Block(
            entries,
            ids,
            (across @ mixed)[:, told],
            np.sqrt(squares[told]),
            tuple(f"{entries[0].key} turn {i + 1}" for i in range(int(told.sum()))),
            is_direction=True,
        )
    free = np.flatnonzero(sigmas > 0.0)
    kept = tuple(entries[i] for i in free)
    names = tuple(entry.name for entry in kept)
    return _Block(kept, ids[free], np.eye(len(free)), sigmas[free], names, is_direction=False)


def _filled(
    array: FloatArray, entries: tuple[Entry, ...], numbers: FloatArray
) -> float | list[float] | list[list[float]]:
    """Return an array of a quantity with some components replaced, as nested lists."""
    out = array.copy()
    for entry, number in zip(entries, numbers, strict=True):
        out[entry.index] = number
    filled: float | list[float] | list[list[float]] = out.tolist()
    return filled
