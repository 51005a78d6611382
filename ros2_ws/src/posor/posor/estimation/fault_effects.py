# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the causes of faults may do to a pose unseen by the residual test, for the pose of one scan.

Baarda's test of several parameters: a fault D b (D the columns of its hypothesis, (m, 1) or (m, 2)) makes the
chi-square of the redundant readings non-central, lambda = |Z D b|^2. The rows of Z are the directions of the residual
space (``estimation.scan_checks``), scaled so that ``Z (R + S) Z' = 1`` with the random and systematic covariances R and
S of the readings. A fault with lambda <= lambda_0 is missed with at least the stated probability. Such b satisfy

    |Z D b|^2 <= lambda_0    and    |b| <= bound,

an intersection of two ellipsoids. They change the pose by G D b, with G the gain of the solver. Causes that are always
there may mask a fault: sqrt(lambda_0) grows by the sum of their own largest parts in the residual space. A direction of
b is not tested where the readings show less than LEAST_SHOWN_SHARE of its square. Where the scan has been compared with
an encoder, a fault that turns theta by more than the encoder's test passes with the same probability is detected too.
Where the calibration states the travel of the bearing, a fault changes gap and lean by no more than from this pose to
the far end of the travel, for the true pose is within the travel.

``write_fault_effects`` writes for each column its change of the pose with b along a principal axis of the intersection,
and a number ``cut``. With f1, f2 the effects of both columns of a hypothesis along any axis and c1, c2 their cuts, the
largest effect of the hypothesis is the largest f1 u1 + f2 u2 with

    u1^2 + c2 u2^2 <= 1    and    c1 u1^2 + u2^2 <= 1    (``chain.fault_bounds``),

of one column |f1|. ``cut`` is infinite where the column is not bounded: any effect is infinite.

Source: W. Baarda, *A testing procedure for use in geodetic networks*, Delft 1968; P. J. G. Teunissen, *Testing Theory*,
Delft 2006 (multidimensional alternatives).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.estimation.fault_model import (
    ALWAYS,
    AMBIENT,
    CONTACT_X,
    CONTACT_Y,
    EFFECT,
    GAIN,
    LENGTH,
    SECOND,
    SUPPLY,
    TEMPERATURE,
    VOLTAGE,
)
from posor.estimation.scan_checks import NOISE_ALLOWANCE, REFERENCE_SIGMAS
from posor.model.diode import find_ratios
from posor.model.fault import Fault, State
from posor.model.readings import DIODE_CURRENTS, GAP_VOLTAGES, PYTHON
from posor.model.scan import CONTACTS
from posor.model.spot_map import spot_position
from posor.numerics.chi_square import upper_quantile
from posor.numerics.compiled import in_place
from posor.numerics.vector import applied, in_double, matrix, plus, put, square, times, within

if TYPE_CHECKING:
    from posor.estimation.workspace import Model
    from posor.numerics.array_types import FloatArray

MISSED_DETECTION = 1e-2  # probability that a fault of the smallest detectable size passes the test of one scan
LINEAR_LIMIT = 0.01  # effects up to this size are linear [m], [rad]; encoder and travel bound no larger ones
MISSED_SIGMAS = math.sqrt(upper_quantile(1, 2.0 * MISSED_DETECTION))
"""Standard deviations by which a fault exceeds the limit that passes with the probability MISSED_DETECTION."""
LEAST_SHOWN_SHARE = 1e-4
"""A direction that the readings show less is not tested: faults of hundreds of standard deviations would pass."""
LOST, ILL_CONDITIONED = int(State.LOST), int(Fault.ILL_CONDITIONED)


@in_place
def write_fault_effects(model: Model, scan: Any, estimate: Any, effects: FloatArray) -> None:  # noqa: C901
    """Write the effects of all columns, (C, EFFECT), at the last estimate; NaN without a pose from its readings alone.

    ``scan``: record of dtype SCAN; ``estimate``: its record of dtype ESTIMATE, the last one of the model.
    """
    columns, shifts = model.faults.columns, model.faults.shifts
    if estimate.state == LOST or estimate.faults & ILL_CONDITIONED:
        for c in range(columns.shape[0]):
            for k in range(EFFECT):
                effects[c, k] = math.nan
        return
    _write_sensitivities(model, scan)
    _write_parity(model)
    _project_columns(model)
    root = model.workspace[0].settings.noncentrality_root
    always = 0.0
    for c in range(columns.shape[0]):
        if columns[c].kind & ALWAYS:
            always += columns[c].bound * math.sqrt(_dot(model.faults.components, c, c))
    c = 0
    while c < columns.shape[0]:
        paired = c + 1 < columns.shape[0] and columns[c + 1].kind & SECOND != 0
        bound = columns[c].bound
        if columns[c].kind & ALWAYS:
            own = bound * math.sqrt(_dot(model.faults.components, c, c))
            size, cut = bound, 1.0
            if not paired and own > root + (always - own) and _shown(model, c, 1.0, 0.0) > LEAST_SHOWN_SHARE:
                size = bound * (root + (always - own)) / own
            for k in range(2 if paired else 1):
                _write_effect(shifts, effects, c + k, size, cut)
        elif paired:
            _write_pair(model, effects, c, root + always)
        else:
            _write_single(model, effects, c, root + always)
        c += 2 if paired else 1
    _limit_by_encoder(model, estimate, effects)
    _limit_by_travel(model, estimate, effects)


@in_place
def _limit_by_encoder(model: Model, estimate: Any, effects: FloatArray) -> None:
    """Shorten the effects of faults that turn theta by more than its comparison with the encoder misses."""
    checks = model.workspace[0].checks
    if not checks.reference_variance > 0.0:
        return
    variance = checks.reference_variance + estimate.random[5, 5] + estimate.systematic[5, 5]
    largest = (REFERENCE_SIGMAS + MISSED_SIGMAS) * math.sqrt(variance) + checks.reference_tolerance
    _shorten_all(model, effects, 5, largest)


@in_place
def _limit_by_travel(model: Model, estimate: Any, effects: FloatArray) -> None:
    """Shorten the effects of faults that change gap or lean by more than the travel and the pose permit."""
    settings, pose = model.workspace[0].settings, model.workspace[0].pose
    if not settings.travel_lean < math.inf:
        return
    gap, lowest, highest = pose.translation[2], settings.travel_gap[0], settings.travel_gap[1]
    _shorten_by_travel(model, estimate, effects, 2, max(gap - lowest, highest - gap))
    _shorten_by_travel(model, estimate, effects, 3, settings.travel_lean + abs(pose.rotation[1, 2]))
    _shorten_by_travel(model, estimate, effects, 4, settings.travel_lean + abs(pose.rotation[0, 2]))


@in_place
def _shorten_by_travel(model: Model, estimate: Any, effects: FloatArray, axis: int, largest: float) -> None:
    variance = estimate.random[axis, axis] + estimate.systematic[axis, axis]
    _shorten_all(model, effects, axis, largest + (NOISE_ALLOWANCE + MISSED_SIGMAS) * math.sqrt(variance))


@in_place
def _shorten_all(model: Model, effects: FloatArray, axis: int, largest: float) -> None:
    """Shorten the effects of faults to a change along an axis, beside that by causes that are always there."""
    columns = model.faults.columns
    for c in range(columns.shape[0]):
        if columns[c].kind & ALWAYS:
            largest += abs(in_double(effects[c, axis]))
    for c in range(columns.shape[0]):
        if columns[c].kind & ALWAYS == 0:
            partner = c - 1 if columns[c].kind & SECOND else c + 1
            if partner == columns.shape[0] or (partner > c and columns[partner].kind & SECOND == 0):
                _shorten(effects, c, -1, axis, largest)
            else:
                _shorten(effects, c, partner, axis, largest)


@in_place
def _shorten(effects: FloatArray, c: int, partner: int, axis: int, largest: float) -> None:
    """Shorten effect c to a largest change along an axis, whatever the other parameter of its fault is; -1: none."""
    change, size = abs(in_double(effects[c, axis])), 0.0
    if partner >= 0:
        largest += math.inf if math.isinf(effects[partner, 6]) else abs(in_double(effects[partner, axis]))
    for k in range(6):
        size = max(size, abs(in_double(effects[c, k])))
    if change == 0.0 or not (math.isinf(effects[c, 6]) or change > largest):
        return
    if not size * largest <= LINEAR_LIMIT * change:
        return
    for k in range(6):
        effects[c, k] = in_double(effects[c, k]) * (largest / change)
    effects[c, 6] = 1.0
    if partner >= 0:  # the box around what is left
        effects[c, 6] = effects[partner, 6] = 0.0


@in_place
def _write_effect(shifts: FloatArray, effects: FloatArray, c: int, size: float, cut: float) -> None:
    """Write the effect of a size of column c."""
    for k in range(6):
        effects[c, k] = size * shifts[c, k]
    effects[c, 6] = cut


@in_place
def _write_single(model: Model, effects: FloatArray, c: int, root: float) -> None:
    faults = model.faults
    bound, seen = faults.columns[c].bound, math.sqrt(_dot(faults.components, c, c))
    size, cut = bound, 1.0
    if seen > 0.0 and root < bound * seen and _shown(model, c, 1.0, 0.0) > LEAST_SHOWN_SHARE:
        size = root / seen
    if size == math.inf:
        size, cut = 1.0, math.inf
    _write_effect(faults.shifts, effects, c, size, cut)


@in_place
def _write_pair(model: Model, effects: FloatArray, c: int, root: float) -> None:
    """Write both columns of a hypothesis along the principal axes of what the test sees of it."""
    faults = model.faults
    bound = faults.columns[c].bound
    a, b, d = (_dot(faults.components, c, c), _dot(faults.components, c, c + 1), _dot(faults.components, c + 1, c + 1))
    angle = 0.5 * math.atan2(2.0 * b, a - d)
    u, v = math.cos(angle), math.sin(angle)
    middle, half = 0.5 * (a + d), math.sqrt(square(0.5 * (a - d)) + b * b)
    seen = math.sqrt(middle + half), math.sqrt(max(middle - half, 0.0))
    first = seen[0] if root < math.inf and _shown(model, c, u, v) > LEAST_SHOWN_SHARE else 0.0
    second = seen[1] if root < math.inf and _shown(model, c, -v, u) > LEAST_SHOWN_SHARE else 0.0
    size, other = _largest_undetected(bound, root, first), _largest_undetected(bound, root, second)
    cut = other_cut = 1.0
    if (size < bound) != (other < bound) and bound < math.inf:  # the test cuts the bound along one axis
        cut = square(size / bound) if size < bound else square(bound * first / root)
        other_cut = square(other / bound) if other < bound else square(bound * second / root)
    if size == math.inf:
        size, cut = 1.0, math.inf
    if other == math.inf:
        other, other_cut = 1.0, math.inf
    x, y = faults.shifts[c], faults.shifts[c + 1]
    for k in range(6):
        effects[c, k], effects[c + 1, k] = size * (u * x[k] + v * y[k]), other * (u * y[k] - v * x[k])
    effects[c, 6], effects[c + 1, 6] = cut, other_cut


@in_place
def _largest_undetected(bound: float, root: float, seen: float) -> float:
    """Return the largest size that is neither beyond the bound nor detected."""
    return root / seen if seen > 0.0 and root < bound * seen else bound


@in_place
def _dot(rows: FloatArray, i: int, j: int) -> float:
    total = 0.0
    for t in range(rows.shape[1]):
        total += rows[i, t] * rows[j, t]
    return total


@in_place
def _shown(model: Model, c: int, u: float, v: float) -> float:
    """Return the share of the square of u times column c plus v times the next one that the residuals show."""
    workspace, faults = model.workspace[0], model.faults
    first, end = faults.columns[c].first, faults.columns[c].end
    if v != 0.0:
        first, end = min(first, faults.columns[c + 1].first), max(end, faults.columns[c + 1].end)
    total = shown = 0.0
    for t in range(workspace.redundant_count):
        component = 0.0
        for r in range(first, end):
            entry = u * faults.entries[c, r]
            if v != 0.0:
                entry += v * faults.entries[c + 1, r]
            if t == 0:
                total += entry * entry * workspace.weights[r]
            component += workspace.residual_space[t, r] * entry
        shown += component * component
    return shown / total if total > 0.0 else 0.0


@in_place
def _write_sensitivities(model: Model, scan: Any) -> None:
    """Write the sensitivities of all readings at a valid scan."""
    workspace, out = model.workspace[0], model.faults.sensitivities
    lacking = math.isnan(scan.supply_voltage), math.isnan(scan.temperature)
    for r in range(workspace.reading_count):
        out[r, LENGTH] = 1.0
        out[r, SUPPLY] = 0.0 if lacking[0] else workspace.sensitivities[r, 0]
        out[r, TEMPERATURE] = 0.0 if lacking[1] else workspace.sensitivities[r, 1]
    for s in range(model.sensors.shape[0]):
        sensor = model.sensors[s]
        if sensor.source == PYTHON:
            continue
        for i in range(sensor.count):
            if sensor.source == DIODE_CURRENTS:
                _write_spot_sensitivities(model, i, sensor.first_channel + i, sensor.first_reading + 2 * i)
            else:
                r = sensor.first_reading + i
                volt = scan.gap_voltages[i] if sensor.source == GAP_VOLTAGES else scan.ring_voltages[i]
                out[r, VOLTAGE] = -model.by_channel[r].zero_shift  # derivative of prediction minus reading
                out[r, GAIN] = out[r, VOLTAGE] * volt


@in_place
def _write_spot_sensitivities(model: Model, i: int, d: int, r: int) -> None:
    """Write the sensitivities of both coordinates of the spot on diode i of the scan estimated last."""
    workspace, out, diode = model.workspace[0], model.faults.sensitivities, model.diodes[d]
    spot = workspace.spot
    currents = workspace.lit_currents  # without the ambient light that dark scans show
    find_ratios(currents, i, diode, spot)
    spot_position(diode, model.map_parameters[d], spot, model.by_map, r)
    light = 0.0
    for contact in range(CONTACTS):
        light += currents[CONTACTS * i + contact]
    for axis in range(2):
        out[r + axis, AMBIENT] = 0.0
    for axis in range(2):
        ratio, pair = spot.ratios[axis], currents[CONTACTS * i + axis] + currents[CONTACTS * i + axis + 2]
        for k in range(2):
            slope = spot.slope[k, axis]
            out[r + k, CONTACT_X if axis == 0 else CONTACT_Y] = 0.5 * (1.0 - ratio * ratio) * slope
            out[r + k, AMBIENT] -= 0.5 * ratio * light / pair * slope


@in_place
def _write_parity(model: Model) -> None:
    """Write the directions of the residual space divided by the Cholesky factor of their covariance."""
    workspace, out = model.workspace[0], model.faults.parity
    space, factor = workspace.residual_space, workspace.residual_covariance
    for t in range(out.shape[0]):
        for r in range(out.shape[1]):
            entry = space[t, r]
            for s in range(t):
                entry -= factor[t, s] * out[s, r]
            out[t, r] = entry / factor[t, t]


@in_place
def _project_columns(model: Model) -> None:
    """Write the entries of all columns, their components in the residual space, and their shifts of the pose."""
    workspace, faults = model.workspace[0], model.faults
    axes = matrix(workspace.pose.rotation, 0)
    for c in range(faults.columns.shape[0]):
        column = faults.columns[c]
        v, w = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for t in range(faults.components.shape[1]):
            faults.components[c, t] = 0.0
        for r in range(column.first, column.end):
            entry = faults.coefficients[c, r] * faults.sensitivities[r, column.sensitivity]
            faults.entries[c, r] = entry
            v = plus(v, times(entry, within(workspace.gain, r, 0)))
            w = plus(w, times(entry, within(workspace.gain, r, 3)))
            for t in range(faults.components.shape[1]):
                faults.components[c, t] += faults.parity[t, r] * entry
        put(faults.shifts, c, 0, applied(axes, v))
        put(faults.shifts, c, 3, applied(axes, w))
