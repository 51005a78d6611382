"""Rows of the thesis table: errors of the motion tests ZMO, YMO and YZMO, from their recorded readings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_lab.replay_1985.comparison import KIND_NAMES, UNDER_TABLE, error_figure, expectations
from posor_lab.replay_1985.motion_test import offline_motion_test
from posor_lab.thesis_table.thesis_row import ThesisRow

if TYPE_CHECKING:
    from posor_bringup.installed import Bag, CalibrationName

    from posor_lab.replay_1985.comparison import Expectation

_SECTIONS: dict[str, str] = {UNDER_TABLE: "App. 8B"}
_MAP_LOST = "the 1985 map of the diodes is lost, the derived one is local"


def replay_rows() -> list[ThesisRow]:
    """Return the errors that section 8.4 and appendix 8B print, with the zero shifts of each.

    Raises:
        PosorError: A file of the rig is missing or invalid.

    """
    tests: tuple[tuple[Bag, CalibrationName], ...] = (
        ("ymo", "printed"),
        ("zmo", "section84"),
        ("ymo", "section84"),
        ("yzmo", "section84"),
    )
    return [
        _row(bag, calibration, expected)
        for bag, calibration in tests
        for expected in expectations(bag, calibration)
        if expected.stated is not None and (calibration == "section84" or expected.source == UNDER_TABLE)
    ]


def _row(bag: Bag, calibration: CalibrationName, expected: Expectation) -> ThesisRow:
    section = _SECTIONS.get(expected.source, expected.source.removeprefix("section "))
    return ThesisRow(
        section,
        f"{bag.upper()}: {expected.angle}, error against the machining centre, {KIND_NAMES[expected.kind]}",
        "urad",
        f"{expected.stated:g}",
        error_figure(offline_motion_test(bag, calibration), expected),
        expected.remark or (_MAP_LOST if expected.angle == "theta" else ""),
    )
