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
from posor_estimator.core.kernels.rows import AFFINE, GAP, SPOT_X, SPOT_Y
from posor_estimator.core.kernels.solve import ITERATIONS, LENGTH, TOLERANCE
from posor_estimator.core.sensors.base import PlainSensor

if TYPE_CHECKING:
    from posor_estimator.core.estimate import Estimates
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.sensors.base import Batch
    from posor_estimator.core.stack import Stack
    from posor_estimator.core.types import FloatArray, IntArray

SETTLED = 1e-3 * TOLERANCE
"""An expansion that moves the solution by less [m] is the last."""
_TURNS = {GAP: 11, SPOT_X: 15, SPOT_Y: 15}
"""Where a row holds the extra turn of what is fixed in the target, see ``kernels.locate.solve_scan``."""


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

    def __bool__(self) -> bool:
        """Return whether the stack has any plain sensor."""
        return bool(self._plain)

    def expand(self, rows: FloatArray, rotation: FloatArray, translation: FloatArray) -> None:
        """Fill in the affine rows (m or more, width) at a pose ``T_R_T``."""
        for sensor, first in self._plain:
            values, jacobian = sensor.predict(rotation, translation)
            end = first + len(values)
            rows[first:end, 0] = values
            rows[first:end, 1:7] = jacobian

    def locate(
        self,
        scans: Scans,
        batch: Batch,
        n: int,
        stamp: float,
        settings: FloatArray,
        memory: FloatArray,
        out: Estimates,
        figures: FloatArray,
    ) -> None:
        """Locate scan n from the pose in the memory, and update it; arguments as ``kernels.locate.locate_scan``."""
        pool, chosen = self._stack.pool, batch.chosen[n]
        kinds = np.concatenate([pool.kinds[chosen], np.zeros(6, dtype=np.int64)])
        rows = np.concatenate([pool.rows[chosen], np.zeros((6, pool.rows.shape[1]))])
        values = np.concatenate([batch.values[n], np.zeros(6)])
        rotation, translation = out.rotations[n], out.translations[n]

        def locate_from(begin: FloatArray, systematic: FloatArray) -> FloatArray:
            """Locate with the rows as they are, and return the memory that ``begin`` becomes."""
            updated = begin.copy()
            out.states[n], out.faults[n] = kernel.locate_scan(
                kinds,
                rows,
                pool.ids[chosen],
                pool.sigmas[chosen],
                values,
                batch.variances[n],
                batch.systematic[n] + systematic,
                stamp,
                bool(scans.at_home[n]),
                settings,
                updated,
                rotation,
                translation,
                out.covariances_random[n],
                out.covariances_systematic[n],
                figures[n],
            )
            return updated

        # Affine rows hold from where they were expanded; so the lag of the tilts is kept up here, not in the kernel.
        settings = settings.copy()
        lagging = settings[layout.LAGGING] > 0.0 and memory[layout.GIVEN] == 0.0
        settings[layout.LAGGING] = 0.0
        layout.start_from_memory(stamp, settings, memory, rotation, translation)
        start = pin.SE3(rotation, translation)
        begin, count_fault = memory, 0
        for attempt in range(ITERATIONS):
            before = pin.SE3(rotation, translation)
            self.expand(rows, rotation, translation)
            if lagging:
                _turn_tilts(kinds, rows, layout.wrapped(memory[layout.THETA] - layout.theta_of(rotation)))
            systematic = self._systematic(scans, n, rotation, translation)
            updated = locate_from(begin, systematic)
            if attempt == 0:
                # What the kernel has said of the way from the start is not seen from further on.
                count_fault = int(out.faults[n] & Fault.COUNT)
                begin = _further_on(memory, settings, count_fault, start.rotation, rotation)
            elif out.faults[n] & Fault.ILL_CONDITIONED and out.states[n] != State.LOST:
                # The last pose stands in for what is not seen. It holds the pose to where the kernel starts: start it
                # where the scan did, with the affine rows moved back there along the tangent.
                affine = np.flatnonzero(kinds[: len(chosen)] == AFFINE)
                rows[affine, 0] -= rows[affine, 1:7] @ pin.log6(start.actInv(before)).vector
                rotation[:, :], translation[:] = start.rotation, start.translation
                updated = locate_from(begin, systematic)
            if out.faults[n] & Fault.ILL_CONDITIONED or _distance(before, rotation, translation) < SETTLED:
                break
        else:
            out.states[n], out.faults[n] = State.LOST, Fault.NOT_CONVERGED
            updated[layout.KNOWN] = updated[layout.COUNTED] = 0.0
        out.faults[n] |= count_fault
        if out.states[n] == State.OK and count_fault:
            out.states[n] = State.DEGRADED
        if out.states[n] == State.LOST:
            updated[layout.GIVEN] = memory[layout.GIVEN]
        memory[:] = updated

    def _systematic(self, scans: Scans, n: int, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return the covariance of the readings from the plain sensors' parameters, shape (m, m)."""
        out = np.zeros((self._stack.readings, self._stack.readings))
        for sensor, first in self._plain:
            pushed = sensor.residual_jacobian(scans[n], rotation, translation) * sensor.parameter_sigmas
            rows = slice(first, first + len(pushed))
            out[rows, rows] = pushed @ pushed.T
        return out


def _turn_tilts(kinds: IntArray, rows: FloatArray, turn: float) -> None:
    """Turn what is fixed in the target by an angle [rad] about its Z, as ``kernels.locate.solve_scan`` does."""
    for kind, column in _TURNS.items():
        for r in np.flatnonzero(kinds == kind):
            rows[r, column] = turn


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
