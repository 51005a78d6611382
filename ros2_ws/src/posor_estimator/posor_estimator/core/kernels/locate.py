"""Scan after scan: solve, judge, remember. The same loop serves one scan at servo rate and a whole bag."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.kernels.judge import chi_square, covariances, reading_covariance
from posor_estimator.core.kernels.memory import (
    BUMP,
    COUNTED,
    GIVEN,
    KNOWN,
    LAGGING,
    LIMIT,
    MOTION_TRANSLATION,
    RATE,
    STAMP,
    THETA,
    bumps_off,
    recall,
    remember,
    restart_if_back,
    start_from_memory,
    theta_of,
    turn_about_z,
    wrapped,
)
from posor_estimator.core.kernels.motion import moved_too_far, prior_rows
from posor_estimator.core.kernels.rows import GAP, SPOT_X, SPOT_Y
from posor_estimator.core.kernels.solve import CONVERGED, ILL_CONDITIONED, ITERATIONS, NOT_CONVERGED, gauss_newton

if TYPE_CHECKING:
    from posor_estimator.core.types import FloatArray, IntArray

OK, DEGRADED, LOST, UNCOUNTED = (int(state) for state in (State.OK, State.DEGRADED, State.LOST, State.UNCOUNTED))

FAULT_NOT_CONVERGED = int(Fault.NOT_CONVERGED)
FAULT_ILL_CONDITIONED = int(Fault.ILL_CONDITIONED)
FAULT_RESIDUAL = int(Fault.RESIDUAL)
FAULT_INNOVATION = int(Fault.INNOVATION)
FAULT_COUNT = int(Fault.COUNT)

TURN_SETTLED = 1e-14
SINGULAR = 1e-10
"""Below this share (``kernels.cholesky``) of an unknown that the others do not explain, there is no pose."""
WEAK = 1e-4
"""Below this share the last pose is called in to carry the blind direction: its uncertainty is 100 times the usual."""


@compiled
def solve_scan(
    kinds: IntArray,
    rows: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    jacobian: FloatArray,
    residuals: FloatArray,
    least_share: float,
    lag_from: float,
) -> int:
    """Solve one scan; where ``lag_from`` is a number, with the tilts turned as at that theta (``TiltAngle``)."""
    moved = np.empty(6)
    turn = 0.0
    for _ in range(ITERATIONS):
        outcome = gauss_newton(
            kinds, rows, values, weights, rotation, translation, jacobian, residuals, moved, least_share
        )
        if outcome != CONVERGED or not math.isfinite(lag_from):
            return outcome
        change = wrapped(lag_from - theta_of(rotation)) - turn
        if abs(change) < TURN_SETTLED:
            return outcome
        turn += change
        for r in range(kinds.shape[0]):
            if kinds[r] == GAP:
                rows[r, 11] = turn
            elif kinds[r] in (SPOT_X, SPOT_Y):
                rows[r, 15] = turn
    return NOT_CONVERGED


@compiled
def locate_scan(  # noqa: C901, PLR0912, PLR0915  the steps of one scan, in order, to be compiled
    kinds: IntArray,
    rows: FloatArray,
    ids: IntArray,
    sigmas: FloatArray,
    values: FloatArray,
    variances: FloatArray,
    systematic_readings: FloatArray,
    stamp: float,
    at_home: bool,  # noqa: FBT001  kernels take no keywords
    settings: FloatArray,
    memory: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    random: FloatArray,
    systematic: FloatArray,
    figures: FloatArray,
) -> tuple[int, int]:
    """Locate one scan and update ``memory`` with it.

    Args:
        kinds: Kind of each row, shape (m + 6,); the last six are room for the prior.
        rows: Parameters of each row, shape (m + 6, width).
        ids: See ``reading_covariance``, shape (m, width).
        sigmas: See ``reading_covariance``, shape (m, width).
        values: Linearised readings [m], shape (m + 6,).
        variances: Their variances from noise [m^2], shape (m,).
        systematic_readings: Covariance of the readings from the linearisation's parameters, shape (m, m).
        stamp: Time of the scan [s].
        at_home: Whether the scan saw the home mark.
        settings: See the module.
        memory: See the module.
        rotation: Start and result, shape (3, 3).
        translation: Start and result [m], shape (3,).
        random: Random covariance to write, shape (6, 6).
        systematic: Systematic covariance to write, shape (6, 6).
        figures: Chi-square and counted theta [rad] to write, shape (2,).

    Returns:
        State and faults.

    """
    m = variances.shape[0]
    elapsed = stamp - memory[STAMP]
    moving = memory[KNOWN] > 0.0 and memory[GIVEN] == 0.0
    counting = settings[BUMP] > 0.0
    weights = np.empty(m + 6)
    for r in range(m):
        weights[r] = 1.0 / variances[r]
    jacobian = np.empty((m + 6, 6))
    residuals = np.empty(m + 6)
    start_rotation = rotation.copy()
    start_translation = translation.copy()
    before = np.empty((3, 3))
    recall(memory, before, np.empty(3))
    predicted = theta_of(rotation)
    lag_from = theta_of(before) if settings[LAGGING] > 0.0 and moving else math.nan
    carried = moving and settings[MOTION_TRANSLATION] < math.inf
    used = m
    faults = 0
    least = WEAK if carried else SINGULAR
    outcome = solve_scan(
        kinds[:m],
        rows[:m],
        values[:m],
        weights[:m],
        rotation,
        translation,
        jacobian[:m],
        residuals[:m],
        least,
        lag_from,
    )
    if outcome == ILL_CONDITIONED and carried:
        # Blind in some direction: the last pose, as uncertain as the target can have moved since, carries it over.
        rotation[:, :] = start_rotation
        translation[:] = start_translation
        used = m + 6
        prior_rows(kinds, rows, values, weights, m, settings, elapsed)
        outcome = solve_scan(
            kinds, rows, values, weights, rotation, translation, jacobian, residuals, SINGULAR, lag_from
        )
        faults |= FAULT_ILL_CONDITIONED
    if outcome != CONVERGED:
        memory[KNOWN] = 0.0
        memory[COUNTED] = 0.0
        return LOST, FAULT_ILL_CONDITIONED if outcome == ILL_CONDITIONED else FAULT_NOT_CONVERGED
    recounted = False
    if counting and at_home:
        off = bumps_off(theta_of(rotation), settings)
        if off != 0.0:
            recounted = True
            if memory[COUNTED] > 0.0:
                faults |= FAULT_COUNT
            turn_about_z(rotation, -off * settings[BUMP])
            outcome = solve_scan(
                kinds[:m],
                rows[:m],
                values[:m],
                weights[:m],
                rotation,
                translation,
                jacobian[:m],
                residuals[:m],
                SINGULAR,
                math.nan,
            )
            used = m
            if outcome != CONVERGED:
                memory[KNOWN] = 0.0
                memory[COUNTED] = 0.0
                return LOST, faults | FAULT_NOT_CONVERGED
        memory[COUNTED] = 1.0
    work = np.empty(sigmas.shape)
    whole = np.zeros((used, used))
    whole[:m, :m] = systematic_readings
    reading_covariance(kinds[:m], rows[:m], ids, sigmas, rotation, translation, work, whole)
    covariances(jacobian[:used], weights[:used], whole, rotation, random, systematic)
    figures[0] = 0.0
    if m > 6 and used == m:  # noqa: PLR2004  six unknowns
        figures[0] = chi_square(jacobian[:m], weights[:m], residuals[:m], whole)
    if not figures[0] <= settings[LIMIT]:
        faults |= FAULT_RESIDUAL
    if moving and not recounted:
        if moved_too_far(settings, elapsed, random, rotation, translation, memory):
            faults |= FAULT_INNOVATION
        reach = max(abs(memory[RATE]) * elapsed, abs(wrapped(theta_of(rotation) - predicted)))
        if counting and reach > 0.25 * settings[BUMP]:
            faults |= FAULT_COUNT
            memory[COUNTED] = 0.0
    if faults & (FAULT_RESIDUAL | FAULT_INNOVATION):
        return LOST, faults
    figures[1] = theta_of(rotation)
    if memory[KNOWN] > 0.0:
        figures[1] = memory[THETA] + wrapped(figures[1] - memory[THETA])
    if moving and not recounted:
        memory[RATE] = (figures[1] - memory[THETA]) / elapsed
    memory[KNOWN] = 1.0
    memory[GIVEN] = 0.0
    memory[STAMP] = stamp
    memory[THETA] = figures[1]
    remember(memory, rotation, translation)
    if counting and memory[COUNTED] == 0.0:
        return UNCOUNTED, faults
    return DEGRADED if faults else OK, faults


@compiled
def deserves_retry(state: int, fault: int, warm: bool) -> bool:  # noqa: FBT001  kernels take no keywords
    """Return whether a lost scan may have been lost because it started from a last pose that was far away."""
    return warm and state == LOST and fault & (FAULT_RESIDUAL | FAULT_NOT_CONVERGED) != 0


@compiled
def locate_scans(
    pool_kinds: IntArray,
    pool: FloatArray,
    pool_ids: IntArray,
    pool_sigmas: FloatArray,
    chosen: IntArray,
    values: FloatArray,
    variances: FloatArray,
    systematic_readings: FloatArray,
    fit: IntArray,
    stamps: FloatArray,
    at_home: IntArray,
    settings: FloatArray,
    memory: FloatArray,
    begin: int,
    end: int,
    states: IntArray,
    faults: IntArray,
    rotations: FloatArray,
    translations: FloatArray,
    random: FloatArray,
    systematic: FloatArray,
    figures: FloatArray,
) -> int:
    """Locate scans ``begin`` to ``end``, as far as no start is wanted.

    Row r of scan n is entry ``chosen[n, r]`` of the pool of rows. Scans with ``fit`` zero have been refused by the
    linearisation and are passed over. Shapes: scans n, rows m, pool K, width W.

    Returns:
        ``end`` when done; n where scan n needs a start pose in the memory; ``-1 - n`` where scan n failed
        from the last pose and deserves another try from a fresh start.

    """
    m = values.shape[1]
    width = pool.shape[1]
    kinds = np.empty(m + 6, dtype=np.int64)
    rows = np.zeros((m + 6, width))
    ids = np.empty((m, width), dtype=np.int64)
    sigmas = np.empty((m, width))
    readings = np.empty(m + 6)
    for n in range(begin, end):
        if fit[n] == 0:
            continue
        restart_if_back(stamps[n], memory)
        if memory[KNOWN] == 0.0:
            return n
        for r in range(m):
            k = chosen[n, r]
            kinds[r] = pool_kinds[k]
            rows[r] = pool[k]
            ids[r] = pool_ids[k]
            sigmas[r] = pool_sigmas[k]
            readings[r] = values[n, r]
        warm = memory[GIVEN] == 0.0
        start_from_memory(stamps[n], settings, memory, rotations[n], translations[n])
        state, fault = locate_scan(
            kinds,
            rows,
            ids,
            sigmas,
            readings,
            variances[n],
            systematic_readings[n],
            stamps[n],
            at_home[n] != 0,
            settings,
            memory,
            rotations[n],
            translations[n],
            random[n],
            systematic[n],
            figures[n],
        )
        states[n] = state
        faults[n] = fault
        if deserves_retry(state, fault, warm):
            return -1 - n
    return end
