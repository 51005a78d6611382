# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Entry points of programs whose libraries take seconds to load; an interruption meanwhile ends with one line, too.

This module and the modules that name the programs in ``setup.cfg`` import only light parts of the standard library.
"""

from __future__ import annotations

import errno
import gc
import os
import resource
import select
import signal
import sys
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, NoReturn

from posor.errors import SystemRefusal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

EXIT_INTERRUPTED = 130  # exit code of an interrupted program, by the convention of shells
EXIT_UNREAD = 1  # exit code of a program whose output nobody reads to its end, as behind ``head``
INTERRUPT_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # SIGHUP: the terminal was closed
LEAST_LIMITS = (  # limits below which libraries of every program fail, in ways that do not show the reason
    (resource.RLIMIT_NOFILE, 64, "files open at a time (ulimit -n)"),
    (resource.RLIMIT_AS, 2 * 1024**3, "bytes of address space (ulimit -v counts kilobytes)"),
)
NO_PLUGINS = {"PYDANTIC_DISABLE_PLUGINS": "__all__"}
"""Pydantic looks for plugins in every installed package; the programs use none, nor do those that they start."""
BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that limit the threads of the libraries of linear algebra that numpy may be built with."""
SHORTAGES = {  # remedies of errors of the system
    errno.EMFILE: "a higher limit (ulimit -n)",
    errno.ENFILE: "fewer open files on this host",
    errno.ENOMEM: "more memory, or a higher limit (ulimit -v)",
    errno.ENOSPC: "free space on the disk",
    errno.EDQUOT: "a larger quota on the disk",
    errno.EFBIG: "a higher limit of the size of files (ulimit -f)",
}


def handle_interrupts(
    handler: Callable[[int, FrameType | None], object] | signal.Handlers = signal.default_int_handler,
) -> None:
    """Give INTERRUPT_SIGNALS one handler; the default one raises KeyboardInterrupt.

    Every program calls this function first: a shell starts a background job with SIGINT ignored, Python then installs
    no handler, and the programs that this one starts would ignore SIGINT, too. SIGHUP stays ignored under ``nohup``.
    """
    for number in heeded_signals():
        signal.signal(number, handler)


def heeded_signals() -> list[signal.Signals]:
    """Return INTERRUPT_SIGNALS, under ``nohup`` without SIGHUP."""
    is_nohup = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [number for number in INTERRUPT_SIGNALS if number != signal.SIGHUP or not is_nohup]


@contextmanager
def interrupts_handled(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Handle INTERRUPT_SIGNALS in a ``with`` block; the former handlers are restored at its end."""
    former = {number: signal.signal(number, handler) for number in heeded_signals()}
    try:
        yield
    finally:
        for number, previous in former.items():
            signal.signal(number, previous)


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block INTERRUPT_SIGNALS in this thread; a process that it starts meanwhile begins with them blocked.

    A started LazyProgram allows them when it has its handlers. A signal before that waits until then; otherwise it
    would end Python during its own start, with a traceback and the exit code 1.
    """
    former = signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPT_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def _open_standard_streams() -> None:
    """Let standard streams that the caller closed be ``/dev/null``: libraries write to their descriptors."""
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)
            if null != descriptor:
                os.dup2(null, descriptor)
                os.close(null)
            setattr(sys, name, os.fdopen(descriptor, "r" if name == "stdin" else "w", closefd=False))


def _is_output_unread() -> bool:
    """Return whether standard output is a pipe that nobody reads."""
    output = select.poll()
    output.register(1, 0)
    return any(event & select.POLLERR for _, event in output.poll(0))


def _lost_output() -> str:
    """Return 'standard output' if it cannot be written, and discard what is buffered; otherwise an empty text."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return "standard output"
    return ""


class LazyProgram:
    """A program that is imported when it is called."""

    def __init__(self, name: str, module: str, *, is_live: bool = False) -> None:
        self.name = name  # name of the program
        self.module = module  # module whose function ``main`` runs the program and returns its exit code
        # The matrices of a live node are small: threads of linear algebra would wait for each other, and spin.
        threads = dict.fromkeys(BLAS_THREADS, "1") if is_live else {}
        self.environment = NO_PLUGINS | threads  # the caller's own has precedence

    def __call__(self) -> int:
        """Import and run the program; return its exit code, or ``EXIT_INTERRUPTED`` after one of INTERRUPT_SIGNALS.

        During the import a signal ends the process at once: libraries may catch or convert an exception that a handler
        raises in them, and there is nothing to clean up yet. Afterwards a signal raises KeyboardInterrupt, unless the
        program sets its own handlers. When the program has ended, these signals are ignored: Python would restore the
        default action while it ends. A background job of a shell is interrupted in the same way
        (``handle_interrupts``).

        A program whose output is a pipe that nobody reads any more ends with ``EXIT_UNREAD`` and without a word.

        A limit of the process that is too low, and a lack of descriptors, memory or disk, also for standard output, are
        one sentence and exit code 1.
        """
        _open_standard_streams()
        handle_interrupts(self._exit_at_once)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPT_SIGNALS)  # see ``interrupts_blocked``
        for limit, least, what in LEAST_LIMITS:
            allowed, _ = resource.getrlimit(limit)
            if allowed != resource.RLIM_INFINITY and allowed < least:
                return self._fail(f"the process is limited to {allowed} {what}; expected at least {least}")
        os.environ |= self.environment | os.environ
        try:
            gc.disable()  # nearly all objects of an import live until the end: collections would only visit them
            try:
                program = import_module(self.module).main
                gc.freeze()
            finally:
                gc.enable()
            handle_interrupts()
            code = int(program())
            sys.stdout.flush()
        except KeyboardInterrupt:
            sys.stderr.write(self._message)
            return EXIT_INTERRUPTED
        except SystemRefusal as error:  # the library of kernels, which the import loads
            return self._fail(str(error).rstrip("."))
        except (OSError, MemoryError) as error:
            if isinstance(error, BrokenPipeError) and _is_output_unread():
                _lost_output()
                return EXIT_UNREAD
            shortage = error.errno if isinstance(error, OSError) else errno.ENOMEM
            if shortage not in SHORTAGES:
                raise
            name = (error.filename if isinstance(error, OSError) else "") or _lost_output()
            where = f"{name}: " if name else ""
            return self._fail(f"{where}{os.strerror(shortage).lower()}; expected {SHORTAGES[shortage]}")
        else:
            return code
        finally:
            handle_interrupts(signal.SIG_IGN)

    def _fail(self, reason: str) -> int:
        sys.stderr.write(f"{self.name}: {reason}.\n")
        return 1

    @property
    def _message(self) -> str:
        return f"{self.name}: interrupted.\n"

    def _exit_at_once(self, _number: int, _frame: FrameType | None) -> NoReturn:
        os.write(2, self._message.encode())
        os._exit(EXIT_INTERRUPTED)
