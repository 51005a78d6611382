"""Shows a run while it goes on: something that changes in place in a terminal, plain lines elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.live import Live

if TYPE_CHECKING:
    from types import TracebackType

    from rich.console import RenderableType


class LiveView:
    """Where a run is shown; used in a ``with`` statement.

    Attributes:
        console: The terminal, or what else is written to.
        is_live: Whether ``update`` shows anything.

    """

    def __init__(self, console: Console | None = None, *, live: bool = True) -> None:
        """Prepare.

        Args:
            console: Where; None: standard output.
            live: False: plain lines even in a terminal.

        """
        self.console = console or Console(highlight=False)
        self._live = Live(console=self.console) if live and self.console.is_terminal else None
        self.is_live = self._live is not None

    def __enter__(self) -> Self:
        """Begin to show."""
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave on the screen what was shown last."""
        if self._live is not None:
            self._live.stop()

    def update(self, shown: RenderableType, *, at_once: bool = False) -> None:
        """Show something in the place of what is shown, if this is a terminal."""
        if self._live is not None:
            self._live.update(shown, refresh=at_once)

    def line(self, text: str) -> None:
        """Write a line."""
        self.console.print(text, soft_wrap=True, markup=False)
