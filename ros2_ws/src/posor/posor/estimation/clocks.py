# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Two clocks of a stream of scans: the scan numbers and the stamps, and the line between them.

Scan numbers count the ticks of the scan clock; stamps are the time of exposure by the ROS clock. The line ``stamp = a +
period * number`` is fitted recursively by least squares (the gains of a growing-memory filter of degree one, later with
a memory of MEMORY_SCANS; A. Gelb, Applied Optimal Estimation, 1974). A stamp that is further from the line than the
scatter of the stamps explains contradicts the numbers: the scan is refused. Where LATE_RUN scans in a row contradict
the old line and agree with one another, the clock was set, and the line continues from there. A scan whose number does
not come after the last one is late and refused alone; a run of such scans is a restart.

The tracker has a time of its own that only moves forward, so a step of the clock never changes the elapsed time:

* in general it advances by the difference of the stamps;
* where the stamps scatter and the source does not state their uncertainty, by the numbers times the period;
* where n scans in a row repeat the last numbers, because both clocks were set back, by n + 1 intervals more than the
  stamps show;
* where the two clocks contradict each other, by the smaller of both, which accepts the least motion, but at least by an
  interval for each refused scan; after a change of the rate, by the stamps. A count of theta is given up.

Where more than SCATTER_SHARE of the last scans are off the line, by at most GREATEST_DEVIATION, and contradict each
other, their stamps scatter.

A step of the stamps shows that they were or are wrong by as much. Until an acknowledgement, the largest error of the
stamps is taken as at least the sum of these steps; the ages of live scans show further ones (``scan_ages``).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.estimation.scan_ages import (
    CLOCK_DRIFT,
    MEMORY_SCANS,
    begin_ages,
    compare_after_repetition,
    compare_after_restart,
    unseen_time,
    use_age,
    watch_ages,
)
from posor.model.fault import Fault
from posor.numerics.compiled import in_place
from posor.numerics.vector import square

if TYPE_CHECKING:
    from posor.estimation.workspace import Model
    from posor.numerics.array_types import FloatArray

IN_ORDER, LATE, CONTRADICTORY = 0, -103, -104
"""Results of ``follow_clocks``, and codes of the estimate of a refused scan."""
CLOCK_STEP_S = 1.0  # step back of the stamps [s] that, with numbers that go back, shows a new start of a recording
SETTLING_SCANS = 4  # a line of fewer scans allows for GREATEST_DEVIATION
FITTED_SCANS = 16  # a stamp off a line of fewer scans begins a new line; off a line of more, its scan is refused
NEW_RATE_RUN = 14  # scans in a row off the line after which a new line begins, because their rate is another one
FAILED_LINES = 3  # lines in a row, left within FITTED_SCANS, after which the stamps scatter
LATE_RUN = 10  # scans in a row, below the last number or off the line, that are a restart or a clock that was set
RESTART_RUN = 3  # the same where the numbers are RESTART_NUMBERS, or the stamps CLOCK_STEP_S, before the last
RESTART_NUMBERS = 64
SHARE_MEMORY = 64.0  # scans over which the share of scans off the line is averaged
SCATTER_SHARE = 0.2  # above this share the stamps scatter; NEW_RATE_RUN scans in a row stay below it
LEAST_DEVIATION, GREATEST_DEVIATION = 0.5, 8.0  # limits of the deviation that contradicts the line, in periods
SCATTER_SIGMAS = 5.0  # standard deviations of the scatter that a stamp may deviate from the line
DEVIATION_SIGMAS = 3.0  # the deviation of one stamp counts as at most as many standard deviations
INNOVATION_FAULT = int(Fault.INNOVATION)
TIMELESS_FAULTS = int(Fault.TRAVEL | Fault.RESIDUAL)  # whatever the times of the scans are
SCATTER_LIMIT = 0.02  # scatter in periods above which an unstated stamp is replaced by its number times the period


@in_place
def elapsed_at(tracker: Any, scan: Any) -> float:
    """Return the time from the previous pose to a scan whose readings are not used, by its stamp [s]."""
    since_last = (scan.stamp_ns - tracker.epoch_ns) * 1e-9 - tracker.clocks.stamp
    return float(tracker.time - tracker.stamp + since_last)


@in_place
def is_late(tracker: Any, scan: Any) -> bool:
    """Return whether neither number nor stamp of a scan comes after those of the last scan in order."""
    clocks = tracker.clocks
    stamp = (scan.stamp_ns - tracker.epoch_ns) * 1e-9
    return bool(clocks.fitted > 0 and scan.number <= clocks.number and stamp <= clocks.stamp)


@in_place
def _content_of(scan: Any) -> float:
    """Return the sum of the raw readings of a scan, which differs from scan to scan by their noise."""
    return float(_sum_of(scan.gap_voltages) + _sum_of(scan.ring_voltages) + _sum_of(scan.diode_currents))


@in_place
def _sum_of(readings: FloatArray) -> float:
    """Return the sum of the readings that are numbers."""
    total = 0.0
    for i in range(readings.shape[0]):
        if not math.isnan(readings[i]):
            total += readings[i]
    return total


@in_place
def scatter_of(tracker: Any) -> float:
    """Return the standard deviation of the stamps from the line [s]; zero before the third scan of a line."""
    clocks = tracker.clocks
    return math.sqrt(clocks.variance) if clocks.fitted >= 3 else 0.0  # noqa: PLR2004  two scans fit any line


@in_place
def stamp_is_valid(scan: Any) -> bool:
    """Return whether the uncertainty and the limit that a scan states of its stamp are valid."""
    return bool(0.0 <= scan.stamp_uncertainty < math.inf and 0.0 <= scan.stamp_limit < math.inf)


@in_place
def stamp_sigma(tracker: Any, scan: Any) -> float:
    """Return the standard uncertainty of a stamp [s]: the stated one, else the scatter of the stamps.

    Where stamps begin to scatter, the deviation of the present one is more than the scatter of those before explains.
    """
    if scan.stamp_uncertainty > 0.0:
        return float(scan.stamp_uncertainty)
    return float(max(scatter_of(tracker), tracker.clocks.deviation / DEVIATION_SIGMAS))


@in_place
def _uses_numbers(tracker: Any, scan: Any) -> bool:
    """Return whether time is taken from the numbers, because unstated stamps scatter."""
    stated = scan.stamp_uncertainty > 0.0
    return bool(not stated and scatter_of(tracker) > SCATTER_LIMIT * tracker.clocks.period)


@in_place
def motion_allowance(tracker: Any, scan: Any) -> float:
    """Return the time [s] by which the elapsed time may be longer than the tracker's, because stamps scatter."""
    return SCATTER_SIGMAS * scatter_of(tracker) if _uses_numbers(tracker, scan) else 0.0


@in_place
def _begin_line(clocks: Any, scan: Any, stamp: float) -> None:
    """Begin a new line at a scan; until the next scan, its period is that of the line before."""
    clocks.fitted, clocks.variance, clocks.deviation = 1, 0.0, 0.0
    clocks.line = stamp
    _accept(clocks, scan, stamp)


@in_place
def _accept(clocks: Any, scan: Any, stamp: float) -> None:
    clocks.number, clocks.stamp, clocks.content = scan.number, stamp, _content_of(scan)
    clocks.refused, clocks.late, clocks.agreeing, clocks.set_back = 0, 0, 0, 0.0
    use_age(clocks)


@in_place
def _agrees_with_run(clocks: Any, scan: Any, stamp: float) -> bool:
    """Return whether a scan agrees with the first of those in a row, late or refused, before it."""
    steps = float(scan.number - clocks.run_number)
    since = stamp - clocks.run_stamp
    agrees = clocks.agreeing > 0 and scan.number > clocks.refused_number and stamp > clocks.refused_stamp
    return bool(agrees and (clocks.fitted <= 1 or abs(since - steps * clocks.period) <= _tolerance(clocks, 1.0)))


@in_place
def _follow_run(clocks: Any, scan: Any, stamp: float) -> None:
    """Count the scans in a row, late or refused, that agree with the first of them."""
    agrees = _agrees_with_run(clocks, scan, stamp)
    clocks.refused += 1
    clocks.agreeing = clocks.agreeing + 1 if agrees else 1
    if not agrees:
        clocks.run_number, clocks.run_stamp, clocks.run_age = scan.number, stamp, clocks.age
    elif clocks.age < clocks.run_age:
        clocks.run_age = clocks.age
    clocks.refused_number, clocks.refused_stamp = scan.number, stamp


@in_place
def _least_elapsed(clocks: Any) -> float:
    """Return the least time since the last scan in order: an interval for each scan that was refused since."""
    return float(clocks.refused * clocks.period)


@in_place
def follow_clocks(model: Model, scan: Any) -> int:
    """Advance the tracker's time to a scan, unless it is a retry; return IN_ORDER, or why the scan is refused."""
    if model.workspace[0].is_retry:
        return IN_ORDER
    tracker = model.workspace[0].tracker
    clocks = tracker.clocks
    stamp = (scan.stamp_ns - tracker.epoch_ns) * 1e-9
    elapsed = stamp - clocks.stamp
    unnumbered = clocks.fitted == 1 and scan.number == clocks.number
    if clocks.fitted == 0:
        begin_ages(clocks)
    if clocks.fitted == 0 or (unnumbered and elapsed > 0.0):
        tracker.time = tracker.time + elapsed if unnumbered else stamp
        _begin_line(clocks, scan, stamp)
        return IN_ORDER
    if scan.number <= clocks.number:
        return _follow_back(model, scan, stamp, elapsed)
    steps = float(scan.number - clocks.number)
    deviation = stamp - (clocks.line + steps * clocks.period)
    off_line = clocks.fitted > 1 and abs(deviation) > _tolerance(clocks, steps)
    # Scans off the line that agree with one another are no scatter: the clock may have been set.
    scatters = off_line and not _agrees_with_run(clocks, scan, stamp)
    if clocks.fitted >= FITTED_SCANS and _begin_to_scatter(clocks, scatters, deviation):
        off_line = False
    if (off_line and clocks.fitted >= FITTED_SCANS) or (elapsed <= 0.0 and (off_line or clocks.fitted == 1)):
        return _refuse(model, scan, stamp, elapsed)
    if off_line:
        tracker.time += elapsed
        _begin_again(model, scan, stamp, abs(deviation))
        return IN_ORDER
    missing, unseen = _missing_time(clocks, elapsed), unseen_time(clocks, elapsed)
    ahead = watch_ages(clocks, elapsed + unseen) if steps > 1.0 or unseen > 0.0 else 0.0
    clocks.step += missing
    if clocks.set_back > 0.0:
        compare_after_repetition(clocks)
    if clocks.fitted > 1 and abs(deviation) > _tolerance(clocks, 1.0):
        clocks.line = stamp  # the clocks drifted while no scan came
    else:
        _fit(clocks, steps, deviation)
        _hold(tracker)
    by_numbers = _uses_numbers(tracker, scan) or elapsed <= 0.0
    passed = steps * clocks.period if by_numbers else elapsed
    tracker.time += max(passed - ahead, min(passed, clocks.period)) + missing + unseen
    _accept(clocks, scan, stamp)
    return IN_ORDER


@in_place
def _missing_time(clocks: Any, elapsed: float) -> float:
    """Return the time before a scan in order [s] that neither its number nor its stamp shows."""
    missing = 0.0
    if clocks.fitted == 1 and clocks.refused > 0:  # the stamps stood
        missing = max(0.0, _least_elapsed(clocks) + clocks.period - elapsed)
    return float(max(missing, clocks.set_back))


@in_place
def _begin_to_scatter(clocks: Any, scatters: bool, deviation: float) -> bool:  # noqa: FBT001  kernels take no keywords
    """Return whether a stamp that scatters is one of too many; the scatter of the line then allows for it."""
    clocks.off_line += ((1.0 if scatters else 0.0) - clocks.off_line) / SHARE_MEMORY
    near = abs(deviation) <= GREATEST_DEVIATION * clocks.period
    if not (scatters and near and clocks.off_line > SCATTER_SHARE):
        return False
    clocks.step += abs(deviation)
    clocks.fitted, clocks.variance = FITTED_SCANS, square(deviation) / 12.0
    return True


@in_place
def _begin_again(model: Model, scan: Any, stamp: float, deviation: float) -> None:
    """Begin a new line at a scan that is ``deviation`` [s] off a line of fewer than FITTED_SCANS, which is a step.

    The third time in a row the stamps scatter; the period is then that of the scans since the first time. If no line
    has held before, the elapsed times were wrong since the first scan: the recording begins here, without a step.
    """
    tracker = model.workspace[0].tracker
    clocks = tracker.clocks
    clocks.failed += 1
    first_number, first_stamp = clocks.first_number, clocks.first_stamp
    if clocks.failed == 1:
        clocks.first_number, clocks.first_stamp = scan.number, stamp
    _begin_line(clocks, scan, stamp)
    clocks.deviation = deviation
    clocks.step += deviation
    if clocks.failed < FAILED_LINES:
        return
    clocks.period = (stamp - first_stamp) / float(scan.number - first_number)
    clocks.fitted, clocks.variance = FITTED_SCANS, square(deviation) / 12.0
    if not clocks.held:
        clocks.step = 0.0
        _begin_recording(tracker)


@in_place
def _begin_recording(tracker: Any) -> None:
    """Forget pose, count and latches of the motion, because the elapsed times were wrong since the first scan."""
    tracker.initialised, tracker.counted, tracker.theta = 0, 0, 0.0
    tracker.latch &= TIMELESS_FAULTS


@in_place
def _hold(tracker: Any) -> None:
    """Hold a line that FITTED_SCANS agree with.

    Where the stamps of the first such line scatter, a jump that was latched before came from the stamps, not the pose.
    """
    clocks = tracker.clocks
    if clocks.fitted != FITTED_SCANS:
        return
    scatters = math.sqrt(clocks.variance) > SCATTER_LIMIT * clocks.period
    if scatters and not clocks.held and tracker.latch == INNOVATION_FAULT:
        _begin_recording(tracker)
    clocks.held, clocks.failed = 1, 0


@in_place
def _tolerance(clocks: Any, steps: float) -> float:
    """Return the deviation from the line [s] beyond which a stamp contradicts its number, ``steps`` after the last."""
    if clocks.fitted < SETTLING_SCANS:
        return float(GREATEST_DEVIATION * clocks.period)
    scatter = SCATTER_SIGMAS * math.sqrt(clocks.variance)
    least = min(max(LEAST_DEVIATION * clocks.period, scatter), GREATEST_DEVIATION * clocks.period)
    # The standard uncertainty of the period is that of a stamp times sqrt(12 / n^3), n scans fitted
    of_period = scatter * math.sqrt(12.0 / (clocks.fitted * clocks.fitted * clocks.fitted))
    return float(least + (steps - 1.0) * (CLOCK_DRIFT * clocks.period + of_period))


@in_place
def _fit(clocks: Any, steps: float, deviation: float) -> None:
    """Add a scan to the line, ``steps`` numbers after the last one and ``deviation`` [s] off the predicted line."""
    clocks.deviation = abs(deviation) if clocks.fitted > 1 else 0.0
    clocks.fitted = min(clocks.fitted + 1, MEMORY_SCANS)
    n = clocks.fitted
    if n > 2:  # noqa: PLR2004  two scans fit any line
        # The innovation has the variance of a stamp times 1 + 2 (2 n - 1) / ((n - 1)(n - 2)), n - 1 scans fitted before
        share = 1.0 + 2.0 * (2.0 * n - 1.0) / ((n - 1.0) * (n - 2.0))
        clocks.variance += (square(deviation) / share - clocks.variance) / (n - 2.0)
    clocks.line += steps * clocks.period + 2.0 * (2.0 * n - 1.0) / (n * (n + 1.0)) * deviation
    clocks.period += 6.0 / (n * (n + 1.0)) * deviation / steps


@in_place
def _refuse(model: Model, scan: Any, stamp: float, elapsed: float) -> int:
    """Refuse a scan whose stamp contradicts its number, unless it ends a run: the clock was set, or the rate changed.

    LATE_RUN scans in a row that agree with one another are a clock that was set, NEW_RATE_RUN others another rate.
    """
    tracker = model.workspace[0].tracker
    clocks = tracker.clocks
    _follow_run(clocks, scan, stamp)
    has_new_rate = clocks.refused >= NEW_RATE_RUN
    if clocks.agreeing < LATE_RUN and not has_new_rate:
        return CONTRADICTORY
    by_numbers, least = float(scan.number - clocks.number) * clocks.period, _least_elapsed(clocks)
    clocks.step += max(abs(elapsed - by_numbers), least - elapsed)
    if elapsed <= 0.0 or (elapsed > by_numbers and not has_new_rate):
        tracker.time += max(by_numbers, least)
    else:
        tracker.time += max(elapsed, least)
    _doubt_count(model)
    clocks.line = stamp
    if has_new_rate:
        _begin_line(clocks, scan, stamp)
    _accept(clocks, scan, stamp)
    return IN_ORDER


@in_place
def _follow_back(model: Model, scan: Any, stamp: float, elapsed: float) -> int:
    """Refuse a late scan, unless it ends a run of scans with earlier numbers: the driver or a recording restarted.

    Only a recording that starts over forgets the previous pose: its stamps go back by more than CLOCK_STEP_S, or along
    the line with its numbers. Where the scans are older on arrival by more than half of what their stamps are still
    back, the clock that numbers and stamps them was set.
    """
    tracker = model.workspace[0].tracker
    clocks = tracker.clocks
    advances = scan.number >= clocks.refused_number and stamp > clocks.refused_stamp
    clocks.late = clocks.late + 1 if clocks.late > 0 and advances else 1
    _follow_run(clocks, scan, stamp)
    is_restart_step = clocks.number - scan.number >= RESTART_NUMBERS or elapsed < -CLOCK_STEP_S
    if clocks.late < (RESTART_RUN if is_restart_step else LATE_RUN):
        is_last = scan.number == clocks.number and abs(elapsed) < LEAST_DEVIATION * clocks.period
        if is_last and (clocks.run_number < clocks.number or _content_of(scan) != clocks.content):
            # n numbers came again: both clocks were set back by less than n + 1 intervals
            clocks.set_back = (float(clocks.number - clocks.run_number) + 2.0) * clocks.period
        return LATE
    least = _least_elapsed(clocks)
    deviation = elapsed + clocks.stamp - clocks.line + float(clocks.number - scan.number) * clocks.period
    is_earlier = elapsed < 0.0 and clocks.fitted > 1 and abs(deviation) <= _tolerance(clocks, 1.0)
    tracker.time += max(elapsed, least)
    step = 0.0
    was_set = clocks.run_age - clocks.least_age > -0.5 * elapsed > 0.0
    if (elapsed < -CLOCK_STEP_S or is_earlier) and not was_set:
        tracker.initialised, tracker.counted, tracker.theta = 0, 0, 0.0
        tracker.signature_count = 0  # its readings come again
        clocks.former_age, clocks.age_step = math.nan, 0.0
    else:
        if least - elapsed > LEAST_DEVIATION * clocks.period:
            step = least - elapsed
        clocks.step += step
        compare_after_restart(clocks, step, elapsed)
    clocks.least_age = clocks.run_age
    _begin_line(clocks, scan, stamp)
    if step + clocks.age_step > 0.0:
        _doubt_count(model)
    return IN_ORDER


@in_place
def _doubt_count(model: Model) -> None:
    """Give up a count of theta, because the elapsed time is in doubt."""
    workspace = model.workspace[0]
    if workspace.settings.period > 0.0:
        workspace.tracker.counted = 0
