"""Rows and plots of the thesis table for chapter 8: motion tests, their predictions and their averages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_bringup.installed import BAGS

from posor_lab.replay_1985.motion_plots import plot_angles
from posor_lab.replay_1985.motion_test import offline_motion_test
from posor_lab.replay_1985.printed_results import (
    EXPECTED_ERRORS_FILE,
    PRINTED_FILES,
    read_predicted_errors,
    read_printed,
)
from posor_lab.thesis_data import data_path
from posor_lab.thesis_table.end_of_beam_rows import end_of_beam_plots, end_of_beam_rows
from posor_lab.thesis_table.motion_summary_rows import motion_summary_rows
from posor_lab.thesis_table.prediction_rows import prediction_rows
from posor_lab.thesis_table.replay_rows import replay_rows

if TYPE_CHECKING:
    from posor.reporting.plot import Plot
    from posor_bringup.installed import Bag

    from posor_lab.thesis_table.thesis_row import ThesisRow


def rows() -> list[ThesisRow]:
    """Return the rows of chapter 8.

    Raises:
        PosorError: A table of the thesis or a file of the rig cannot be read.

    """
    return [*prediction_rows(), *replay_rows(), *end_of_beam_rows(), *motion_summary_rows()]


def plots() -> list[Plot]:
    """Return figures 8.8 to 8.20: the motion tests.

    Raises:
        PosorError: A table of the thesis or a file of the rig cannot be read.

    """
    return [*(plot for bag in BAGS for plot in _replay_plots(bag)), *end_of_beam_plots()]


def _replay_plots(bag: Bag) -> list[Plot]:
    """Return motion and error of each angle with the zero shifts of the printed tables, as figures 8.8 to 8.14."""
    printed = read_printed(data_path(PRINTED_FILES[bag])) if bag in PRINTED_FILES else None
    predictions = read_predicted_errors(data_path(EXPECTED_ERRORS_FILE), bag)
    plots = plot_angles(offline_motion_test(bag, "printed"), printed, predictions)
    for plot in plots:
        plot.title = f"{bag.upper()}: {plot.title}"
    return plots
