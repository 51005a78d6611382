"""A POSOR: a stack of sensors between two plates, and the estimator that inverts their model scan by scan."""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from posor_estimator.core.calibration.model import Calibration, TiltAngle
from posor_estimator.core.estimate import Estimate, Estimates
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.forward import scans_at
from posor_estimator.core.kernels import locate as kernel
from posor_estimator.core.kernels import memory as layout
from posor_estimator.core.kernels.rows import evaluate_row
from posor_estimator.core.kernels.solve import CONVERGED, gauss_newton
from posor_estimator.core.lane import Lane
from posor_estimator.core.native import native_from_rotation
from posor_estimator.core.plain_rows import PlainRows
from posor_estimator.core.scan import Scan, Scans
from posor_estimator.core.stack import Stack
from posor_estimator.core.start import start_poses

if TYPE_CHECKING:
    import pinocchio as pin

    from posor_estimator.core.sensors.base import Batch
    from posor_estimator.core.types import FloatArray, IntArray

PHASE_GUESSES = 8
"""Starts within one bump that are tried where theta is not known at all."""
LIKELY_RUNOUT = 1e-4
"""Of starts that fit alike, as three ring probes have several, the one of least runout is taken; scale [m]."""
COUNT_WINDOW = 0.52
"""How far from a theta that is known to half a bump a solution may be, in bumps."""


class Posor:
    """Turns scans into poses, one after the other.

    Each solution starts from the last one; the first starts from a closed form. A bad scan never raises: its estimate
    is LOST and says why. The same loop serves one scan (``locate``) and many (``locate_all``), so both give the same
    numbers.
    """

    def __init__(self, calibration: Calibration, *, false_alarm: float = 1e-3) -> None:
        """Build the sensors of a calibration.

        Args:
            calibration: The POSOR's calibration, with its session already applied.
            false_alarm: Probability that the chi-square test of the redundant readings rejects a sound scan;
                zero: it rejects none.

        """
        self.calibration = calibration
        self.stack = Stack([sensor.build() for sensor in calibration.sensors])
        self._plain = PlainRows(self.stack)
        self._redundancy = max(self.stack.readings - 6, 0)
        counted = [(sensor.bump_angle, sensor.home_theta) for sensor in calibration.sensors if sensor.bump_angle > 0.0]
        motion = calibration.motion
        self._settings = np.full(layout.SETTINGS, math.inf)
        if self._redundancy > 0:
            self._settings[layout.LIMIT] = chi2.isf(false_alarm, self._redundancy)
        if motion is not None:
            self._settings[layout.MOTION_TRANSLATION] = motion.translation.number
            self._settings[layout.MOTION_LEAN] = motion.lean.number
            self._settings[layout.MOTION_THETA] = motion.theta.number
        self._settings[layout.BUMP], self._settings[layout.HOME] = counted[0] if counted else (0.0, 0.0)
        self._settings[layout.LAGGING] = float(calibration.tilt_angle is TiltAngle.PREVIOUS_SCAN)
        self._counting = bool(counted)
        self._memory = np.zeros(layout.MEMORY)
        self._epoch_ns: int | None = None
        self._known_theta: float | None = None

    def with_parameter_values(self, values: FloatArray) -> Posor:
        """Return the same POSOR with another parameter vector of its stack (shape (p,)), and nothing remembered.

        ``calibration`` stays what this one was made of.
        """
        other = copy.copy(self)
        other.stack = self.stack.with_parameter_values(values)
        other._plain = PlainRows(other.stack)  # noqa: SLF001  a copy of the same class
        other._memory = np.zeros(layout.MEMORY)  # noqa: SLF001
        return other

    def reset(self) -> None:
        """Forget the last pose and the count; the next scan starts from a closed form."""
        self._memory[:] = 0.0

    @property
    def counting(self) -> bool:
        """Whether theta is counted, in bumps from a home mark."""
        return self._counting

    def go_on_from(self, other: Posor) -> None:
        """Start the next scan from the last pose of another POSOR of the same kind, with its count of bumps.

        The motion to the next pose says nothing: the two may see one place differently.
        """
        repeats = [layout.BUMP, layout.HOME]
        if np.array_equal(self._settings[repeats], other._settings[repeats]):
            self._memory[:] = other._memory
            self._memory[layout.GIVEN] = self._memory[layout.KNOWN]
            self._epoch_ns = other._epoch_ns

    def locate(self, scan: Scan) -> Estimate:
        """Return the pose that one scan gives, starting from the pose of the scan before."""
        scans = Scans.of([scan])
        codes, estimates = self._locate(scans)
        return estimates.one(0, self._reason(scan, codes[0], int(estimates.faults[0]), float(estimates.residuals[0])))

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
        return self._locate(scans)[1]

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
            self._known_theta = None if thetas is None else float(thetas[n])
            parts.append(self._locate(scans.part(n, n + 1))[1])
        self._known_theta = None
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
        self._plain.expand(rows, rotation, translation)
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
        parameters = self.stack.residual_jacobian(scan, T_R_T.rotation, T_R_T.translation) * self.stack.parameter_sigmas
        whole = np.linalg.inv(np.diag(batch.variances[0]) + parameters @ parameters.T)
        seen = whole - whole @ jacobian @ np.linalg.solve(jacobian.T @ whole @ jacobian, jacobian.T @ whole)
        return np.kron(np.eye(2), T_R_T.rotation) @ gain, np.diagonal(seen).copy()

    def _tangent_jacobian(self, chosen: IntArray, T_R_T: pin.SE3) -> FloatArray:
        """Return d(reading)/d(local tangent) of the chosen rows at a pose, shape (m, 6)."""
        rows = self.stack.pool.rows[chosen].copy()
        rotation, translation = T_R_T.rotation.copy(), T_R_T.translation.copy()
        self._plain.expand(rows, rotation, translation)
        jacobian = np.empty((len(chosen), 6))
        for kind, row, derivative in zip(self.stack.pool.kinds[chosen], rows, jacobian, strict=True):
            evaluate_row(kind, row, rotation, translation, np.zeros(6), derivative)
        return jacobian

    def _locate(self, scans: Scans) -> tuple[IntArray, Estimates]:
        count = len(scans)
        codes, batch = self.stack.linearise(scans)
        fit = np.all(codes == 0, axis=1).astype(np.int64)
        out = Estimates(
            scans=scans.numbers,
            states=np.full(count, int(State.LOST), dtype=np.int64),
            faults=np.zeros(count, dtype=np.int64),
            rotations=np.empty((count, 3, 3)),
            translations=np.empty((count, 3)),
            thetas=np.empty(count),
            covariances_random=np.empty((count, 6, 6)),
            covariances_systematic=np.empty((count, 6, 6)),
            residuals=np.empty(count),
            redundancy=self._redundancy,
        )
        if self._epoch_ns is None and count:
            self._epoch_ns = int(scans.stamps_ns[0])
        stamps = np.asarray((scans.stamps_ns - (self._epoch_ns or 0)) * 1e-9, dtype=float)
        figures = np.full((count, 2), np.nan)
        self._run(scans, batch, fit, stamps, out, figures)
        if not fit.all():
            for sensor, of_sensor in zip(reversed(self.stack.sensors), codes.T[::-1], strict=True):
                for code in np.unique(of_sensor[of_sensor != 0]):
                    which = of_sensor == code
                    out.faults[which] = int(sensor.explain(scans[int(np.argmax(which))], int(code)).fault)
        out.residuals[:] = figures[:, 0]
        out.thetas[:] = figures[:, 1]
        lost = out.states == int(State.LOST)
        if lost.any():
            for array in (
                out.rotations,
                out.translations,
                out.thetas,
                out.covariances_random,
                out.covariances_systematic,
            ):
                array[lost] = np.nan
        return codes, out

    def _run(
        self, scans: Scans, batch: Batch, fit: IntArray, stamps: FloatArray, out: Estimates, figures: FloatArray
    ) -> None:
        """Run the loop over all scans; give it a start wherever it asks for one."""
        loop = self._plain_loop if self._plain else self._loop
        n, count = 0, len(scans)
        while n < count:
            stopped = loop(scans, batch, fit, stamps, out, figures, n, count)
            if stopped == count:
                return
            failed = stopped < 0
            n = -1 - stopped if failed else stopped
            if not (failed and self._counting):
                # Not known yet, or settled in a wrong place from afar: this one scan starts from a closed form.
                before = self._memory.copy()
                self._start(batch, n)
                loop(scans, batch, fit, stamps, out, figures, n, n + 1)
                if failed and out.states[n] == State.LOST:
                    self._memory[:] = before
            n += 1

    def _loop(
        self,
        scans: Scans,
        batch: Batch,
        fit: IntArray,
        stamps: FloatArray,
        out: Estimates,
        figures: FloatArray,
        begin: int,
        end: int,
    ) -> int:
        """Run the compiled loop over scans ``begin`` to ``end``; see its return value."""
        pool = self.stack.pool
        return kernel.locate_scans(
            pool.kinds,
            pool.rows,
            pool.ids,
            pool.sigmas,
            batch.chosen,
            batch.values,
            batch.variances,
            batch.systematic,
            fit,
            stamps,
            scans.at_home,
            self._settings,
            self._memory,
            begin,
            end,
            out.states,
            out.faults,
            out.rotations,
            out.translations,
            out.covariances_random,
            out.covariances_systematic,
            figures,
        )

    def _plain_loop(
        self,
        scans: Scans,
        batch: Batch,
        fit: IntArray,
        stamps: FloatArray,
        out: Estimates,
        figures: FloatArray,
        begin: int,
        end: int,
    ) -> int:
        """Do what the compiled loop does, for a stack with plain sensors."""
        for n in range(begin, end):
            if fit[n] == 0:
                continue
            layout.restart_if_back(stamps[n], self._memory)
            if self._memory[layout.KNOWN] == 0.0:
                return n
            warm = self._memory[layout.GIVEN] == 0.0
            self._plain.locate(scans, batch, n, stamps[n], self._settings, self._memory, out, figures)
            if kernel.deserves_retry(int(out.states[n]), int(out.faults[n]), warm):
                return -1 - n
        return end

    def _give(self, rotation: FloatArray, translation: FloatArray) -> None:
        """Put a start into the memory; the motion to it says nothing."""
        layout.remember(self._memory, rotation, translation)
        self._memory[layout.KNOWN] = self._memory[layout.GIVEN] = 1.0
        self._memory[layout.RATE] = self._memory[layout.COUNTED] = 0.0
        self._memory[layout.THETA] = native_from_rotation(rotation)[2]
        if not self._counting:
            self._memory[layout.COUNTED] = 1.0

    def _start(self, batch: Batch, n: int) -> None:
        """Put the best closed-form start for scan n into the memory."""
        pool, chosen = self.stack.pool, batch.chosen[n]
        kinds, rows, values = pool.kinds[chosen], pool.rows[chosen].copy(), batch.values[n]
        weights = 1.0 / batch.variances[n]
        bump = self._settings[layout.BUMP]
        known = self._known_theta
        guesses = [(known or 0.0) + bump * (i / PHASE_GUESSES - 0.5) for i in range(PHASE_GUESSES)]
        jacobian, residuals, moved = np.empty((len(values), 6)), np.empty(len(values)), np.empty(6)
        best = math.inf
        for pose in start_poses(kinds, rows, values, guesses if self._counting else [0.0]):
            rotation, translation = pose.rotation.copy(), pose.translation.copy()
            self._plain.expand(rows, rotation, translation)
            outcome = gauss_newton(
                kinds, rows, values, weights, rotation, translation, jacobian, residuals, moved, kernel.SINGULAR
            )
            settled = outcome == CONVERGED
            misfit = float(weights @ np.square(residuals)) if settled else math.inf
            misfit += float(np.sum(np.square(translation[:2] / LIKELY_RUNOUT)))
            if settled and self._counting and known is not None:
                off = abs(layout.wrapped(native_from_rotation(rotation)[2] - known))
                misfit = misfit if off < COUNT_WINDOW * bump else math.inf
            if misfit < best or math.isinf(best):
                best = min(best, misfit)
                self._give(*((rotation, translation) if settled else (pose.rotation, pose.translation)))
        if known is not None:
            self._memory[layout.COUNTED] = 1.0

    def _reason(self, scan: Scan, codes: IntArray, faults: int, residual: float) -> str:
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
