"""Locate scans of a stack that holds sensors written in plain Python (``PlainSensor``).

Their readings enter the compiled solver as affine rows: value and derivative at one pose. Expanding them again at each
solution until it no longer moves makes that exact. Only where the last pose must stand in for a direction that the
readings do not show is the solution left at the expansion that showed so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.fault import Fault, State
from posor_estimator.core.kernels import locate as kernel
from posor_estimator.core.kernels import memory as layout
from posor_estimator.core.kernels.readout import FAULTS, STATE
from posor_estimator.core.kernels.rows import AFFINE, prepare_rows, turn_row
from posor_estimator.core.kernels.solve import ITERATIONS, LENGTH, TOLERANCE
from posor_estimator.core.kernels.tables import (
    KINDS,
    LINES,
    MEMORY,
    PREPARED,
    REACH,
    READINGS,
    ROWS,
    SETTINGS,
    TALLY,
    VALUES,
    VARIANCES,
)
from posor_estimator.core.sensors.base import PlainSensor

if TYPE_CHECKING:
    from posor_estimator.core.estimate import Estimates
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.sensors.base import Batch
    from posor_estimator.core.stack import Stack
    from posor_estimator.core.tables import Tables
    from posor_estimator.core.types import FloatArray

SETTLED = 1e-3 * TOLERANCE
"""An expansion that moves the solution by less [m] is the last."""


class PlainRows:
    """The plain sensors of a stack, and the loop that serves them."""

    def __init__(self, stack: Stack) -> None:
        """Find the plain sensors of the stack."""
        self._stack = stack
        self._plain = [
            (sensor, first)
            for sensor, first in zip(stack.sensors, stack.first_rows, strict=True)
            if isinstance(sensor, PlainSensor)
        ]

    def expand(self, rows: FloatArray, rotation: FloatArray, translation: FloatArray) -> None:
        """Fill in the affine rows (m or more, width) at a pose ``T_R_T``."""
        for sensor, first in self._plain:
            values, jacobian = sensor.predict(rotation, translation)
            end = first + len(values)
            rows[first:end, 0] = values
            rows[first:end, 1:7] = jacobian

    def locate(self, scans: Scans, batch: Batch, n: int, stamp: float, tables: Tables, out: Estimates) -> None:
        """Locate scan n, the only one of the batch, from the pose in the memory, and update it [s]."""
        pool, chosen, m = self._stack.pool, batch.chosen[0], self._stack.readings
        kinds, rows = tables.of_ints(KINDS)[0], tables.of_floats(ROWS)
        prepared, lines, readings = (tables.of_floats(which) for which in (PREPARED, LINES, READINGS))
        settings, memory = tables.of_floats(SETTINGS)[0], tables.of_floats(MEMORY)[0]
        kinds[:m], rows[:m] = pool.kinds[chosen], pool.rows[chosen]
        lines[VALUES, :m], lines[VARIANCES, :m] = batch.values[0], batch.variances[0]
        tables.of_ints(TALLY)[:] = 0  # all that is systematic is worked out here
        tables.of_ints(REACH)[:] = 0, m
        rotation, translation = out.rotations[n], out.translations[n]

        def locate_from(begin: FloatArray) -> FloatArray:
            """Locate with the rows as they are, and return the memory that ``begin`` becomes."""
            prepare_rows(kinds, rows, m, prepared)
            readings[:] = 0.0
            readings[:m, :m] = systematic
            memory[:] = begin
            out.outcomes[n, STATE], out.outcomes[n, FAULTS] = kernel.locate_scan(
                *tables.arrays,
                m,
                stamp,
                bool(scans.at_home[n]),
                False,  # noqa: FBT003  the lag of the tilts is kept up here
                rotation,
                translation,
                out.covariances_random[n],
                out.covariances_systematic[n],
                out.figures[n],
            )
            after: FloatArray = memory.copy()
            return after

        # Affine rows hold from where they were expanded; so the lag of the tilts is kept up here, not in the kernel.
        former = memory.copy()
        lagging = settings[layout.LAGGING] > 0.0 and former[layout.GIVEN] == 0.0
        layout.start_from_memory(stamp, settings, former, rotation, translation)
        start = pin.SE3(rotation, translation)
        begin, count_fault = former, 0
        for attempt in range(ITERATIONS):
            before = pin.SE3(rotation, translation)
            self.expand(rows, rotation, translation)
            if lagging:
                turn = layout.wrapped(former[layout.THETA] - layout.theta_of(rotation))
                for r in range(m):
                    turn_row(kinds[r], turn, rows, r, prepared)
            effects = self._stack.residual_jacobian(scans[n], rotation, translation) @ tables.root
            systematic = effects @ effects.T
            updated = locate_from(begin)
            if attempt == 0:
                # What the kernel has said of the way from the start is not seen from further on.
                count_fault = int(out.faults[n] & Fault.COUNT)
                begin = _further_on(former, settings, count_fault, start.rotation, rotation)
            elif out.faults[n] & Fault.ILL_CONDITIONED and out.states[n] != State.LOST:
                # The last pose stands in for what is not seen. It holds the pose to where the kernel starts: start it
                # where the scan did, with the affine rows moved back there along the tangent.
                affine = np.flatnonzero(kinds[:m] == AFFINE)
                rows[affine, 0] -= rows[affine, 1:7] @ pin.log6(start.actInv(before)).vector
                rotation[:, :], translation[:] = start.rotation, start.translation
                updated = locate_from(begin)
            if out.faults[n] & Fault.ILL_CONDITIONED or _distance(before, rotation, translation) < SETTLED:
                break
        else:
            out.outcomes[n, STATE], out.outcomes[n, FAULTS] = State.LOST, Fault.NOT_CONVERGED
            updated[layout.KNOWN] = updated[layout.COUNTED] = 0.0
        out.faults[n] |= count_fault
        if out.states[n] == State.OK and count_fault:
            out.outcomes[n, STATE] = State.DEGRADED
        if out.states[n] == State.LOST:
            updated[layout.GIVEN] = former[layout.GIVEN]
        memory[:] = updated


def _distance(before: pin.SE3, rotation: FloatArray, translation: FloatArray) -> float:
    """Return how far a pose has moved [m], a turn by its arc at the solver's lever."""
    turned = LENGTH * np.max(np.abs(rotation - before.rotation))
    return float(max(np.max(np.abs(translation - before.translation)), turned))


def _further_on(
    memory: FloatArray, settings: FloatArray, count_fault: int, before: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return the memory for going on from the first solution of a scan.

    Where the home mark has put the count right by whole bumps, the way from the last pose no longer says anything, and
    theta is counted; where the count is in doubt, it is not.
    """
    begin = memory.copy()
    turned = abs(layout.wrapped(layout.theta_of(rotation) - layout.theta_of(before)))
    if settings[layout.BUMP] > 0.0 and turned > 0.5 * settings[layout.BUMP]:
        begin[layout.GIVEN] = begin[layout.COUNTED] = 1.0
    elif count_fault:
        begin[layout.COUNTED] = 0.0
    return begin
