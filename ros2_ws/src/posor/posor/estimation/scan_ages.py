# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ages of live scans on arrival: they show steps of the stamps that numbers and stamps do not show.

The age of a scan is the time of its arrival minus its stamp. A restart of the driver can hide a step: if it has lasted
longer than a step back, the stamps go on forward. The least age of the scans, which depends little on the load of the
host, then differs from that before. It is compared while the next MEMORY_SCANS come, and at least for WATCH_S.

The ages are compared likewise behind a gap in the scan numbers, because a clock that numbers the scans as well may have
been set in it, and where a scan is older than the last one after AWAY_S without an arrival. Behind a gap shorter than
AWAY_S only younger scans count, a step forward: a loaded host makes them older. Within the first MEMORY_SCANS of a line
only older ones behind a longer gap do: the scans of a queue that was full at the start become younger. Behind a further
gap, a scan as young as those before the first gap shows that the scans between were late, as after a stop of the node
that receives them: the stamps are right, and the time between them counts.

They are compared as well after scans that repeated numbers, of which the first may be missing.
"""

from __future__ import annotations

import math
from typing import Any

from posor.numerics.compiled import in_place

MEMORY_SCANS = 256  # of the line through numbers and stamps (``clocks``), and of scans whose ages are compared
AWAY_S = 0.1  # without a scan on arrival [s], after which older scans show a step as well
WATCH_S = 1.0  # least time for which ages are compared [s]
CLOCK_DRIFT = 1e-4  # largest drift of one clock against another, as a share of the time
AGE_UNIT_S = 2.0**-30  # of steps that ages show [s]: their sums and differences are exact
LEAST_STEP_S, LEAST_STEP_PERIODS = 5e-3, 0.5  # smallest change of the least age that is a step: the larger


@in_place
def begin_ages(clocks: Any) -> None:
    """Begin with the age of the first scan."""
    clocks.least_age, clocks.former_age = clocks.age, math.nan


@in_place
def use_age(clocks: Any) -> None:
    """Use the age of a scan in order."""
    clocks.last_age = clocks.age
    clocks.least_age += CLOCK_DRIFT * clocks.period
    if not clocks.age > clocks.least_age:
        clocks.least_age = clocks.age
    if not math.isnan(clocks.former_age):
        _compare_ages(clocks)


@in_place
def compare_after_restart(clocks: Any, step: float, elapsed: float) -> None:
    """Compare the ages from now on with those before a restart that has shown a ``step`` [s] already."""
    clocks.compared, clocks.only_older, clocks.age_tolerance = 0, 0, CLOCK_DRIFT * max(elapsed, 0.0)
    clocks.former_age = step + (clocks.least_age if math.isnan(clocks.former_age) else clocks.former_age)


@in_place
def compare_after_repetition(clocks: Any) -> None:
    """Compare the ages from now on with those before scans that repeated numbers: the first of these may be missing."""
    if math.isnan(clocks.former_age):
        _begin_comparison(clocks, clocks.least_age, 1)
    clocks.former_age += clocks.set_back
    clocks.compared, clocks.least_age = 0, clocks.run_age


@in_place
def _begin_comparison(clocks: Any, former_age: float, only_older: int) -> None:
    """Begin to compare the least age with a former one; ``only_older``: younger scans are no step."""
    clocks.former_age, clocks.age_step, clocks.age_tolerance = former_age, 0.0, 0.0
    clocks.only_older = only_older


@in_place
def watch_ages(clocks: Any, elapsed: float) -> float:
    """Compare the ages behind a gap of ``elapsed`` [s] with those before; in a comparison, with those before that.

    Return by how much the first scan shows the clock of numbers and stamps to have been set forward in the gap [s].
    """
    is_compared = not math.isnan(clocks.former_age)
    usual = min(clocks.least_age, clocks.former_age) if is_compared else clocks.least_age
    younger, is_away = usual - clocks.age, elapsed >= AWAY_S
    if clocks.fitted < MEMORY_SCANS and not (is_away and -younger > _least_age_step(clocks)):
        return 0.0
    if not is_compared:
        _begin_comparison(clocks, usual, 1 if clocks.fitted < MEMORY_SCANS else 0)
    if is_away or not is_compared:
        clocks.age_tolerance += CLOCK_DRIFT * elapsed
        clocks.compared = 0
    if is_away:
        clocks.least_age = math.inf
    return float(min(younger, elapsed)) if younger > _least_age_step(clocks) else 0.0


@in_place
def unseen_time(clocks: Any, elapsed: float) -> float:
    """Return how much older on arrival a scan is than the last one, if none has arrived for AWAY_S [s]; else 0.

    The clock of numbers and stamps stood still or was set back meanwhile, as on a host that was paused. A late scan
    looks the same; the next scans are then younger again.
    """
    older = clocks.age - clocks.last_age
    return float(older) if older > _least_age_step(clocks) and elapsed + older >= AWAY_S else 0.0


@in_place
def _least_age_step(clocks: Any) -> float:
    """Return the least change of the least age that shows a step of the stamps [s]."""
    return float(max(LEAST_STEP_S, LEAST_STEP_PERIODS * clocks.period) + clocks.age_tolerance)


@in_place
def _compare_ages(clocks: Any) -> None:
    """Correct the step of the stamps in a restart or a gap by the ages of the scans since then."""
    change = clocks.least_age - clocks.former_age
    if clocks.only_older == 0:
        change = abs(change)
    shown = float(round(change / AGE_UNIT_S)) * AGE_UNIT_S if change > _least_age_step(clocks) else 0.0
    clocks.step += shown - clocks.age_step
    clocks.age_step = shown
    clocks.compared += 1
    if clocks.compared >= max(MEMORY_SCANS, WATCH_S / clocks.period):
        clocks.former_age, clocks.age_step, clocks.age_tolerance = math.nan, 0.0, 0.0
