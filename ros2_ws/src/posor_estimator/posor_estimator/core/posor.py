"""A POSOR: a stack of sensors between two plates, and the estimator that inverts their model scan by scan."""

from __future__ import annotations

import copy
import math
from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from posor_estimator.core.calibration.model import Calibration, TiltAngle
from posor_estimator.core.calibration.stated import stated_correlation
from posor_estimator.core.estimate import Estimate, Estimates
from posor_estimator.core.fault import Fault
from posor_estimator.core.forward import scans_at
from posor_estimator.core.kernels import memory as layout
from posor_estimator.core.kernels.rows import evaluate_row
from posor_estimator.core.lane import Lane
from posor_estimator.core.loop import Loop
from posor_estimator.core.root import Root
from posor_estimator.core.scan import Scan, Scans
from posor_estimator.core.stack import Stack

if TYPE_CHECKING:
    import pinocchio as pin

    from posor_estimator.core.types import FloatArray, IntArray


class Posor:
    """Turns scans into poses, one after the other.

    Each solution starts from the last one; the first starts from a closed form. A bad scan never raises: its estimate
    is LOST and says why. The same loop serves one scan (``locate``) and many (``locate_all``), so both give the same
    numbers.

    Attributes:
        calibration: The calibration, its session applied.
        redundancy: Number of redundant readings.
        loop: The loop over scans, with what is remembered.

    """

    def __init__(self, calibration: Calibration, *, false_alarm: float = 1e-3) -> None:
        """Build the sensors of a calibration.

        Args:
            calibration: The POSOR's calibration, with its session already applied.
            false_alarm: Probability that the chi-square test of the redundant readings rejects a sound scan;
                zero: it rejects none.

        """
        self.calibration = calibration
        self._stack = Stack([sensor.build() for sensor in calibration.sensors])
        self.redundancy = max(self.stack.readings - 6, 0)
        counted = [(sensor.bump_angle, sensor.home_theta) for sensor in calibration.sensors if sensor.bump_angle > 0.0]
        motion = calibration.motion
        self._settings = np.full(layout.SETTINGS, math.inf)
        if self.redundancy > 0:
            self._settings[layout.LIMIT] = chi2.isf(false_alarm, self.redundancy)
        if motion is not None:
            self._settings[layout.MOTION_TRANSLATION] = motion.translation.number
            self._settings[layout.MOTION_LEAN] = motion.lean.number
            self._settings[layout.MOTION_THETA] = motion.theta.number
        self._settings[layout.BUMP], self._settings[layout.HOME] = counted[0] if counted else (0.0, 0.0)
        self._settings[layout.LAGGING] = float(calibration.tilt_angle is TiltAngle.PREVIOUS_SCAN)
        correlated = any(record.covariances for record in calibration.fits)
        self._root = Root.of(
            self.stack.parameter_sigmas, stated_correlation(calibration, calibration.session) if correlated else None
        )
        self._prepare()

    def _prepare(self) -> None:
        """Make what follows from the stack, nothing remembered."""
        self.loop = Loop(self.stack, self._root, self._settings)
        self._lane: Lane | None = None

    def with_parameter_values(self, values: FloatArray) -> Posor:
        """Return the same POSOR with another parameter vector of its stack (shape (p,)), and nothing remembered.

        ``calibration`` stays what this one was made of.
        """
        other = copy.copy(self)
        other._stack = self.stack.with_parameter_values(values)  # noqa: SLF001  a copy of the same class
        other._prepare()  # noqa: SLF001  a copy of the same class
        return other

    @property
    def stack(self) -> Stack:
        """The sensors; for others there is ``with_parameter_values``."""
        return self._stack

    @property
    def parameter_root(self) -> FloatArray:
        """A square root of the covariance of the stack's parameters that the calibration states, (p, deviates)."""
        return self._root.dense()

    def reset(self) -> None:
        """Forget the last pose and the count; the next scan starts from a closed form."""
        self.loop.memory[:] = 0.0

    @property
    def counting(self) -> bool:
        """Whether theta is counted, in bumps from a home mark."""
        return self.loop.counting

    def go_on_from(self, other: Posor) -> None:
        """Start the next scan from the last pose of another POSOR of the same kind, with its count of bumps.

        The motion to the next pose says nothing: the two may see one place differently.
        """
        repeats = [layout.BUMP, layout.HOME]
        if np.array_equal(self._settings[repeats], other._settings[repeats]):
            self.loop.memory[:] = other.loop.memory
            self.loop.memory[layout.GIVEN] = self.loop.memory[layout.KNOWN]
            self.loop.epoch[:] = other.loop.epoch

    def locate(self, scan: Scan) -> Estimate:
        """Return the pose that one scan gives, starting from the pose of the scan before."""
        if self._lane is None or not self._lane.takes(scan):
            self._lane = self.lane(scan)
        return self._lane.locate(scan)

    def lane(self, like: Scan | None = None) -> Lane:
        """Return the way for one scan at a time without making anything anew.

        Args:
            like: A scan with as many readings as will come; None: as many as the sensors with rows ask for.

        """
        if like is not None:
            return Lane(self, Scans.of([like]))
        return Lane(self, scans_at(self.stack, np.eye(3)[None], np.zeros((1, 3)), np.zeros(1, dtype=np.int64)))

    def locate_all(self, scans: Scans) -> Estimates:
        """Return the poses that many scans give, one after the other: the same as ``locate`` of each."""
        scans = Scans(**{f.name: np.require(getattr(scans, f.name), requirements=["C", "W"]) for f in fields(Scans)})
        out = Estimates.room(scans.numbers, len(self.stack.sensors), self.redundancy)
        self.loop.run(scans, out)
        return out

    def locate_each(self, scans: Scans, thetas: FloatArray | None = None) -> Estimates:
        """Return the poses of scans that have nothing to do with one another: each starts afresh.

        Args:
            scans: The scans.
            thetas: For a counted theta: what it is to half a bump [rad], shape (n,); None: not known.

        Returns:
            The estimates; the last pose and the count are forgotten afterwards.

        """
        parts = []
        for n in range(len(scans)):
            self.reset()
            self.loop.known_theta = None if thetas is None else float(thetas[n])
            parts.append(self.locate_all(scans.part(n, n + 1)))
        self.loop.known_theta = None
        self.reset()
        return Estimates.joined(parts)

    def predict(self, scan: Scan, T_R_T: pin.SE3) -> FloatArray:
        """Return what every linearised reading of a scan would be at a pose [m], shape (m,).

        The scan says only which rows are read (which light sources are lit).
        """
        batch = self.stack.linearise(Scans.of([scan]))[1]
        chosen = batch.chosen[0]
        rows = self.stack.pool.rows[chosen].copy()
        rotation, translation = T_R_T.rotation.copy(), T_R_T.translation.copy()
        self.loop.plain.expand(rows, rotation, translation)
        still, jacobian = np.zeros(6), np.empty(6)
        return np.array(
            [
                evaluate_row(kind, row, rotation, translation, still, jacobian)
                for kind, row in zip(self.stack.pool.kinds[chosen], rows, strict=True)
            ]
        )

    @property
    def residual_limit(self) -> float:
        """Largest chi-square of the redundant readings that passes."""
        return float(self._settings[layout.LIMIT])

    def sensitivity(self, scan: Scan, T_R_T: pin.SE3) -> tuple[FloatArray, FloatArray]:
        """Return what a shift of each linearised reading does at a pose.

        Returns:
            Change of the pose in ROS order (6, m) [m/m, rad/m], and of chi-square for a square metre of shift (m,).

        """
        batch = self.stack.linearise(Scans.of([scan]))[1]
        jacobian = self._tangent_jacobian(batch.chosen[0], T_R_T)
        weights = 1.0 / batch.variances[0]
        gain = np.linalg.solve(jacobian.T @ (weights[:, None] * jacobian), (weights[:, None] * jacobian).T)
        parameters = self.stack.residual_jacobian(scan, T_R_T.rotation, T_R_T.translation) @ self.parameter_root
        whole = np.linalg.inv(np.diag(batch.variances[0]) + parameters @ parameters.T)
        seen = whole - whole @ jacobian @ np.linalg.solve(jacobian.T @ whole @ jacobian, jacobian.T @ whole)
        return np.kron(np.eye(2), T_R_T.rotation) @ gain, np.diagonal(seen).copy()

    def _tangent_jacobian(self, chosen: IntArray, T_R_T: pin.SE3) -> FloatArray:
        """Return d(reading)/d(local tangent) of the chosen rows at a pose, shape (m, 6)."""
        rows = self.stack.pool.rows[chosen].copy()
        rotation, translation = T_R_T.rotation.copy(), T_R_T.translation.copy()
        self.loop.plain.expand(rows, rotation, translation)
        jacobian = np.empty((len(chosen), 6))
        for kind, row, derivative in zip(self.stack.pool.kinds[chosen], rows, jacobian, strict=True):
            evaluate_row(kind, row, rotation, translation, np.zeros(6), derivative)
        return jacobian

    def reason(self, scan: Scan, codes: IntArray, faults: int, residual: float) -> str:
        """Return the sentence on what is wrong with one scan's estimate, empty where nothing is."""
        if faults == 0:
            return ""
        for sensor, code in zip(self.stack.sensors, codes, strict=True):
            if code != 0:
                return str(sensor.explain(scan, int(code)))
        limit = self._settings[layout.LIMIT]
        sentences = {
            Fault.NOT_CONVERGED: "the estimate did not settle",
            Fault.ILL_CONDITIONED: "the readings do not determine all six freedoms",
            Fault.RESIDUAL: f"the redundant readings contradict one another, chi-square {residual:.3g}; "
            f"expected at most {limit:.3g}",
            Fault.INNOVATION: "the pose is further from the last one than the target can have moved",
            Fault.COUNT: "the bump count is in doubt",
        }
        said = [sentence for fault, sentence in sentences.items() if faults & fault]
        return f"scan {scan.number}: {'; '.join(said)}." if said else ""
