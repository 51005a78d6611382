"""Starts a program whose libraries take seconds to load: whoever interrupts it gets one line, at that time too.

Nothing but light parts of the standard library is imported here, and nothing else by the modules ``programs`` of the
packages, which setup.py names as the programs' entry points.
"""

from __future__ import annotations

import os
import signal
import sys
from importlib import import_module
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from types import FrameType

INTERRUPTED = 130
"""Exit code of what was interrupted before its end, as shells have it."""
SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""What interrupts a program."""


class Starter:
    """A program that is loaded when it is called."""

    def __init__(self, name: str, module: str) -> None:
        """Remember what to load.

        Args:
            name: What the program is called.
            module: Module whose function ``main`` runs the program and returns its exit code.

        """
        self.name = name
        self.module = module

    def __call__(self) -> int:
        """Load the program and run it; return its exit code, or ``INTERRUPTED`` after SIGINT or SIGTERM.

        While it is being loaded, a signal ends the process at once: libraries catch what a handler raises in them, or
        make another error of it, and there is nothing to tidy up yet. Then it raises KeyboardInterrupt, unless the
        program has handlers of its own. What it was started to ignore, as by a shell in the background, stays ignored.
        """
        heeded = [number for number in SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
        for number in heeded:
            signal.signal(number, self._leave)
        program = import_module(self.module).main
        try:
            for number in heeded:
                signal.signal(number, signal.default_int_handler)
            return int(program())
        except KeyboardInterrupt:
            sys.stderr.write(self._farewell)
            return INTERRUPTED

    @property
    def _farewell(self) -> str:
        return f"{self.name}: interrupted.\n"

    def _leave(self, _number: int, _frame: FrameType | None) -> NoReturn:
        os.write(2, self._farewell.encode())
        os._exit(INTERRUPTED)
