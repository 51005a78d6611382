"""Shows how a simulated arm's endpoint is known while it moves: by the POSORs, by the encoders alone, and in truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

import numpy as np
from rich.table import Table

from posor_bringup.drawing import MICRON
from posor_bringup.live_view import LiveView

if TYPE_CHECKING:
    from collections.abc import Iterable
    from types import TracebackType

    from posor_estimator.core.types import FloatArray
    from rich.console import Console

    from posor_bringup.arm_record import ArmRecord

COLUMNS = ("x", "y", "z", "length", "about X", "about Y", "about Z", "turn")
LEGEND = "um and urad, axes of the base"


class ArmLiveTable:
    """Shows the newest tick again and again; used in a ``with`` statement."""

    def __init__(self, title: str, console: Console | None = None, *, live: bool = True) -> None:
        """Prepare.

        Args:
            title: What is shown.
            console: Where; None: standard output.
            live: False: plain lines even in a terminal.

        """
        self._view = LiveView(console, live=live)
        self._title = title
        self.state = "starting"
        self.is_live = self._view.is_live

    def __enter__(self) -> Self:
        """Begin to show."""
        self._view.__enter__()
        self.say(self.state)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the last numbers on the screen."""
        self._view.__exit__(kind, error, trace)

    def say(self, state: str) -> None:
        """Say what the run does now."""
        self.state = state
        if not self.is_live:
            self._view.line(f"{self._title}: {state}")

    def show(self, newest: ArmRecord, ticks: int, without_pose: int, speed: float) -> None:
        """Show a tick.

        Args:
            newest: A record of one tick, with a pose.
            ticks: How many have been received so far.
            without_pose: How many of these gave no pose.
            speed: Of the arm's clock against that of the wall.

        """
        counts = f"scans {ticks}, without pose {without_pose}; speed {100.0 * speed:.0f} %"
        normalised = f"NEES {newest.normalised[-1]:.1f} (6 expected)"
        posor, encoders = newest.posor_errors[-1], newest.encoder_errors[-1]
        truth = newest.truth.translations[-1]
        off = truth - newest.target.translations[-1]
        if not self.is_live:
            place = " ".join(f"{value:+.6f}" for value in truth)
            self._view.line(
                f"truth {place} m; POSOR off {_size(posor[:3]):.1f} um, {_size(posor[3:]):.1f} urad; "
                f"encoders off {_size(encoders[:3]):.0f} um, {_size(encoders[3:]):.0f} urad; "
                f"{_size(off):.0f} um from its target; {normalised}; {counts}"
            )
            return
        table = Table(title=f"{self._title}: {self.state}", caption=f"{normalised}; {counts}", header_style="bold")
        table.add_column(LEGEND)
        for name in COLUMNS:
            table.add_column(name, justify="right", min_width=9)
        table.add_row("true endpoint", *_numbers(truth, 1), *[""] * 5)
        table.add_row("POSOR minus truth", *_numbers(posor[:3], 2), *_numbers(posor[3:], 2), style="cyan")
        table.add_row("encoders only minus truth", *_numbers(encoders[:3], 2), *_numbers(encoders[3:], 2))
        table.add_row("truth minus target", *_numbers(off, 2), *[""] * 4, style="magenta")
        if np.isfinite(newest.stage[-1]).all():
            table.add_row("stage, axes of the endpoint", *_numbers(newest.stage[-1], 2), *[""] * 4, style="dim")
        self._view.update(table)


def _size(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector)) / MICRON


def _numbers(vector: FloatArray, digits: int) -> Iterable[str]:
    """Return the components and the length in micrometres or microradians."""
    shown = [f"{value / MICRON:.{digits}f}" for value in vector]
    return [*shown, f"{_size(vector):.{digits}f}"] if digits > 1 else shown
