"""Compile all kernels before the nodes of a program start, unless their machine code is on disk already."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from posor.errors import SystemRefusal

if TYPE_CHECKING:
    from collections.abc import Callable

POLL_S = 0.05  # time between two looks at the compiling process and at the request to stop


def completion_mark() -> Path | None:
    """Return the file that exists if all kernels are compiled with this numba for this processor; None: without numba.

    Numba does not use machine code of another version of numba or for another processor.
    """
    if not import_module("posor.numerics.compiled").COMPILING:
        return None
    numba: Any = import_module("numba")  # optional, slow to import, and without annotations
    processor = import_module("llvmlite.binding").get_host_cpu_name()
    return Path(numba.config.CACHE_DIR, f"complete-{numba.__version__}-{processor}")


def compile_kernels(report: Callable[[str], object], cancelled: Callable[[], bool]) -> None:
    """Compile the kernels in a process of their own, unless they are compiled; takes a minute, or under a millisecond.

    ``report``: called with sentences for the user before and after the compilation. ``cancelled``: polled; true ends
    the compilation. Raises SystemRefusal: the compilation failed.
    """
    mark = completion_mark()
    if mark is None or mark.exists():
        return
    report(f"kernels are not compiled yet: compiling them into {mark.parent}; this takes a minute or two")
    begin_s = monotonic()
    command = [sys.executable, "-m", "posor.warm_up"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True) as process:
        while process.poll() is None:
            if cancelled():
                process.terminate()
                return
            with suppress(subprocess.TimeoutExpired):
                process.wait(POLL_S)
    if process.returncode:
        what = f"the kernels could not be compiled, exit code {process.returncode}"
        raise SystemRefusal(what, where=str(mark.parent))
    kept = "" if mark.exists() else "; they could not be kept there: expected a writable folder in NUMBA_CACHE_DIR"
    report(f"kernels compiled in {monotonic() - begin_s:.1f} s{kept}")
