# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses of recorded scans for fits: no scan is rejected, and theta is counted from the first home mark on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.errors import FitError
from posor.estimation.posor import Posor
from posor.model.fault import Fault, State
from posor.model.scan import STATED_HOME

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.estimation.estimate import Estimates
    from posor.model.scan import Scans


def posor_without_rejection(calibration: Calibration) -> Posor:
    """Return an estimator that rejects no scan by its motion or its residuals: a fit judges them."""
    return Posor(calibration.model_copy(update={"motion": None}), false_alarm=0.0)


def count_from_first_mark(posor: Posor, scans: Scans, where: str) -> Scans:
    """Return scans whose first home mark counts theta at once: an operator's confirmation is not recorded.

    A mark at a scan without a pose counts nothing. Scans of a POSOR whose theta is not counted are returned as they
    are. Raises FitError: no scan with a pose saw the mark.
    """
    if not float(posor.settings["period"]) > 0.0:
        return scans
    posor.reset()
    seen = (scans.at_home != 0) & (posor.estimate_all(scans).states != int(State.LOST))
    if not seen.any():
        raise FitError("no scan with a pose saw the home mark", where=where, expected="at least one")
    marks = scans.at_home.copy()
    marks[np.argmax(seen)] = STATED_HOME
    return scans.with_fields({"at_home": marks})


def counted_estimates(posor: Posor, scans: Scans, where: str) -> Estimates:
    """Return the poses of scans of ``count_from_first_mark``; those before the first home mark are UNCOUNTED.

    Raises FitError: from the first home mark on the count is in doubt, so that the mark or the count is wrong.
    """
    posor.reset()
    estimates = posor.estimate_all(scans)
    doubts = (estimates.faults & int(Fault.COUNT)) != 0
    doubts[: np.argmax(scans.at_home == STATED_HOME)] = False
    if doubts.any():
        quarter = 0.25 * float(posor.settings["bump_angle"])
        raise FitError(
            f"the count of bumps is in doubt at scan {scans.numbers[np.argmax(doubts)]}",
            where=where,
            expected=f"home marks at one theta, and scans less than a quarter of a bump, {quarter:.3g} rad, from the "
            "predicted theta",
        )
    return estimates
