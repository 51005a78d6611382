"""Entry points of programs whose libraries take seconds to load; an interruption meanwhile ends with one line, too.

This module and the modules that name the programs in ``setup.py`` import only light parts of the standard library.
"""

from __future__ import annotations

import os
import signal
import sys
from importlib import import_module
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from types import FrameType

EXIT_INTERRUPTED = 130
"""Exit code of an interrupted program, by the convention of shells."""
INTERRUPT_SIGNALS = (signal.SIGINT, signal.SIGTERM)


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
        program sets its own handlers. Signals that the process was started to ignore stay ignored.
        """
        handled = [number for number in INTERRUPT_SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
        for number in handled:
            signal.signal(number, self._exit_at_once)
        program = import_module(self.module).main
        try:
            for number in handled:
                signal.signal(number, signal.default_int_handler)
            return int(program())
        except KeyboardInterrupt:
            sys.stderr.write(self._message)
            return EXIT_INTERRUPTED

    @property
    def _message(self) -> str:
        return f"{self.name}: interrupted.\n"

    def _exit_at_once(self, _number: int, _frame: FrameType | None) -> NoReturn:
        os.write(2, self._message.encode())
        os._exit(EXIT_INTERRUPTED)
