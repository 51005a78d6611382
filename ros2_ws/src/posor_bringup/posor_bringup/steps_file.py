"""Writes the steps of a motion test as CSV, so that anyone can compare."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

from posor_bringup.thesis import URAD

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from posor_bringup.motion import MotionTest

COLUMNS = (
    "step",
    "alpha_posor_urad",
    "beta_posor_urad",
    "theta_posor_urad",
    "beta_meas_urad",
    "theta_meas_urad",
    "x_m",
    "y_m",
    "z_m",
    "status",
)


def write_steps(path: Path, test: MotionTest) -> None:
    """Write one row for each step, incremental values; the cells of a step without a pose are empty."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for step, posor, measured, moved in zip(test.steps, test.posor, test.measured, test.displacement, strict=True):
            writer.writerow(
                [
                    step.number,
                    *(_cells(posor / URAD, "{:.3f}") if step.has_pose else [""] * 3),
                    *_cells(measured[1:] / URAD, "{:.3f}"),
                    *(_cells(moved, "{:.9f}") if step.has_pose else [""] * 3),
                    step.status,
                ]
            )


def _cells(values: Iterable[float], pattern: str) -> list[str]:
    """Return numbers as text, without negative zeros."""
    texts = [pattern.format(value) for value in values]
    return [text.removeprefix("-") if float(text) == 0.0 else text for text in texts]
