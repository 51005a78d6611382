# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The steps of a replay as a table: live in a terminal, as plain lines elsewhere, and as CSV."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING, Self

from posor.reporting.figure_style import MICRON
from posor_calibration.attitude_fit import angles_from_displacements
from rich.table import Table

from posor_lab.replay_1985.motion_test import TRUTH_LEVER
from posor_lab.reports.console_progress import LiveView
from posor_lab.thesis_data import URAD

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rich.console import Console

    from posor_lab.replay_1985.motion_test import MotionStep, MotionTest

HEADER = ("step", "alpha", "beta", "m.c.", "theta", "m.c.", "x", "m.c.", "y", "m.c.", "z", "m.c.", "status")
LEGEND = "alpha, beta, theta in urad, x, y, z of the endpoint in um, less step 1; m.c.: by the machining centre"
CSV_HEADER = (
    *("step", "alpha_posor_urad", "beta_posor_urad", "theta_posor_urad", "beta_meas_urad", "theta_meas_urad"),
    *("x_m", "y_m", "z_m", "status"),
)
_LINES_AROUND = 8  # lines of a terminal for title, header, frame and legend


def step_row(step: MotionStep, first: MotionStep) -> list[str]:
    """Return the cells under ``HEADER``, relative to the first step; missing numbers are ``-``."""
    posor = (step.angles - first.angles) / URAD
    truth = step.truth - first.truth
    measured = angles_from_displacements(truth[None, :], TRUTH_LEVER)[0] / URAD
    moved = (step.endpoint - first.endpoint) / MICRON
    angles = _format_numbers([posor[0], posor[1], measured[1], posor[2], measured[2]], ".1f")
    positions = _format_numbers([value for pair in zip(moved, truth / MICRON, strict=True) for value in pair], ".0f")
    return [str(step.number), *("-" if text == "nan" else text for text in angles + positions), step.status]


def steps_as_csv(test: MotionTest) -> str:
    """Return one row per step, relative to step 1; cells of a step without a pose are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_HEADER)
    for step, posor, truth, moved in zip(
        test.steps, test.posor_angles / URAD, test.truth_angles / URAD, test.endpoint_displacement, strict=True
    ):
        angles = _format_numbers(posor, ".3f") if step.has_pose else [""] * 3
        position = _format_numbers(moved, ".9f") if step.has_pose else [""] * 3
        writer.writerow([step.number, *angles, *_format_numbers(truth[1:], ".3f"), *position, step.status])
    return text.getvalue()


def _format_numbers(values: Iterable[float], pattern: str) -> list[str]:
    """Return numbers as text, without negative zeros."""
    texts = [format(value, pattern) for value in values]
    return [text.removeprefix("-") if float(text) == 0.0 else text for text in texts]


class LiveTable(LiveView):
    """Shows every new step once."""

    def __init__(self, title: str, console: Console | None = None, *, live: bool = True) -> None:
        """Create the table; ``console`` and ``live`` are those of ``LiveView``."""
        super().__init__(console, live=live)
        self._title = title
        self._rows: list[list[str]] = []

    def __enter__(self) -> Self:
        """Show title and header."""
        super().__enter__()
        if self.is_live:
            self.update(self._table([]), at_once=True)
        else:
            for text in (self._title, LEGEND, _plain_line(HEADER)):
                self.line(text)
        return self

    def __exit__(self, *exception: object) -> None:
        """Leave the whole table on the screen."""
        self.update(self._table(self._rows))
        super().__exit__(*exception)

    def show(self, steps: Sequence[MotionStep]) -> None:
        """Add the new steps; ``steps`` holds all so far, the first is the reference."""
        new = [step_row(step, steps[0]) for step in steps[len(self._rows) :]]
        self._rows += new
        if self.is_live:
            fitting = max(1, self.console.height - _LINES_AROUND)
            self.update(self._table(self._rows[-fitting:]))
            return
        for row in new:
            self.line(_plain_line(row))

    def _table(self, rows: Sequence[Sequence[str]]) -> Table:
        table = Table(title=self._title, caption=LEGEND, header_style="bold")
        for name in HEADER[:-1]:
            table.add_column(name, justify="right", style="cyan" if name == "m.c." else "")
        table.add_column(HEADER[-1], overflow="fold")
        for row in rows:
            table.add_row(*row)
        return table


def _plain_line(texts: Sequence[str]) -> str:
    """Return the cells in columns of fixed width."""
    return f"{texts[0]:>4}" + "".join(f" {text:>7}" for text in texts[1:-1]) + f"  {texts[-1]}"
