# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Kernels as machine code: from the library that the build makes, compiled by numba, or run as plain Python.

Kernels are written once, as loops over scalars. In each of the three ways they do the same operations in the same
order, so all give the same numbers to the last bit (checked by ``test/numerics/test_compiled.py``). The environment
variable ``POSOR_KERNELS`` chooses:

* ``library``: the kernels of ``posor.kernel_build.PARTS`` are those of the library, see ``numerics.kernel_library``;
* ``numba``: numba compiles each kernel at its first call, for a developer who changes kernels;
* ``python``: nothing is compiled, for example to step through a kernel in a debugger.

Without the variable the library is used, else numba where it is installed, else Python.
"""

from __future__ import annotations

import os
import warnings
from functools import partial
from importlib import import_module
from itertools import repeat, starmap
from operator import setitem
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from posor.errors import SystemRefusal
from posor.numerics.kernel_library import NEW_BUILD, BoundKernel, KernelLibrary, LibraryKernel, find_library

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

Kernel = TypeVar("Kernel", bound="Callable[..., Any]")
Mode = Literal["library", "numba", "python"]
VARIABLE = "POSOR_KERNELS"


def _numba_njit() -> Any | None:
    # Intel's library for several sines at once, where it is found, has other last digits than the one for a single one.
    os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")
    try:
        return import_module("numba").njit  # slow to import
    except ImportError:
        return None


def _choose() -> tuple[Mode, KernelLibrary | None, Any | None]:
    """Return how kernels run, the library, and numba's decorator. Raises SystemRefusal: there is no such way here."""
    wanted = os.environ.get(VARIABLE, "")
    if wanted not in {"", "library", "numba", "python"}:
        raise SystemRefusal(f"is '{wanted}'", where=VARIABLE, expected="'library', 'numba' or 'python'")
    if wanted == "python":
        return "python", None, None
    if wanted in {"", "library"} and (library := find_library()) is not None:
        return "library", library, None
    if wanted == "library":
        raise SystemRefusal("is 'library', but there is no library", where=VARIABLE, expected=NEW_BUILD)
    if (njit := _numba_njit()) is not None:
        return "numba", None, njit
    if wanted == "numba":
        raise SystemRefusal("is 'numba', which is not installed", where=VARIABLE)
    warnings.warn("posor: kernels run as Python, a hundred times slower than compiled", RuntimeWarning, stacklevel=2)
    return "python", None, None


MODE, _LIBRARY, _NJIT = _choose()


def _compile(kernel: Kernel, **options: bool | str) -> Kernel:
    """Return the kernel of the library, the kernel compiled without fast-math, or the kernel itself."""
    if _LIBRARY is not None:
        return _LIBRARY.kernel(kernel)
    if _NJIT is None:
        return kernel
    # No kernel is an argument of another one: the wrappers for that take a sixth of the time of compilation.
    result: Kernel = _NJIT(fastmath=False, error_model="numpy", no_cfunc_wrapper=True, **options)(kernel)
    return result


def compiled(kernel: Kernel) -> Kernel:
    """Return the kernel compiled, for kernels that allocate arrays."""
    return _compile(kernel)


def in_place(kernel: Kernel) -> Kernel:
    """Return the kernel compiled without reference counting, for kernels that neither allocate nor return arrays."""
    return _compile(kernel, _nrt=False)


def without_lock(kernel: Kernel) -> Kernel:
    """Return the same as ``in_place``, for long loops: other Python threads run meanwhile."""
    return _compile(kernel, _nrt=False, nogil=True)


def bind(kernel: Callable[..., Any], arguments: tuple[Any, ...]) -> Callable[..., Any]:
    """Return the kernel with its first arguments, for repeated calls; the others are integers.

    The arrays must stay where they are in memory: bind again if an array is replaced.
    """
    if isinstance(kernel, LibraryKernel):
        return kernel.bind(arguments)
    return partial(kernel, *arguments)


def bind_in_parts(kernel: Callable[..., Any], arguments: tuple[Any, ...]) -> BoundKernel:
    """Return the same in parts, for ``run_in_turn``."""
    if isinstance(kernel, LibraryKernel):
        return kernel.bind_in_parts(arguments)
    return in_parts(partial(kernel, *arguments))


def in_parts(function: Callable[..., Any]) -> BoundKernel:
    """Return a Python function of integers in the parts of a bound kernel; it runs when its results are read.

    So it raises where they are read, and the kernels that run in turn with it do not fail with it.
    """
    integers: list[int] = []
    calls = starmap(function, repeat(integers))  # each ``next`` is a call
    return BoundKernel(partial(setitem, integers, slice(None)), bool, partial(next, calls))  # ``bool()`` does nothing


def run_in_turn(kernels: Sequence[BoundKernel]) -> Callable[[], object]:
    """Return a function that runs kernels one after the other: those of the library in one call."""
    if _LIBRARY is not None and all(kernel.call for kernel in kernels):
        return _LIBRARY.run_in_turn(kernels)

    def run() -> None:
        for kernel in kernels:
            kernel.run()

    return run


def record_view(records: NDArray[np.void]) -> NDArray[np.void]:
    """Return structured records such that kernels can read ``records[i].field``, in every mode, without copying."""
    return records if MODE == "numba" else records.view(np.recarray)
