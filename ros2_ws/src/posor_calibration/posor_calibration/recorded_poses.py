# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses of recorded scans for fits: no scan is rejected, and theta is counted from the first home mark on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.estimation.posor import Posor
from posor.model.scan import STATED_HOME

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans


def unlimited_posor(calibration: Calibration) -> Posor:
    """Return an estimator that rejects no scan by its motion or its residuals: a fit judges them."""
    return Posor(calibration.model_copy(update={"motion": None}), false_alarm=0.0)


def count_from_first_mark(scans: Scans) -> Scans:
    """Return scans whose first home mark counts theta at once: there is no operator who would state it."""
    homes = np.flatnonzero(scans.at_home)
    if not homes.size:
        return scans
    marks = scans.at_home.copy()
    marks[homes[0]] = STATED_HOME
    return scans.with_fields({"at_home": marks})
