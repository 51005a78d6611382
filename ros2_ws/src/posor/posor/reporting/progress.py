# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Progress of programs that take long: bars with the remaining time on a terminal, elsewhere one line for a long step.

Everything goes to standard error, so that results can be piped.
"""

from __future__ import annotations

import time
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.progress import TaskID

LONG_S = 10.0
"""Time after which a step has a line where there is no terminal."""


class Step:
    """A step of a program."""

    def __init__(self, progress: Progress, name: str, total: float | None) -> None:
        """Begin the step; ``total``: of the work, in any unit; None: unknown."""
        self._progress, self._name, self._total = progress, name, total
        self._done, self._start_s, self._has_line = 0.0, time.monotonic(), False
        self._task: TaskID = progress.add_task(name, total=total)

    def advance(self, work: float) -> None:
        """Add work that has been done since the last call."""
        self.set(self._done + work)

    def set(self, done: float) -> None:
        """State how much of the total has been done."""
        self._done = done
        self._progress.update(self._task, completed=done)
        seconds = time.monotonic() - self._start_s
        if self._total and 0.0 < done < self._total and seconds > LONG_S:
            remaining_s = seconds * (self._total - done) / done
            self._print_once(f"{100.0 * done / self._total:.0f} % in {seconds:.0f} s, about {remaining_s:.0f} s remain")

    def end(self) -> None:
        """End the step."""
        self._progress.remove_task(self._task)
        seconds = time.monotonic() - self._start_s
        if seconds > LONG_S:
            self._print_once(f"{seconds:.0f} s")

    def _print_once(self, text: str) -> None:
        if not self._has_line and not self._progress.console.is_terminal:
            self._progress.console.print(f"{self._name}: {text}", soft_wrap=True)
        self._has_line = True


class ProgressDisplay:
    """The steps of a program."""

    def __init__(self, progress: Progress) -> None:
        """Show steps on a started display."""
        self._progress = progress
        self._current: Step | None = None

    def add(self, name: str, total: float | None) -> Step:
        """Add a step beside the others; ``total``: of its work, in any unit; None: unknown."""
        return Step(self._progress, name, total)

    def begin(self, name: str) -> None:
        """Begin the next step of unknown length; the one before it ends."""
        self.end()
        self._current = self.add(name, None)

    def end(self) -> None:
        """End the step that ``begin`` began."""
        if self._current is not None:
            self._current.end()
        self._current = None


@contextmanager
def progress_display() -> Iterator[ProgressDisplay]:
    """Show the progress of the steps of a ``with`` block; nothing of it stays on the terminal."""
    console = Console(stderr=True, highlight=False, markup=False)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    progress = Progress(*columns, console=console, transient=True)
    with progress if console.is_terminal else nullcontext():  # rich 13.7 ends every started display with a line
        display = ProgressDisplay(progress)
        try:
            yield display
        finally:
            display.end()
