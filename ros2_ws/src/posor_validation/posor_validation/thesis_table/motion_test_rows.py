"""Rows and plots of the thesis table for chapter 8: motion tests, their predictions and their averages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_validation.thesis_table.prediction_rows import prediction_rows

if TYPE_CHECKING:
    from posor_validation.thesis_table.thesis_row import ThesisRow


def rows() -> list[ThesisRow]:
    """Return the rows of chapter 8.

    Raises:
        DataFileError: A table of the thesis cannot be read.

    """
    return prediction_rows()
