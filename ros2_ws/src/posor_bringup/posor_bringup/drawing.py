"""How every figure of a report looks; the estimator's own reports look the same."""

from __future__ import annotations

from posor_estimator.reporting.drawing import (
    BLUE,
    DPI,
    GREEN,
    GREY,
    LIGHT_BLUE,
    MICRON,
    ORANGE,
    png,
    tidy,
    unique_entries,
)

__all__ = ["BLUE", "DPI", "GREEN", "GREY", "LIGHT_BLUE", "MICRON", "ORANGE", "png", "tidy", "unique_entries"]
