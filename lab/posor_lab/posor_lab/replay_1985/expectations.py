"""Expected figures of each 1985 motion test with each calibration: limits and sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_bringup.installed import Bag, CalibrationName

    from posor_lab.replay_1985.motion_test import Angle


STEPS: Mapping[Bag, int] = {"ymo": 15, "yzmo": 14, "zmo": 20}
"""Number of steps of each test, appendix 8B."""

WITHOUT_POSE: Mapping[Bag, Mapping[int, str]] = {
    "ymo": {},
    "yzmo": {14: "no digit of its diode readings is legible, and the estimates lie outside the calibrated map"},
    "zmo": {},
}
"""Steps that must be refused, and the reason."""

KIND_NAMES: Mapping[Literal["sd", "max"], str] = {"sd": "standard deviation", "max": "largest"}
"""Name of each kind of figure."""

PRINTED_LIMITS: Mapping[Angle, float] = {"alpha": 1.0, "beta": 1.0, "theta": 6.0}
"""Largest difference from a printed POSOR column [urad]: rounding, and for theta the error of the derived diode map."""

DERIVED_MAP = "limit: the 1985 diode map is lost, and the derived one leaves some urad"

MEASURED_LIMIT = 1.0
"""Largest difference from a printed machining-centre column [urad]: rounding of the table and of its inputs."""

FITTED = "not independent: the derived diode map was fitted to this test's printed theta"
LOCAL_MAP = "the 1985 diode map is lost; the derived one is local, so the text's figure is an upper limit"
SAME_STATE = "no printed column is here; limit: the sd printed for YMO in the same state, whose probes travel further"
SUBSTITUTE = "the 1985 diode map is lost and the derived one is local"
UNCOMPENSATED = (
    "grows with the motion, because the zero shifts of the probes are not compensated, as in the printed tables: "
    "calibration 'section84' compensates them"
)
OFFSET = (
    "beta exceeds the machining centre's by a nearly constant 60 urad from step 2 on; all three probes support the "
    "readings of step 1, so no digit was changed for it"
)


@dataclass(frozen=True)
class Expectation:
    """One figure of the error against the machining centre.

    Attributes:
        angle: The angle.
        kind: Standard deviation or largest magnitude, over all steps that gave a pose.
        stated: Figure of the thesis [urad]; None: the thesis states none.
        low: Lower limit [urad].
        high: Upper limit [urad]; None: the figure is not judged.
        source: Place in the thesis.
        remark: Reason of the limit, or of its absence.

    """

    angle: Angle
    kind: Literal["sd", "max"]
    stated: float | None
    low: float = 0.0
    high: float | None = None
    source: str = ""
    remark: str = ""


def _around(
    angle: Angle,
    kind: Literal["sd", "max"],
    stated: float,
    value: float,
    tolerance: float,
    source: str,
    remark: str = "",
) -> Expectation:
    return Expectation(angle, kind, stated, round(value - tolerance, 9), round(value + tolerance, 9), source, remark)


UNDER_TABLE = "appendix 8B, printed under the Y motion results"
"""Source of the standard deviations of YMO without compensated zero shifts."""
UNSTATED = "the thesis states no figure"
_ZMO = (
    Expectation("beta", "sd", None, remark=f"{UNSTATED}; {OFFSET}"),
    _around("theta", "sd", 66.0, 65.0, 2.0, "section 8.4.1"),
    Expectation("theta", "max", 68.0, source="section 8.4.1", remark=SUBSTITUTE),
)

EXPECTATIONS: Mapping[tuple[Bag, CalibrationName], tuple[Expectation, ...]] = {
    ("ymo", "printed"): (
        _around("alpha", "sd", 51.0, 51.0, 1.0, UNDER_TABLE, UNCOMPENSATED),
        _around("beta", "sd", 76.0, 76.0, 1.0, UNDER_TABLE, UNCOMPENSATED),
        Expectation("theta", "sd", 179.0, source="section 8.4.2", remark=FITTED),
    ),
    ("ymo", "section84"): (
        _around("alpha", "max", 25.0, 25.0, 1.0, "section 8.4.2"),
        _around("beta", "sd", 4.0, 4.3, 0.3, "section 8.4.2"),
        Expectation("theta", "sd", 179.0, source="section 8.4.2", remark=FITTED),
        Expectation("theta", "max", 230.0, source="section 8.4.2", remark=FITTED),
    ),
    ("yzmo", "printed"): (
        Expectation("alpha", "sd", None, 0.0, 51.0, UNDER_TABLE, SAME_STATE),
        Expectation("beta", "sd", None, 0.0, 76.0, UNDER_TABLE, SAME_STATE),
        Expectation("theta", "sd", 92.0, 0.0, 92.0, "section 8.4.3", LOCAL_MAP),
        Expectation("theta", "max", 112.0, source="section 8.4.3", remark=SUBSTITUTE),
    ),
    ("yzmo", "section84"): (
        _around("alpha", "sd", 3.0, 2.7, 0.3, "section 8.4.3"),
        _around("beta", "sd", 7.0, 7.5, 0.3, "section 8.4.3"),
        Expectation("theta", "sd", 92.0, 0.0, 92.0, "section 8.4.3", LOCAL_MAP),
        Expectation("theta", "max", 112.0, source="section 8.4.3", remark=SUBSTITUTE),
    ),
    ("zmo", "printed"): (Expectation("alpha", "sd", None, remark=UNSTATED), *_ZMO),
    ("zmo", "section84"): (
        Expectation("alpha", "sd", None, remark=f"{UNSTATED}; alpha drifts: the flatness .083333 in does not suit it"),
        *_ZMO,
    ),
}
