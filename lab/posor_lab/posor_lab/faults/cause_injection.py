# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faults of a physical cause in the raw scans of a drawn device.

The faults are made in voltages, currents and positions, not by the directions with which the estimator bounds them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.causes import Pattern, Readings
from posor.sensors.base import RowSensor

if TYPE_CHECKING:
    from posor.calibration.causes import Cause
    from posor.estimation.posor import Posor
    from posor.estimation.sensor_stack import Stack
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray

UNLIMITED = {"m": (2e-7, 5e-5), "1": (1e-4, 2e-2)}
"""Smallest and largest size of an unlimited cause by its unit; it is drawn evenly by its logarithm."""
FIELDS = {"gap": "gap_voltages", "ring": "ring_voltages"}


def draw_sensors(posor: Posor, random: np.random.Generator) -> Stack:
    """Return the stack with true parameters that are drawn within their uncertainties."""
    stack = posor.stack
    errors = stack.parameter_sigmas * random.normal(size=stack.parameters)
    return stack.with_parameter_values(stack.parameter_values + errors)


def draw_sizes(cause: Cause, share: float, count: int, random: np.random.Generator) -> FloatArray:
    """Return sizes of a cause, half of them the bound, the others evenly up to it, times ``share``, (n,)."""
    if cause.bound is None:
        low, high = np.log(UNLIMITED[cause.unit])
        return share * np.asarray(np.exp(random.uniform(low, high, count)))
    sizes = cause.bound * random.uniform(0.0, 1.0, count)
    sizes[::2] = cause.bound
    return share * sizes


def inject(
    cause: Cause, sizes: FloatArray, scans: Scans, stack: Stack, random: np.random.Generator, *, alike: bool = False
) -> Scans:
    """Return scans with a fault of random direction and random readings of one cause.

    ``sizes``: of the fault in each scan, (n,), in the cause's unit; ``stack``: the sensors that the scans come from;
    ``alike``: direction and readings are the same in all scans.
    """
    readings, pattern, by = cause.move.readings, cause.move.pattern, cause.move.units[cause.unit]
    draws = 1 if alike else len(sizes)
    signed = sizes * random.choice([-1.0, 1.0], draws)
    if by in {"supply", "temperature"}:
        field = "supply_voltages" if by == "supply" else "temperatures"
        return scans.with_fields({field: getattr(scans, field) + signed})
    if readings is Readings.DIODES and by != "length":
        return _inject_currents(pattern, by, sizes, scans, random, draws)
    moved = _moves(readings, pattern, signed, stack, random, draws)
    if by == "length":
        return with_readings(scans, stack, stack.linearise(scans).values + moved)
    changes = {}
    for kind, field in FIELDS.items():
        own = [n for n, name in enumerate(stack.reading_names) if name.startswith(kind)]
        volts = getattr(scans, field)
        changes[field] = volts * (1.0 + moved[:, own]) if by == "gain" else volts + moved[:, own]
    return scans.with_fields(changes)


def _moves(
    readings: Readings, pattern: Pattern, sizes: FloatArray, stack: Stack, random: np.random.Generator, draws: int
) -> FloatArray:
    """Return by how much each reading moves in each scan, (n, m)."""
    prefixes = {Readings.GAPS: ("gap",), Readings.RING: ("ring",), Readings.DIODES: ("spot",)}
    prefix = prefixes.get(readings, ("gap", "ring") if readings is Readings.PROBES else ("",))
    rows = np.array([n for n, name in enumerate(stack.reading_names) if name.startswith(prefix)])
    count, out = len(sizes), np.zeros((len(sizes), stack.readings))
    angles = random.uniform(0.0, 2.0 * np.pi, draws)
    direction = sizes[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    if pattern is Pattern.EACH:
        out[np.arange(count), random.choice(rows, draws)] = sizes
    elif pattern is Pattern.COMMON:
        out[:, rows] = sizes[:, None]
    elif pattern is Pattern.SUBSETS:
        out[:, rows] = sizes[:, None] * random.integers(2, size=(draws, len(rows)))
    elif pattern is Pattern.GRADIENT:  # probes are spread evenly over the circle
        around = 2.0 * np.pi * np.arange(len(rows)) / len(rows)
        out[:, rows] = direction @ np.stack([np.cos(around), np.sin(around)])
    elif pattern is Pattern.PLANE_COMMON:
        out[:, rows] = np.tile(direction, len(rows) // 2)
    else:
        first = rows[0] + 2 * random.integers(len(rows) // 2, size=draws)
        out[np.arange(count), first], out[np.arange(count), first + 1] = direction.T
    return out


def _inject_currents(
    pattern: Pattern, by: str, sizes: FloatArray, scans: Scans, random: np.random.Generator, draws: int
) -> Scans:
    """Return scans with another gain of contacts, or with ambient light as a share of the source's."""
    currents, count = scans.diode_currents.copy(), len(sizes)
    diodes, each = currents.shape[1], np.arange(count)
    changed = np.zeros_like(currents)  # relative, or as a share of the mean current of a contact
    which = random.integers(diodes, size=draws)
    angles = random.uniform(0.0, 2.0 * np.pi, draws)
    if by == "ambient":
        share = currents.mean(axis=2) * np.abs(sizes)[:, None]
        if pattern is Pattern.COMMON:
            currents += share[..., None]
        else:
            currents[each, which] += share[each, which][:, None]
        return scans.with_fields({"diode_currents": currents})
    if pattern is Pattern.EACH:
        changed[each, which, random.integers(4, size=draws)] = sizes
    else:
        of_axes = sizes[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        if pattern is Pattern.PLANE_COMMON:
            changed[:, :, :2] = of_axes[:, None]
        else:
            changed[each, which, :2] = of_axes
    return scans.with_fields({"diode_currents": currents * (1.0 + changed)})


def with_readings(scans: Scans, stack: Stack, readings: FloatArray) -> Scans:
    """Return scans whose linearised readings are ``readings``, (n, m)."""
    done = 0
    for sensor in stack.sensors:
        if isinstance(sensor, RowSensor):
            own = readings[:, done : done + len(sensor.reading_names)]
            done += own.shape[1]
            scans = scans.with_fields(sensor.encode(own, scans))
    return scans
