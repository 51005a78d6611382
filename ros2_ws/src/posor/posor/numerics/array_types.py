# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Array types of the core, and arrays of callers. Shapes, units and frames stand in each function's docstring."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from posor.errors import ParameterError

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
ByteArray: TypeAlias = NDArray[np.uint8]
WordArray: TypeAlias = NDArray[np.int32]
BoolArray: TypeAlias = NDArray[np.bool_]
LongArray: TypeAlias = NDArray[np.uint64]


def refuse_masked(given: object, name: str, where: str) -> None:
    """Raise ParameterError if an array of a caller, or one in a list, has masked entries: their values are invalid."""
    for each in given if isinstance(given, list | tuple) else (given,):
        if isinstance(each, np.ma.MaskedArray) and np.ma.is_masked(each):
            what = f"{name} has {np.count_nonzero(np.ma.getmaskarray(each))} masked entries"
            raise ParameterError(what, where=where, expected="no masked entries, but NaN for a missing quantity")


def array_of_caller(given: object, name: str, where: str, *, whole: bool = False) -> NDArray[Any]:
    """Return an array-like argument of a public function as an array of real numbers; ``whole``: of whole numbers.

    Raises ParameterError: other contents, masked entries, or sequences of different lengths.
    """
    refuse_masked(given, name, where)
    try:
        values = np.asarray(given)
    except (TypeError, ValueError):
        values = np.empty(1, dtype=object)  # sequences of different lengths
    if values.size and values.dtype.kind not in ("iu" if whole else "iuf"):
        expected = "whole numbers" if whole else "real numbers"
        raise ParameterError(f"{name} is {type(given).__name__} of {values.dtype}", where=where, expected=expected)
    return values.astype(np.int64 if whole else np.float64, copy=False)


def freeze_arrays(result: object) -> None:
    """Replace every array that is an attribute of a result by a read-only view."""
    for name, value in list(vars(result).items()):
        if isinstance(value, np.ndarray):
            view = value.view()
            view.flags.writeable = False
            object.__setattr__(result, name, view)  # the dataclass is frozen
