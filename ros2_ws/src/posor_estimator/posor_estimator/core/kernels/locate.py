"""One scan: solve, judge, remember."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from posor_estimator.core.compiled import in_place, inlined
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.kernels.chain_pose import write_pose
from posor_estimator.core.kernels.effects import reading_covariance
from posor_estimator.core.kernels.judge import chi_square, covariances
from posor_estimator.core.kernels.matrix import matrix
from posor_estimator.core.kernels.memory import (
    BUMP,
    COUNTED,
    GIVEN,
    INTERVAL,
    KNOWN,
    LAGGING,
    LIMIT,
    MOTION_TRANSLATION,
    RATE,
    STAMP,
    THETA,
    bumps_off,
    carry_on,
    goes_on,
    remember,
    remember_motion,
    theta_of,
    theta_remembered,
    turn_about_z,
    wrapped,
)
from posor_estimator.core.kernels.motion import prior_rows, share_moved
from posor_estimator.core.kernels.rows import by_parameters, turn_row
from posor_estimator.core.kernels.solve import CONVERGED, ILL_CONDITIONED, ITERATIONS, NOT_CONVERGED, newton
from posor_estimator.core.kernels.tables import (
    BY_ROW,
    FACTORS,
    JACOBIAN,
    KINDS,
    LINES,
    MEMORY,
    MOVED,
    PREPARED,
    RESIDUALS,
    ROWS,
    SETTINGS,
    START,
    VALUES,
    VARIANCES,
    WEIGHTS,
    line,
    table,
)
from posor_estimator.core.kernels.vector import at

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

OK, DEGRADED, LOST, UNCOUNTED = (int(state) for state in (State.OK, State.DEGRADED, State.LOST, State.UNCOUNTED))

FAULT_NOT_CONVERGED = int(Fault.NOT_CONVERGED)
FAULT_ILL_CONDITIONED = int(Fault.ILL_CONDITIONED)
FAULT_RESIDUAL = int(Fault.RESIDUAL)
FAULT_INNOVATION = int(Fault.INNOVATION)
FAULT_COUNT = int(Fault.COUNT)

POSE, NATIVE, RESIDUAL, FIGURES = 0, 7, 13, 14
"""Figures of a scan: pose (x, y, z, quaternion x, y, z, w), six native coordinates, chi-square, see ``Estimates``."""

TURN_SETTLED = 1e-14
SINGULAR = 1e-10
"""Below this share (``kernels.blocks``) of an unknown that the others do not explain, there is no pose."""
WEAK = 1e-4
"""Below this share the last pose is called in to carry the blind direction: its uncertainty is 100 times the usual."""


@in_place
def solve_scan(
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    count: int,
    rotation: FloatArray,
    translation: FloatArray,
    least_share: float,
    lag_from: float,
) -> int:
    """Solve the first ``count`` rows; where ``lag_from`` is a number, with the tilts turned as at that theta.

    See ``TiltAngle``. Rotation and translation are start and result, the rest stands in the tables.
    """
    kinds, rows, prepared = line(places, ints, KINDS, 0), table(places, floats, ROWS), table(places, floats, PREPARED)
    turn = 0.0
    for _ in range(ITERATIONS):
        outcome = newton(
            kinds,
            rows,
            prepared,
            line(places, floats, LINES, VALUES),
            line(places, floats, LINES, WEIGHTS),
            count,
            rotation,
            translation,
            table(places, floats, JACOBIAN),
            line(places, floats, LINES, RESIDUALS),
            line(places, floats, MOVED, 0),
            table(places, floats, FACTORS),
            least_share,
        )
        if outcome != CONVERGED or not math.isfinite(lag_from):
            return outcome
        change = wrapped(lag_from - theta_of(rotation)) - turn
        if abs(change) < TURN_SETTLED:
            return outcome
        turn += change
        for r in range(count):
            turn_row(kinds[r], turn, rows, r, prepared)
    return NOT_CONVERGED


@inlined
def write_native(rotation: FloatArray, translation: FloatArray, theta: float, out: FloatArray, start: int) -> None:
    """Write the six native coordinates of a pose (``core.native``), theta as counted, into ``out`` from ``start``."""
    for i in range(3):
        out[start + i] = translation[i]
    out[start + 3] = math.asin(max(-1.0, min(1.0, -rotation[1, 2])))
    out[start + 4] = math.atan2(rotation[0, 2], rotation[2, 2])
    out[start + 5] = theta


@inlined
def keep(rotation: FloatArray, translation: FloatArray, start: FloatArray) -> None:
    """Write a pose into ``start`` (4, 3)."""
    for j in range(3):
        for i in range(3):
            start[i, j] = rotation[i, j]
        start[3, j] = translation[j]


@inlined
def bring_back(start: FloatArray, rotation: FloatArray, translation: FloatArray) -> None:
    """Write the pose that ``keep`` has kept back."""
    for j in range(3):
        for i in range(3):
            rotation[i, j] = start[i, j]
        translation[j] = start[3, j]


@inlined
def unknown(memory: FloatArray) -> None:
    """Forget the last pose and the count."""
    memory[KNOWN] = 0.0
    memory[COUNTED] = 0.0


@inlined
def locate_scan(  # noqa: C901, PLR0912, PLR0915  the steps of one scan, in order, to be compiled
    places: IntArray,
    ints: IntArray,
    floats: FloatArray,
    m: int,
    stamp: float,
    at_home: bool,  # noqa: FBT001  kernels take no keywords
    carried_on: bool,  # noqa: FBT001
    rotation: FloatArray,
    translation: FloatArray,
    random: FloatArray,
    systematic: FloatArray,
    figures: FloatArray,
) -> tuple[int, int]:
    """Locate one scan and update the memory with it.

    Rows, values and variances stand in the tables. So does, in READINGS (m, m), what of the readings' systematic
    covariance does not come from ``kernels.effects``.

    Args:
        places: See ``kernels.tables``.
        ints: See ``kernels.tables``.
        floats: See ``kernels.tables``.
        m: Number of readings.
        stamp: Time of the scan [s].
        at_home: Whether the scan saw the home mark.
        carried_on: Whether the start is the memory's: then the motion before is taken to go on, and the tilts are
            turned by the theta of the scan before where the settings say so.
        rotation: Start and result, shape (3, 3).
        translation: Start and result [m], shape (3,).
        random: Random covariance to write, shape (6, 6).
        systematic: Systematic covariance to write, shape (6, 6).
        figures: See ``FIGURES`` to write, shape (14,); of a LOST scan only the chi-square, NaN where there is none.

    Returns:
        State and faults.

    """
    figures[RESIDUAL] = math.nan
    settings, memory = line(places, floats, SETTINGS, 0), line(places, floats, MEMORY, 0)
    variances, weights = line(places, floats, LINES, VARIANCES), line(places, floats, LINES, WEIGHTS)
    kinds, rows, prepared = line(places, ints, KINDS, 0), table(places, floats, ROWS), table(places, floats, PREPARED)
    elapsed = stamp - memory[STAMP]
    moving = memory[KNOWN] > 0.0 and memory[GIVEN] == 0.0
    counting = settings[BUMP] > 0.0
    for r in range(m):
        weights[r] = 1.0 / variances[r]
    start = table(places, floats, START)
    keep(rotation, translation, start)
    predicted = theta_of(rotation) if counting else 0.0
    lag_from = theta_remembered(memory) if carried_on and settings[LAGGING] > 0.0 and moving else math.nan
    carried = moving and settings[MOTION_TRANSLATION] < math.inf
    if carried_on and moving and goes_on(elapsed, memory):
        carry_on(elapsed, settings, memory, rotation, translation)
    used = m
    faults = 0
    least = WEAK if carried else SINGULAR
    outcome = solve_scan(places, ints, floats, m, rotation, translation, least, lag_from)
    if outcome == ILL_CONDITIONED and carried:
        # Blind in some direction: the last pose, as uncertain as the target can have moved since, carries it over.
        bring_back(start, rotation, translation)
        used = m + 6
        prior_rows(kinds, rows, line(places, floats, LINES, VALUES), weights, m, settings, elapsed)
        outcome = solve_scan(places, ints, floats, used, rotation, translation, SINGULAR, lag_from)
        faults |= FAULT_ILL_CONDITIONED
    if outcome != CONVERGED:
        unknown(memory)
        return LOST, FAULT_ILL_CONDITIONED if outcome == ILL_CONDITIONED else FAULT_NOT_CONVERGED
    if counting and at_home:
        off = bumps_off(theta_of(rotation), settings)
        if off != 0.0:
            moving = False  # the way from the last pose says nothing any more
            if memory[COUNTED] > 0.0:
                faults |= FAULT_COUNT
            turn_about_z(rotation, -off * settings[BUMP])
            used = m
            outcome = solve_scan(places, ints, floats, m, rotation, translation, SINGULAR, math.nan)
            if outcome != CONVERGED:
                unknown(memory)
                return LOST, faults | FAULT_NOT_CONVERGED
        memory[COUNTED] = 1.0
    by_parameters(kinds, rows, prepared, m, rotation, translation, table(places, floats, BY_ROW))
    reading_covariance(places, ints, floats)
    covariances(places, ints, floats, m, rotation, random, systematic)
    figures[RESIDUAL] = 0.0
    if m > 6 and used == m:  # noqa: PLR2004  six unknowns
        figures[RESIDUAL] = chi_square(places, ints, floats, m)
    if not figures[RESIDUAL] <= settings[LIMIT]:
        faults |= FAULT_RESIDUAL
    theta = theta_of(rotation)
    if moving:
        limited = settings[MOTION_TRANSLATION] < math.inf
        if limited and share_moved(settings, elapsed, random, rotation, translation, theta, memory) > 1.0:
            faults |= FAULT_INNOVATION
        if counting:
            reach = max(abs(memory[RATE]) * elapsed, abs(wrapped(theta - predicted)))
            if reach > 0.25 * settings[BUMP]:
                faults |= FAULT_COUNT
                memory[COUNTED] = 0.0
    if faults & (FAULT_RESIDUAL | FAULT_INNOVATION):
        return LOST, faults
    if memory[KNOWN] > 0.0:
        theta = memory[THETA] + wrapped(theta - memory[THETA])
    if moving:
        remember_motion(elapsed, theta, translation, memory)
    memory[INTERVAL] = elapsed if moving else 0.0
    write_pose(matrix(rotation, 0), at(translation, 0), figures)
    write_native(rotation, translation, theta, figures, NATIVE)
    memory[KNOWN] = 1.0
    memory[GIVEN] = 0.0
    memory[STAMP] = stamp
    memory[THETA] = theta
    remember(memory, rotation, translation)
    if counting and memory[COUNTED] == 0.0:
        return UNCOUNTED, faults
    return DEGRADED if faults else OK, faults


@in_place
def deserves_retry(state: int, fault: int, warm: bool) -> bool:  # noqa: FBT001  kernels take no keywords
    """Return whether a lost scan may have been lost because it started from a last pose that was far away."""
    return warm and state == LOST and fault & (FAULT_RESIDUAL | FAULT_NOT_CONVERGED) != 0
