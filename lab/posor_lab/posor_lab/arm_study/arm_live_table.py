"""Table of the endpoint while a simulated arm moves: by POSORs, by encoders alone, and its true pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.reporting.figure_style import MICRON
from rich.table import Table
from rich.text import Text

from posor_lab.reports.console_progress import LiveView

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray
    from rich.console import Console

    from posor_lab.arm_study.arm_record import ArmRecord

COLUMNS = ("x", "y", "z", "length", "about X", "about Y", "about Z", "angle")
LEGEND = "um and urad, axes of the base"


class ArmLiveTable(LiveView):
    """Shows the newest tick: a table in a terminal, else lines."""

    def __init__(self, title: str, console: Console | None = None, *, live: bool = True) -> None:
        """Create the table; ``console`` and ``live`` are those of ``LiveView``."""
        super().__init__(console, live=live)
        self._title = title
        self._state = self._waiting = ""

    def show_state(self, state: str) -> None:
        """Show what the run is doing."""
        self._state = state
        self._show_line(state)

    def show_waiting(self, missing: str) -> None:
        """Show what the run is waiting for, once."""
        waiting = f"{self._state}, waiting for {missing}"
        if waiting != self._waiting:
            self._waiting = waiting
            self._show_line(waiting)

    def _show_line(self, text: str) -> None:
        if self.is_live:
            self.update(Text(f"{self._title}: {text}"), at_once=True)
        else:
            self.line(f"{self._title}: {text}")

    def show_tick(self, newest: ArmRecord, ticks: int, without_pose: int, speed: float) -> None:
        """Show a tick.

        Args:
            newest: Record whose last tick is shown.
            ticks: Number of ticks received so far.
            without_pose: Number of these without a pose.
            speed: Speed of the arm's clock relative to the wall clock.

        """
        caption = (
            f"NEES {newest.normalised[-1]:.1f} (6 expected); "
            f"scans {ticks}, without pose {without_pose}; speed {100.0 * speed:.0f} %"
        )
        posor, encoders, truth = newest.posor_errors[-1], newest.encoder_errors[-1], newest.truth.translations[-1]
        miss = truth - newest.target.translations[-1]
        if not self.is_live:
            position = " ".join(f"{value:+.6f}" for value in truth)
            self.line(
                f"truth {position} m; POSOR off {_length(posor[:3]):.1f} um, {_length(posor[3:]):.1f} urad; "
                f"encoders off {_length(encoders[:3]):.0f} um, {_length(encoders[3:]):.0f} urad; "
                f"{_length(miss):.0f} um from its target; {caption}"
            )
            return
        table = Table(title=f"{self._title}: {self._state}", caption=caption, header_style="bold")
        table.add_column(LEGEND)
        for name in COLUMNS:
            table.add_column(name, justify="right", min_width=9)
        table.add_row("true endpoint", *(f"{value / MICRON:.1f}" for value in truth))
        table.add_row("POSOR minus truth", *_cells(posor[:3]), *_cells(posor[3:]), style="cyan")
        table.add_row("encoders only minus truth", *_cells(encoders[:3]), *_cells(encoders[3:]))
        table.add_row("truth minus target", *_cells(miss), style="magenta")
        if np.isfinite(newest.stage[-1]).all():
            table.add_row("stage, axes of the endpoint", *_cells(newest.stage[-1]), style="dim")
        self.update(table)


def _length(vector: FloatArray) -> float:
    """Return the length in micrometres or microradians."""
    return float(np.linalg.norm(vector)) / MICRON


def _cells(vector: FloatArray) -> list[str]:
    """Return the components and the length in micrometres or microradians."""
    return [f"{value:.2f}" for value in (*(vector / MICRON), _length(vector))]
