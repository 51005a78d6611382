"""Entry points of programs whose libraries take seconds to load; an interruption meanwhile ends with one line, too.

This module and the modules that name the programs in ``setup.py`` import only light parts of the standard library.
"""

from __future__ import annotations

import errno
import os
import resource
import signal
import sys
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType

EXIT_INTERRUPTED = 130
"""Exit code of an interrupted program, by the convention of shells."""
INTERRUPT_SIGNALS = (signal.SIGINT, signal.SIGTERM)
LEAST_LIMITS = (
    (resource.RLIMIT_NOFILE, 64, "files open at a time (ulimit -n)"),
    (resource.RLIMIT_AS, 2 * 1024**3, "bytes of address space (ulimit -v counts kilobytes)"),
)
"""Limits below which libraries of every program fail, in ways that do not show the reason."""
SHORTAGES = {
    errno.EMFILE: "a higher limit (ulimit -n)",
    errno.ENFILE: "fewer open files on this host",
    errno.ENOMEM: "more memory, or a higher limit (ulimit -v)",
    errno.ENOSPC: "free space on the disk",
    errno.EDQUOT: "a larger quota on the disk",
}
"""Remedies of errors of the system."""


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block SIGINT and SIGTERM in this thread; a process that it starts meanwhile begins with both blocked.

    A started LazyProgram allows them when it has its handlers. A signal before that waits until then; otherwise it
    would end Python during its own start, with a traceback and the exit code 1.
    """
    former = signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPT_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


class LazyProgram:
    """A program that is imported when it is called.

    Attributes:
        name: Name of the program.
        module: Module whose function ``main`` runs the program and returns its exit code.

    """

    def __init__(self, name: str, module: str) -> None:
        self.name = name
        self.module = module

    def __call__(self) -> int:
        """Import and run the program; return its exit code, or ``EXIT_INTERRUPTED`` after SIGINT or SIGTERM.

        During the import a signal ends the process at once: libraries may catch or convert an exception that a handler
        raises in them, and there is nothing to clean up yet. Afterwards a signal raises KeyboardInterrupt, unless the
        program sets its own handlers. When the program has ended, signals are ignored: Python would restore the default
        action while it ends. Signals that the process was started to ignore, as a background job of a shell is, stay
        ignored, except in a process that leads a session, as the supervisor starts it.

        A limit of the process that is too low, and a lack of descriptors, memory or disk, are one sentence and exit
        code 1.
        """
        for limit, least, what in LEAST_LIMITS:
            allowed, _ = resource.getrlimit(limit)
            if allowed != resource.RLIM_INFINITY and allowed < least:
                return self._fail(f"the process is limited to {allowed} {what}; expected at least {least}")
        leads = os.getsid(0) == os.getpid()
        handled = [each for each in INTERRUPT_SIGNALS if leads or signal.getsignal(each) is not signal.SIG_IGN]
        for number in handled:
            signal.signal(number, self._exit_at_once)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPT_SIGNALS)  # see ``interrupts_blocked``
        try:
            program = import_module(self.module).main
            for number in handled:
                signal.signal(number, signal.default_int_handler)
            return int(program())
        except KeyboardInterrupt:
            sys.stderr.write(self._message)
            return EXIT_INTERRUPTED
        except (OSError, MemoryError) as error:
            code = error.errno if isinstance(error, OSError) else errno.ENOMEM
            if code not in SHORTAGES:
                raise
            where = f"{error.filename}: " if isinstance(error, OSError) and error.filename else ""
            return self._fail(f"{where}{os.strerror(code).lower()}; expected {SHORTAGES[code]}")
        finally:
            for number in handled:
                signal.signal(number, signal.SIG_IGN)

    def _fail(self, reason: str) -> int:
        sys.stderr.write(f"{self.name}: {reason}.\n")
        return 1

    @property
    def _message(self) -> str:
        return f"{self.name}: interrupted.\n"

    def _exit_at_once(self, _number: int, _frame: FrameType | None) -> NoReturn:
        os.write(2, self._message.encode())
        os._exit(EXIT_INTERRUPTED)
