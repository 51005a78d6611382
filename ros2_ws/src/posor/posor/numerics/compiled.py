"""Compile kernels with numba where it is installed; run them as plain Python where it is not.

Kernels are written once, as loops over scalars. Compiled or not, they do the same operations in the same order, so both
give the same numbers (checked by ``test/numerics/test_compiled.py``). Set ``POSOR_COMPILE=0`` to leave them uncompiled,
for example to step through them in a debugger.

Numba does not notice when a kernel that another kernel calls has changed. Therefore the cache folder of the machine
code is named by a hash of the text of ``KERNEL_FILES``. Copies of the package with the same kernels share this folder
if ``NUMBA_CACHE_DIR`` is the same for all of them and numba has CACHE_LOCATOR_CLASSES.
"""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

Kernel = TypeVar("Kernel", bound="Callable[..., Any]")

PACKAGE = Path(__file__).resolve().parent.parent
KERNEL_FILES = tuple(f"{folder}/[!.#]*.py" for folder in ("numerics", "model", "estimation", "chain", "messages"))
"""Files of the package that hold kernels and the constants that they are compiled with; no locks of editors."""

CACHE_LOCATORS = (
    "posor.numerics.kernel_cache.KernelCacheLocator",
    "InTreeCacheLocator",
    "UserWideCacheLocator",
    "IPythonCacheLocator",
)
"""Where numba may keep machine code, in this order; the first place suits every function that has a source file."""


def cache_folder() -> str:
    """Return where the machine code of exactly these kernels is kept: beside them, or in the user's cache.

    Machine code is run as it is read. So the folder is the user's alone; where none can be, it is a new one.
    """
    digest = hashlib.sha256()
    for file in sorted(file for pattern in KERNEL_FILES for file in PACKAGE.glob(pattern)):
        digest.update(file.read_bytes())
    name = f"posor-kernels-{digest.hexdigest()[:16]}"
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111  ~ may be unknown
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    for parent in [Path(chosen)] if chosen else [PACKAGE / "numerics" / "__pycache__", Path(home)]:
        if _make_private(folder := parent / name):
            return str(folder)
    return tempfile.mkdtemp(prefix="posor-")


def _make_private(folder: Path) -> bool:
    """Make a folder that only the user can enter; return whether it is one."""
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.lstat()
        if stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid():
            folder.chmod(0o700)
            return os.access(folder, os.W_OK)
    return False


def _numba_njit() -> Any | None:
    if os.environ.get("POSOR_COMPILE", "1") == "0":
        return None
    # Intel's library for several sines at once, where it is found, has other last digits than the one for a single one.
    os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")
    try:
        from numba import config, njit  # noqa: PLC0415  optional, and slow to import
    except ImportError:
        return None
    # numba makes the attributes of this module at run time
    vars(config).update(CACHE_DIR=cache_folder(), CACHE_LOCATOR_CLASSES=",".join(CACHE_LOCATORS))
    return njit


_NJIT = _numba_njit()

COMPILING = _NJIT is not None


def _compile(kernel: Kernel, **options: bool | str) -> Kernel:
    """Return the kernel compiled, cached on disk, without fast-math; or the kernel itself where numba is absent."""
    if _NJIT is None:
        return kernel
    result: Kernel = _NJIT(cache=True, fastmath=False, error_model="numpy", **options)(kernel)
    return result


def compiled(kernel: Kernel) -> Kernel:
    """Return the kernel compiled, for kernels that allocate arrays."""
    return _compile(kernel)


def in_place(kernel: Kernel) -> Kernel:
    """Return the kernel compiled without reference counting, for kernels that neither allocate nor return arrays."""
    return _compile(kernel, _nrt=False)


def inlined(kernel: Kernel) -> Kernel:
    """Return the same as ``in_place``, inlined into its callers: for what each scan calls.

    A call that passes arrays costs as much as the arithmetic of one reading.
    """
    return _compile(kernel, _nrt=False, forceinline=True)


def without_lock(kernel: Kernel) -> Kernel:
    """Return the same as ``in_place``, for long loops: other Python threads run meanwhile."""
    return _compile(kernel, _nrt=False, nogil=True)


def compile_for(kernel: Kernel, arguments: tuple[Any, ...]) -> Kernel:
    """Return the machine code of a kernel for arguments of exactly these types. Argument types are not checked.

    For repeated calls with the same arrays, where checking the types would cost more than passing them.
    """
    if _NJIT is None:
        return kernel
    numba: Any = import_module("numba")  # optional, and without annotations
    dispatcher: Any = kernel
    code: Kernel = dispatcher.compile(tuple(numba.typeof(argument) for argument in arguments))
    return code


def record_view(records: NDArray[np.void]) -> NDArray[np.void]:
    """Return structured records such that kernels can read ``records[i].field``, compiled or not, without copying."""
    return records if COMPILING else records.view(np.recarray)
