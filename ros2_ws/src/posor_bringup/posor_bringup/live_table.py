"""Shows the steps of a replay as they come: a table in a terminal, plain lines elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from rich.table import Table

from posor_bringup.drawing import MICRON
from posor_bringup.live_view import LiveView
from posor_bringup.motion import measured_angles
from posor_bringup.thesis import URAD

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

    from rich.console import Console

    from posor_bringup.motion import Step

COLUMNS = ("alpha", "beta", "m.c.", "theta", "m.c.", "x", "m.c.", "y", "m.c.", "z", "m.c.")
_LINES_AROUND = 8
"""Lines of a terminal that title, header, frame and legend take."""
LEGEND = "alpha, beta, theta in urad, x, y, z of the endpoint in um, less step 1; m.c.: by the machining centre"


def cells(step: Step, first: Step) -> list[str]:
    """Return step number, the numbers under ``COLUMNS`` less those of the first step, and the status."""
    posor = (step.angles - first.angles) / URAD
    truth = step.truth - first.truth
    measured = measured_angles(truth[None, :])[0] / URAD
    moved = (step.endpoint - first.endpoint) / MICRON
    numbers = [posor[0], posor[1], measured[1], posor[2], measured[2]]
    texts = [f"{value:.1f}" for value in numbers]
    for axis in range(3):
        texts += [f"{moved[axis]:.0f}", f"{truth[axis] / MICRON:.0f}"]
    return [str(step.number), *("-" if text == "nan" else _no_negative_zero(text) for text in texts), step.status]


def _no_negative_zero(text: str) -> str:
    return text.removeprefix("-") if float(text) == 0.0 else text


class LiveTable:
    """Shows every new step once; used in a ``with`` statement."""

    def __init__(self, title: str, console: Console | None = None, *, live: bool = True) -> None:
        """Prepare.

        Args:
            title: What is shown.
            console: Where; None: standard output.
            live: False: plain lines even in a terminal.

        """
        self._view = LiveView(console, live=live)
        self._title = title
        self._rows: list[list[str]] = []

    def __enter__(self) -> Self:
        """Begin to show."""
        self._view.__enter__()
        if self._view.is_live:
            self._view.update(self._table([]), at_once=True)
        else:
            for text in (self._title, LEGEND, _row(["step", *COLUMNS, "status"])):
                self._view.line(text)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the whole table on the screen."""
        self._view.update(self._table(self._rows))
        self._view.__exit__(kind, error, trace)

    def show(self, steps: Sequence[Step]) -> None:
        """Add the steps that are new; ``steps`` holds all so far, the first is the reference."""
        new = [cells(step, steps[0]) for step in steps[len(self._rows) :]]
        self._rows += new
        if self._view.is_live:
            fitting = max(1, self._view.console.height - _LINES_AROUND)
            self._view.update(self._table(self._rows[-fitting:]))
            return
        for row in new:
            self._view.line(_row(row))

    def _table(self, rows: Sequence[Sequence[str]]) -> Table:
        table = Table(title=self._title, caption=LEGEND, header_style="bold")
        table.add_column("step", justify="right")
        for name in COLUMNS:
            table.add_column(name, justify="right", style="cyan" if name == "m.c." else "")
        table.add_column("status", overflow="fold")
        for row in rows:
            table.add_row(*row)
        return table


def _row(texts: Sequence[str]) -> str:
    """Return the cells in columns wide enough for all that comes."""
    return f"{texts[0]:>4}" + "".join(f" {text:>7}" for text in texts[1:-1]) + f"  {texts[-1]}"
