"""Compile scalar kernels with numba where it is installed; run them as plain Python where it is not.

The kernels are written once, as loops over scalars. Compiled or not, they are the same source and do the same
operations in the same order, so both give the same numbers (checked by ``test/core/test_compiled.py``).
Set ``POSOR_COMPILE=0`` to leave them uncompiled, for example to step through them in a debugger.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

Kernel = TypeVar("Kernel", bound="Callable[..., Any]")


def _numba_njit() -> Any | None:
    if os.environ.get("POSOR_COMPILE", "1") == "0":
        return None
    try:
        from numba import njit  # noqa: PLC0415  optional, and slow to import
    except ImportError:
        return None
    return njit


_NJIT = _numba_njit()

COMPILING = _NJIT is not None


def compiled(kernel: Kernel) -> Kernel:
    """Return the kernel compiled, cached on disk, without fast-math; or the kernel itself where numba is absent."""
    if _NJIT is None:
        return kernel
    result: Kernel = _NJIT(cache=True, fastmath=False, error_model="numpy")(kernel)
    return result
