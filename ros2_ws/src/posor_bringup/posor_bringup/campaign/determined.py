"""Which step of a campaign measured a number of its calibration file, if any did."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.core.calibration.entries import entries_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.calibration.model import Calibration

NOT_MEASURED = 0.95
"""Standard uncertainty in the end, over that as built, from which on nothing has measured a number."""


def determined(built: Calibration, after: Sequence[Calibration]) -> dict[str, int]:
    """Return the step that measured each number, by the number's name.

    A fit of many numbers states all of them again, so the last one to state a number need not have measured it: it is
    the step that lowered the number's standard uncertainty by the largest ratio, or gave it one. Numbers whose standard
    uncertainty is still that as built are left out.

    Args:
        built: What was known as built.
        after: What was known after each step.

    """
    history = [_sigmas(one) for one in (built, *after)]
    found = {}
    for name, final in history[-1].items():
        course = np.array([sigmas.get(name, 0.0) for sigmas in history])
        if not final > 0.0 or (course[0] > 0.0 and final >= NOT_MEASURED * course[0]):
            continue
        before = np.where(course[:-1] > 0.0, course[:-1], np.inf)  # of what had no uncertainty, nothing was said
        found[name] = int(np.argmax(np.divide(before, course[1:], out=np.zeros_like(before), where=course[1:] > 0.0)))
    return found


def _sigmas(calibration: Calibration) -> dict[str, float]:
    return {
        entry.name: float(entry.quantity.sigmas[entry.index]) for entry in entries_of(calibration) if entry is not None
    }
