"""Compile scalar kernels with numba where it is installed; run them as plain Python where it is not.

The kernels are written once, as loops over scalars. Compiled or not, they are the same source and do the same
operations in the same order, so both give the same numbers (checked by ``test/core/test_compiled.py``).
Set ``POSOR_COMPILE=0`` to leave them uncompiled, for example to step through them in a debugger.

Numba keeps machine code as long as the file of a kernel stands, whatever the kernels that it calls have become; so the
code is kept in a folder that is named after the text of all kernels.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

Kernel = TypeVar("Kernel", bound="Callable[..., Any]")

EIGHT = 8
"""How many numbers abreast kernels may compute with at once, see ``kernels.eight``."""

_HERE = Path(__file__).resolve().parent


def _cache_folder() -> str:
    """Return where the machine code of exactly these kernels is kept: beside them, or in the user's cache."""
    digest = hashlib.sha256()
    for file in sorted([Path(__file__).resolve(), *(_HERE / "kernels").glob("*.py")]):
        digest.update(file.read_bytes())
    name = f"posor-kernels-{digest.hexdigest()[:16]}"
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return str(Path(chosen) / name)
    beside = _HERE / "kernels" / "__pycache__"
    if os.access(beside if beside.exists() else beside.parent, os.W_OK):
        return str(beside / name)
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111  ~ may be unknown
    return str(Path(home if os.access(home, os.W_OK) else tempfile.gettempdir()) / name)


def _numba_njit() -> Any | None:
    if os.environ.get("POSOR_COMPILE", "1") == "0":
        return None
    # Intel's library for several sines at once, where it is found, has other last digits than the one for a single one.
    os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")
    try:
        from numba import config, njit  # noqa: PLC0415  optional, and slow to import
    except ImportError:
        return None
    vars(config)["CACHE_DIR"] = _cache_folder()  # numba makes the attributes of this module at run time
    return njit


_NJIT = _numba_njit()

COMPILING = _NJIT is not None


def _made(kernel: Kernel, **options: bool | str) -> Kernel:
    """Return the kernel compiled, cached on disk, without fast-math; or the kernel itself where numba is absent."""
    if _NJIT is None:
        return kernel
    result: Kernel = _NJIT(cache=True, fastmath=False, error_model="numpy", **options)(kernel)
    return result


def compiled(kernel: Kernel) -> Kernel:
    """Return the kernel compiled: for those that make arrays, and those that nothing is gained for by the others."""
    return _made(kernel)


def in_place(kernel: Kernel) -> Kernel:
    """Return the same for kernels that make no arrays: they borrow their callers', and count no references to them.

    They return none either; the parts of arrays that they work on they get from ``written_out`` kernels.
    """
    return _made(kernel, _nrt=False)


def inlined(kernel: Kernel) -> Kernel:
    """Return the same as ``in_place``, its machine code put in where it is called: for what each scan calls.

    A call that hands over arrays costs as much as the arithmetic of a row.
    """
    return _made(kernel, _nrt=False, forceinline=True)


def written_out(kernel: Kernel) -> Kernel:
    """Return the same, its text put in where it is called: for the parts of arrays that ``in_place`` kernels take."""
    return _made(kernel, _nrt=False, inline="always")


def without_lock(kernel: Kernel) -> Kernel:
    """Return the same as ``in_place``, for long runs: other threads go on while it runs."""
    return _made(kernel, _nrt=False, nogil=True)


def code_for(kernel: Callable[..., int], arguments: tuple[Any, ...]) -> Callable[..., int]:
    """Return a kernel's machine code for arguments of exactly these types: it takes what it gets for such, unseen.

    For calls again and again with the same arrays; to look at their types costs more than to hand them over.
    """
    if _NJIT is None:
        return kernel
    numba: Any = import_module("numba")  # optional, and without annotations
    dispatcher: Any = kernel
    code: Callable[..., int] = dispatcher.compile(tuple(numba.typeof(argument) for argument in arguments))
    return code
