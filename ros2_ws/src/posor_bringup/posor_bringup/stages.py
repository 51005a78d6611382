"""Shows how far a run of several stages has come: bars in a terminal, elsewhere a line when each stage ends."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Self

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rich.console import Console


class Stages:
    """A context manager; what is printed within it stands above the bars."""

    def __init__(self, console: Console, check: Callable[[], None] = lambda: None) -> None:
        """Show stages.

        Args:
            console: Where.
            check: Called whenever a part is done; what it raises ends the stage.

        """
        self._console = console
        self._check = check
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self._progress = Progress(*columns, console=console) if console.is_terminal else None

    def __enter__(self) -> Self:
        """Begin to show."""
        if self._progress is not None:
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the bars as they are."""
        if self._progress is not None:
            self._progress.stop()

    @contextmanager
    def stage(self, what: str, total: int) -> Iterator[Callable[[], None]]:
        """Show a stage; what it gives is to be called after each of its ``total`` parts."""
        if self._progress is not None:
            progress, task = self._progress, self._progress.add_task(what, total=total)

            def advance() -> None:
                self._check()
                progress.advance(task)

            yield advance
            return
        begun = time.monotonic()
        yield self._check
        self._console.print(f"{what}: {total} done in {time.monotonic() - begun:.0f} s", soft_wrap=True, markup=False)
