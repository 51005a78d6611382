# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading rows from plain lists of parameters, for the tests of the measurement model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.model.reading_rows import RING, ROW, differentiate_rows, evaluate_rows, prepare_rows
from posor.numerics.compiled import record_view

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt
    import pinocchio as pin
    from posor.numerics.array_types import FloatArray

RING_FIXED = 8  # parameters of a ring probe before its harmonics: tip, axis, mean radius, number of harmonics


def make_rows(kinds: Sequence[int], parameters: Sequence[npt.ArrayLike]) -> npt.NDArray[np.void]:
    """Return prepared rows, shape (m,); the harmonics of a ring probe are given as k, cosine, sine each."""
    rows = np.zeros(len(kinds), dtype=ROW)
    rows["kind"] = kinds
    for row, kind, given in zip(rows, kinds, parameters, strict=True):
        numbers = np.asarray(given, dtype=float)
        if kind == RING:
            harmonics = numbers[RING_FIXED:].reshape(-1, 3)
            for name, column in zip(("orders", "cosines", "sines"), harmonics.T, strict=True):
                row[name][: len(harmonics)] = column
            numbers = numbers[:RING_FIXED]
        row["parameters"][: len(numbers)] = numbers
    prepare_rows(record_view(rows))
    return rows


def read_row(kind: int, parameters: npt.ArrayLike, pose: pin.SE3) -> float:
    """Return what a row reads at a pose."""
    return float(evaluate_rows(make_rows([kind], [parameters]), pose.rotation, pose.translation)[0][0])


def tangent_derivative(kind: int, parameters: npt.ArrayLike, pose: pin.SE3) -> FloatArray:
    """Return the derivative of a row's reading with respect to the local tangent, shape (6,)."""
    derivative: FloatArray = evaluate_rows(make_rows([kind], [parameters]), pose.rotation, pose.translation)[1][0]
    return derivative


def parameter_derivatives(kind: int, parameters: npt.ArrayLike, pose: pin.SE3) -> FloatArray:
    """Return the derivatives of a row's reading with respect to its parameters, in the order of ``parameters``."""
    size = np.size(parameters)
    rows = make_rows([kind], [parameters])
    found = differentiate_rows(rows, pose.rotation, pose.translation)[0]
    if kind != RING:
        return np.asarray(found[:size])
    record = np.zeros(1, dtype=ROW)
    record["parameters"] = found
    count = (size - RING_FIXED) // 3
    harmonics = np.column_stack([record[name][0, :count] for name in ("orders", "cosines", "sines")])
    return np.concatenate([found[:RING_FIXED], harmonics.ravel()])
