# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Array types of the core. Shapes, units and frames stand in each function's docstring."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
ByteArray: TypeAlias = NDArray[np.uint8]
WordArray: TypeAlias = NDArray[np.int32]
BoolArray: TypeAlias = NDArray[np.bool_]
LongArray: TypeAlias = NDArray[np.uint64]


def freeze_arrays(result: object) -> None:
    """Replace every array that is an attribute of a result by a read-only view."""
    for name, value in list(vars(result).items()):
        if isinstance(value, np.ndarray):
            view = value.view()
            view.flags.writeable = False
            object.__setattr__(result, name, view)  # the dataclass is frozen
