# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Progress of a run in the terminal: a table that is redrawn, progress bars; plain lines where there is no terminal."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Self

from posor.errors import PosorError
from posor.lazy_program import EXIT_INTERRUPTED
from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from posor_ros.node_program import StopSignal
    from rich.console import RenderableType


class InterruptedRunError(PosorError):
    """SIGINT or SIGTERM interrupted a run."""

    exit_code = EXIT_INTERRUPTED


def interruption_check(stop: StopSignal, program: str) -> Callable[[], bool]:
    """Return a function that returns False, and raises InterruptedRunError once a signal has stopped a program."""

    def check() -> bool:
        if stop.requested:
            raise InterruptedRunError("interrupted", where=program)
        return False

    return check


class LiveView:
    """A context manager that redraws a table in a terminal; unless ``is_live``, only ``line`` prints."""

    def __init__(self, console: Console | None = None, *, live: bool = True) -> None:
        """Create the view on a console, or standard output; not ``live``: plain lines even in a terminal."""
        self.console = console or Console(highlight=False)
        self.is_live = live and self.console.is_terminal
        self._live = Live(console=self.console)

    def __enter__(self) -> Self:
        if self.is_live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop drawing; the last table stays."""
        if self.is_live:
            self._live.stop()

    def update(self, shown: RenderableType, *, at_once: bool = False) -> None:
        """Replace the table, if this is a terminal."""
        if self.is_live:
            self._live.update(shown, refresh=at_once)

    def line(self, text: str) -> None:
        """Print a line."""
        self.console.print(text, soft_wrap=True, markup=False)


class StageProgress:
    """A context manager that shows the stages of a run: bars in a terminal, else a line at the end of each stage."""

    def __init__(self, console: Console, check: Callable[[], object] = lambda: None) -> None:
        """Create the display; an exception of ``check``, called after each part, ends the stage."""
        self._console = console
        self._check = check
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self._progress = Progress(*columns, console=console, disable=not console.is_terminal)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop drawing; the bars stay."""
        self._progress.stop()

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Callable[..., None]]:
        """Show a stage; yield a function to call after each part, or with the number of parts done."""
        task, started_s = self._progress.add_task(title, total=total), time.monotonic()

        def on_done(parts: int = 1) -> None:
            self._check()
            self._progress.advance(task, parts)

        yield on_done
        if not self._console.is_terminal:
            self.line(f"{title}: {total} done in {time.monotonic() - started_s:.0f} s")

    def line(self, text: str) -> None:
        """Print a line above the bars."""
        self._console.print(text, soft_wrap=True, markup=False)
