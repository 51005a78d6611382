# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Estimates scans of a stack that holds sensors written in plain Python (``PlainSensor``).

Their readings enter the compiled solver as affine rows: value and derivative at one pose. The expansion is repeated at
each solution until the solution no longer moves, which makes the result exact. Only where the previous pose fills a
blind direction does the solution stay at the expansion that showed the blindness.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.estimation.ambient import NO_POSE
from posor.estimation.estimate_scan import DONE, LOST, START, begin_scan_estimate, solve_and_check, write_lost
from posor.estimation.linearise import linearise_scan
from posor.estimation.solver import ITERATIONS, LENGTH, TOLERANCE
from posor.estimation.tracking import turn_about_z
from posor.model.fault import Fault, State
from posor.model.reading_rows import AFFINE, prepare_rows, turn_rows
from posor.model.scan import Scans
from posor.numerics.compiled import record_view
from posor.numerics.vector import theta_in_kernel, wrapped

if TYPE_CHECKING:
    import pinocchio as pin
    from numpy.typing import NDArray

    from posor.calibration.parameter_covariance import CovarianceSquareRoot
    from posor.estimation.sensor_stack import Stack
    from posor.estimation.workspace import Model
    from posor.numerics.array_types import FloatArray

TOLERANCE_OF_EXPANSION = 1e-3 * TOLERANCE  # the expansion ends where it moves the solution by less [m]


class PlainSensors:
    """The plain sensors of a stack, and the loop that serves them.

    Attributes:
        present: Whether the stack has plain sensors.

    """

    def __init__(self, stack: Stack, model: Model, square_root: CovarianceSquareRoot) -> None:
        """Find the plain sensors of a stack whose parameters have a covariance with this square root."""
        self._stack, self._model, self._square_root = stack, model, square_root
        self._plain = stack.plain_sensors
        self.present = bool(self._plain)

    @cached_property
    def _dense_square_root(self) -> FloatArray:  # a megabyte that most stacks do not need
        return self._square_root.dense()

    def linearise(self, scans: NDArray[np.void], estimates: NDArray[np.void], n: int) -> bool:
        """Linearise all readings of scan n into the workspace; return whether they are valid."""
        estimate, workspace = estimates[n], self._model.workspace[0]
        if not linearise_scan(self._model, scans[n], estimate):
            return False
        for number, sensor, readings in self._plain:
            reading = sensor.try_read(Scans(scans)[n])
            if reading is None:
                estimate["sensor"], estimate["code"] = number, 1
                estimate["faults"] = int(sensor.explain(Scans(scans)[n], 1).fault)
                return False
            workspace["values"][readings], workspace["variances"][readings] = reading.values, reading.variances
            workspace["sensitivities"][readings] = 0.0 if reading.sensitivities is None else reading.sensitivities
            workspace["selected_rows"][readings] = self._stack.affine_rows(number)
        return True

    def estimate_scans(
        self, scans: NDArray[np.void], estimates: NDArray[np.void], begin: int, end: int
    ) -> tuple[int, int]:
        """Do ``estimate_scan.estimate_scans`` with these sensors."""
        for n in range(begin, end):
            left = self._estimate_scan(scans, estimates, n)
            if left != DONE:
                return n, left
        return end, DONE

    def _estimate_scan(self, scans: NDArray[np.void], estimates: NDArray[np.void], n: int) -> int:
        estimate, tracker = estimates[n], self._model.workspace[0]["tracker"]
        linearised = self.linearise(scans, estimates, n)
        if not begin_scan_estimate(self._model, scans[n], estimate, linearised):
            return DONE
        if self._model.workspace[0]["is_dark"]:  # the derivatives by the parameters need spots
            estimate["code"] = NO_POSE
            write_lost(estimate, int(Fault.AMBIENT))
            return DONE
        if not tracker["initialised"] and not tracker["start_given"]:
            return START
        left = self._solve(scans, estimates, n)
        if left == DONE and estimate["state"] == LOST:
            write_lost(estimate, int(estimate["faults"]))
        return left

    def _solve(self, scans: NDArray[np.void], estimates: NDArray[np.void], n: int) -> int:
        """Solve scan n, whose readings are linearised, and update the tracker; return what is left to do."""
        import pinocchio as pin  # noqa: PLC0415  50 MB that a node does not need before its first scan

        workspace, estimate, m = self._model.workspace[0], estimates[n], self._stack.readings
        settings, tracker, pose = workspace["settings"], workspace["tracker"], workspace["pose"]
        rows = self._activate_rows(workspace, m)
        scan = Scans(scans)[n]

        def solve_once() -> tuple[int, Any]:
            """Solve with the rows as they are; return what is left to do, and the tracker afterwards."""
            prepare_rows(record_view(rows))
            workspace["systematic_readings"][:m, :m] = systematic
            workspace["tracker"] = former
            left = solve_and_check(self._model, scans[n], False, estimate)  # noqa: FBT003  kernels take no keywords
            return int(left), workspace["tracker"].copy()

        # Affine rows hold where they were expanded; therefore the lag of the tilts is followed here, not in the kernel.
        former = tracker.copy()
        lagging = settings["tilt_lags"] and not former["start_given"]
        former_theta = float(former["theta"])
        start = self._start_pose()
        pose["rotation"], pose["translation"] = start.rotation, start.translation
        left, updated = DONE, former
        for attempt in range(ITERATIONS):
            before = pin.SE3(pose["rotation"], pose["translation"])
            self._stack.expand_plain_rows(rows, before.rotation, before.translation)
            if lagging:
                turn_rows(record_view(rows), wrapped(former_theta - theta_in_kernel(before.rotation)))
            effects = self._stack.residual_jacobian(scan, before.rotation, before.translation) @ self._dense_square_root
            systematic = effects @ effects.T
            shared = self._model.shared_readings
            shared[:] = effects[:, effects.shape[1] - shared.shape[1] :]  # the last factors, see CovarianceSquareRoot
            left, updated = solve_once()
            blind = int(estimate["faults"]) & Fault.ILL_CONDITIONED
            if attempt == 0:
                former_theta += self._correction(start.rotation)
            elif blind and left == DONE and estimate["state"] != LOST:
                # The previous pose fills the blind direction and holds the pose to where the kernel starts: start where
                # the scan did, with the affine rows moved back there along the tangent.
                affine = rows["kind"] == AFFINE
                back = pin.log6(start.actInv(before)).vector
                rows["value"][affine] -= rows["derivative"][affine] @ back
                pose["rotation"], pose["translation"] = start.rotation, start.translation
                left, updated = solve_once()
            if int(estimate["faults"]) & Fault.ILL_CONDITIONED or _distance(before, pose) < TOLERANCE_OF_EXPANSION:
                break
        else:
            estimate["state"], estimate["faults"] = State.LOST, Fault.NOT_CONVERGED
            updated["initialised"] = updated["counted"] = 0
        workspace["tracker"] = updated
        return left

    def _activate_rows(self, workspace: Any, m: int) -> NDArray[np.void]:
        """Copy the selected reading rows into the workspace; all systematic covariance will come from outside."""
        selected = workspace["selected_rows"][:m]
        workspace["rows"][:m] = np.asarray(self._stack.reading_rows)[selected]
        workspace["row_changes"] += bool((workspace["active_rows"][:m] != selected).any())
        workspace["active_rows"][:m], workspace["rows_active"] = selected, 0
        workspace["alone_count"] = workspace["contribution_count"] = workspace["block_count"] = 0
        workspace["first_correlated"][:m], workspace["end_correlated"][:m] = 0, m
        rows: NDArray[np.void] = workspace["rows"][:m]
        return rows

    def _start_pose(self) -> pin.SE3:
        import pinocchio as pin  # noqa: PLC0415  50 MB that a node does not need before its first scan

        workspace = self._model.workspace[0]
        tracker, given = workspace["tracker"], workspace["tracker"]["start_given"]
        pose = tracker["start" if given else "pose"]
        rotation = pose["rotation"].copy()
        if workspace["settings"]["bump_angle"] > 0.0 and not given:
            turn_about_z(rotation, float(tracker["theta_rate"] * (tracker["time"] - tracker["stamp"])))
        return pin.SE3(rotation, pose["translation"])

    def _correction(self, before: FloatArray) -> float:
        """Return by how many whole bumps the first solution of a scan was turned since ``before`` [rad]."""
        workspace = self._model.workspace[0]
        bump = float(workspace["settings"]["bump_angle"])
        turned = wrapped(theta_in_kernel(np.ascontiguousarray(workspace["pose"]["rotation"])) - theta_in_kernel(before))
        return bump * round(turned / bump) if bump > 0.0 and abs(turned) > 0.5 * bump else 0.0


def _distance(before: pin.SE3, pose: Any) -> float:
    """Return how far a pose has moved [m], a rotation by its arc at the solver's lever."""
    rotated = LENGTH * np.max(np.abs(pose["rotation"] - before.rotation))
    return float(max(np.max(np.abs(pose["translation"] - before.translation)), rotated))
