# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The estimator of a POSOR: turns raw scans into poses by inverting the model of its sensors, scan after scan."""

from __future__ import annotations

import copy
import math
from functools import cached_property, partial
from operator import index as whole_number
from typing import TYPE_CHECKING, Any

import numpy as np

from posor.calibration.calibration_file import Calibration
from posor.calibration.causes import FALSE_ALARM
from posor.calibration.parameter_covariance import CovarianceSquareRoot, shared_effects, stated_correlation
from posor.errors import ParameterError, ShapeError, check_probability, check_type
from posor.estimation.estimate import ESTIMATE, Estimate, Estimates, estimate_of
from posor.estimation.estimate_scan import DONE, START, estimate_scans
from posor.estimation.fault_effects import write_fault_effects
from posor.estimation.fault_hypotheses import Hypotheses
from posor.estimation.fault_model import EFFECT
from posor.estimation.fault_sentence import fault_sentence
from posor.estimation.linearise import linearise_scan
from posor.estimation.plain_sensors import PlainSensors
from posor.estimation.sensor_stack import Stack
from posor.estimation.settings import write_settings
from posor.estimation.solver import CONVERGED, SINGULAR, solve_start
from posor.estimation.start_poses import start_poses
from posor.model.fault import Fault, State
from posor.model.native_coordinates import native_from_rotation
from posor.model.scan import CONTACTS, Scan, ScanBuffer, Scans
from posor.numerics.compiled import bind, record_view
from posor.numerics.vector import wrapped

if TYPE_CHECKING:
    from collections.abc import Callable

    import pinocchio as pin
    from numpy.typing import NDArray

    from posor.numerics.array_types import FloatArray

PHASE_GUESSES = 8  # starts in closed form within one bump
LIKELY_RUNOUT = 1e-4  # [m]; of starts that fit alike, as with three ring probes, that of the least runout is taken
LARGEST_SIGMA = 0.1  # largest standard uncertainty of a reference of theta, in periods: five of them are half a period
COUNT_WINDOW = 0.52  # largest distance of a solution from a theta that is known to half a bump, in bumps


class Posor:
    """Turns scans into poses, one after the other.

    Each solution starts from the previous one; the first starts from a closed form. An invalid scan never raises: its
    estimate is LOST and has a reason. One scan (``estimate``) and many (``estimate_all``) take the same steps, so both
    give the same numbers.

    Attributes:
        calibration: The calibration, its session applied.
        redundancy: Number of redundant readings.
        hypotheses: The causes of faults of the calibration, and what they move.
        stack: The sensors. ``with_parameter_values`` changes their parameters.

    """

    def __init__(self, calibration: Calibration, *, false_alarm: float = FALSE_ALARM) -> None:
        """Build the sensors of a calibration.

        Args:
            calibration: The calibration of the POSOR, with its session already applied.
            false_alarm: Probability that the chi-square test of the redundant readings rejects a sound scan. At most a
                share ``EXCEEDED`` of joints has a larger one, because of their calibration errors. Zero: the test
                rejects no scan.

        Raises:
            ParameterError: ``calibration`` is no Calibration, or ``false_alarm`` is not a probability below one.

        """
        check_type(calibration, Calibration, "Posor")
        check_probability(false_alarm, "Posor, false_alarm", or_zero=True)
        self.calibration = calibration
        self.stack = Stack([sensor.build() for sensor in calibration.sensors])
        self.hypotheses = Hypotheses.of(calibration, self.stack)  # whatever the parameter values
        self.redundancy = max(self.stack.readings - 6, 0)
        self._false_alarm = false_alarm
        correlated = any(record.covariances for record in calibration.fits)
        self._square_root = CovarianceSquareRoot.of(
            self.stack.parameter_sigmas,
            stated_correlation(calibration, calibration.session) if correlated else None,
            shared_effects(calibration, calibration.session) if calibration.shared else None,
        )
        self._prepare()

    def __repr__(self) -> str:
        state = f", latched {self.latched.name}" if self.latched else ""
        return (
            f"<Posor of '{self.calibration.name}': {self.stack.readings} readings, {self.redundancy} redundant{state}>"
        )

    def _prepare(self) -> None:
        """Build the arrays that the kernels read; this resets the tracker."""
        self.model = self.stack.model(self._square_root, self.hypotheses.model.with_own_scratch())
        self._plain = PlainSensors(self.stack, self.model, self._square_root)
        self._known_theta: float | None = None
        self._one = _OneScan(self)
        self._solve_start: Callable[[], int] | None = None
        write_settings(self.model, self.calibration, self.redundancy, self._false_alarm)

    def with_parameter_values(self, values: FloatArray) -> Posor:
        """Return the same POSOR with another parameter vector of its stack (shape (p,)), and nothing remembered.

        ``calibration`` stays the calibration that this POSOR was made of.

        Raises:
            ShapeError: The vector has another length.
            ParameterError: A value is not finite.

        """
        if np.shape(values) != (self.stack.parameters,):
            raise ShapeError("values", received=np.shape(values), expected=f"({self.stack.parameters},)")
        if not np.isfinite(values).all():
            raise ParameterError("a value is not finite", where="parameter values", expected="finite numbers")
        other = copy.copy(self)
        other.stack = self.stack.with_parameter_values(values)
        other._prepare()  # noqa: SLF001  a copy of the same class
        return other

    def __deepcopy__(self, memo: dict[int, Any]) -> Posor:
        other = self.with_parameter_values(self.stack.parameter_values)
        other.model.workspace["tracker"] = self.model.workspace["tracker"]
        return other

    @property
    def settings(self) -> Any:
        """Settings of tracker and tests, a record of dtype ``workspace.SETTINGS``."""
        return self.model.workspace[0]["settings"]

    @property
    def tracker(self) -> Any:
        """What is known from the previous scans, a record of dtype ``workspace.TRACKER``."""
        return self.model.workspace[0]["tracker"]

    @cached_property
    def parameter_square_root(self) -> FloatArray:
        """A square root of the covariance of the stack's parameters that the calibration states, (p, factors)."""
        return self._square_root.dense()

    @property
    def shared_effects(self) -> FloatArray:
        """Change of the parameters by one standard uncertainty of each shared term of the calibration, (p, terms)."""
        return self._square_root.shared

    @property
    def has_plain_sensors(self) -> bool:
        """Whether sensors written in plain Python take part."""
        return self._plain.present

    @property
    def counts_bumps(self) -> bool:
        """Whether theta is found within one bump and counted in bumps, from a home mark or another reference."""
        return bool(self.settings["bump_angle"] > 0.0)

    @property
    def false_alarm(self) -> float:
        """Probability that the test of the redundant readings rejects a sound scan; 0: nothing is tested."""
        return self._false_alarm if math.isfinite(self.residual_limit) else 0.0

    @property
    def residual_limit(self) -> float:
        """Largest chi-square of the redundant readings that passes."""
        return float(self.settings["residual_limit"])

    def reset(self) -> None:
        """Forget pose, count, latch and clocks; the next scan starts from a closed form. Ambient light stays known."""
        kept = {name: self.tracker[name].copy() for name in ("epoch_known", "epoch_ns", "ambient")}
        self.model.workspace["tracker"] = np.zeros((), dtype=self.model.workspace["tracker"].dtype)
        for name, value in kept.items():
            self.tracker[name] = value

    def acknowledge(self) -> bool:
        """Release the latch after a fault: the next scan starts anew, and a counted theta must be counted again.

        Where dark scans hold light of the sources, the next dark scan counts as the first one.
        Poses are DEGRADED (``Fault.ACKNOWLEDGED``) until a reference or home marks confirm theta. Without a latch, so
        that after a latch it takes a second call, a step of the stamps is accepted: it no longer enlarges their largest
        error.

        Returns:
            Whether there was a latch, such light or a step; without one nothing changes.

        """
        if not self.has_latch:
            return False
        ambient, clocks = self.tracker["ambient"], self.tracker["clocks"]
        had_light = bool(ambient["light_left"])
        if had_light:
            ambient["light_left"] = ambient["known"] = 0
        if not self.tracker["latch"]:
            if not had_light:
                clocks["step"], clocks["age_step"], clocks["former_age"] = 0.0, 0.0, math.nan
            return True
        kept = {name: self.tracker[name].copy() for name in ("theta", "last_raw", "repeats", "measured")}
        step = float(clocks["step"])
        self.reset()
        for name, value in kept.items():
            self.tracker[name] = value
        self.tracker["acknowledged"], self.tracker["clocks"]["step"] = 1, step
        return True

    def confirm_theta(self, theta: float, sigma: float, stamp_ns: int | None = None) -> None:
        """Compare the theta of the next scan with that of an encoder or another reference.

        The reading is moved from its own stamp to that of the scan by the rate of the joint. Agreement within 5
        standard deviations counts theta where needed, and releases a latch that is about theta only. Disagreement is
        the latched ``Fault.ENCODER``; so is a time offset beyond 5 standard uncertainties and ``Scan.stamp_limit``.

        Args:
            theta: Large rotation, modulo whole turns [rad].
            sigma: Its standard uncertainty [rad].
            stamp_ns: When it was read [ns], on the clock of the scans; None: at the next scan.

        Raises:
            ParameterError: A number is not finite, ``sigma`` is not positive, it is too large to tell the periods of an
                ambiguous theta apart, or ``stamp_ns`` is not a positive integer.

        """
        try:
            valid = math.isfinite(theta) and math.isfinite(sigma) and sigma > 0.0
            time_ns = 0 if stamp_ns is None else whole_number(stamp_ns)
        except (TypeError, ValueError, OverflowError):
            valid = False
        if not valid or (stamp_ns is not None and time_ns <= 0):
            given = f"theta {theta!r}, sigma {sigma!r}, stamp_ns {stamp_ns!r}"
            expected = "finite numbers, sigma > 0, stamp_ns a positive integer"
            raise ParameterError(given, where="confirm_theta", expected=expected)
        period = float(self.settings["period"])
        if period > 0.0 and sigma > LARGEST_SIGMA * period:
            raise ParameterError(
                f"sigma {sigma:g} rad",
                where="confirm_theta",
                expected=f"at most {LARGEST_SIGMA * period:.3g}; theta repeats after {period:.3g} rad",
            )
        self.tracker["reference_theta"], self.tracker["reference_sigma"] = theta, sigma
        self.tracker["reference_stamp_ns"] = time_ns

    @property
    def time_offset(self) -> tuple[float, float]:
        """Offset between the scans and the reference of theta, and its standard uncertainty [s]; NaN without one.

        Positive where the content of the scans is older than their stamps; see ``estimation.time_offset``.
        """
        offset = self.tracker["offset"]
        return (float(offset["seconds"]), math.sqrt(offset["variance"])) if offset["known"] else (math.nan, math.nan)

    @property
    def dark_currents(self) -> FloatArray | None:
        """Diode currents of the ambient light by the dark scans, (diodes, 4) [A]; None: unknown, or not needed."""
        if not (self.settings["dark_age"] > 0.0 and self.tracker["ambient"]["known"]):
            return None
        return np.asarray(self.tracker["ambient"]["currents"].reshape(-1, CONTACTS)[: len(self.model.diodes)].copy())

    @property
    def latched(self) -> Fault:
        """Faults that keep the joint LOST until motion is regained, a reference agrees, or somebody acknowledges."""
        return Fault(int(self.tracker["latch"]))

    @property
    def has_latch(self) -> bool:
        """Whether ``acknowledge`` has anything to release: a fault, light in dark scans, or a step of the stamps."""
        tracker = self.tracker
        return bool(tracker["latch"] or tracker["ambient"]["light_left"] or tracker["clocks"]["step"])

    def continue_from(self, other: Posor, last: Scan | None = None) -> None:
        """Start the next scan from the previous pose of another POSOR of the same kind, with its count and latch.

        Args:
            other: The other POSOR.
            last: The scan of that pose. It is estimated once more, because the two calibrations may see one place
                differently. None, or LOST now: the next scan is compared with the pose of the other.

        From a POSOR whose theta repeats otherwise pose and count are not taken. A latch and a step of the stamps stay
        until ``acknowledge``.

        """
        periodic = ["bump_angle", "period", "home_theta"]
        if all(self.settings[name] == other.settings[name] for name in periodic):
            self.model.workspace["tracker"] = other.model.workspace["tracker"]
            for name in ("last_raw", "repeats", "signatures", "signature_count", "loop_repeats"):
                self.tracker[name] = 0
            if self.tracker["initialised"] and last is not None:
                followed, step = self.tracker.copy(), float(self.tracker["clocks"]["step"])
                self.tracker["start"] = self.tracker["pose"]
                self.tracker["start_given"], self.tracker["initialised"] = 1, 0
                self.tracker["clocks"] = 0  # the scan is seen once more
                self.tracker["clocks"]["step"], self.tracker["clocks"]["age"] = step, math.nan
                if self.estimate(last).state is State.LOST:
                    self.model.workspace["tracker"] = followed
        else:
            for name in ("latch", "latch_about_theta", "latch_interval", "acknowledged"):
                self.tracker[name] = other.tracker[name]
            self.tracker["clocks"]["step"] = other.tracker["clocks"]["step"]

    def estimate(self, scan: Scan) -> Estimate:
        """Return the pose of one scan, starting from the pose of the previous scan.

        Raises:
            ParameterError: The argument is no Scan.
            ShapeError: A reading of the scan has the wrong shape.

        """
        return self._one.estimate(scan)

    def estimate_all(self, scans: Scans, *, fault_effects: bool = False) -> Estimates:
        """Return the poses of many scans, one after the other: the same numbers as ``estimate`` of each.

        ``Estimates.lost_reasons()`` counts why scans are LOST. ``fault_effects``: whether to compute them.

        Raises:
            ParameterError: The argument is no Scans.

        """
        check_type(scans, Scans, "Posor.estimate_all")
        estimates = np.zeros(len(scans), dtype=ESTIMATE)
        effects = self.allocate_effects(len(scans) if fault_effects else 0)
        self.estimate_records(np.require(scans._records, requirements=["C", "W"]), estimates, effects)
        return Estimates(estimates, scans, self.reason, fault_effects=effects if fault_effects else None)

    def allocate_effects(self, scans: int) -> NDArray[np.float32]:
        """Return memory for the fault effects of scans, (n, C, EFFECT), filled with NaN."""
        return np.full((scans, len(self.hypotheses.names), EFFECT), np.nan, dtype=np.float32)

    def estimate_each(
        self, scans: Scans, thetas: FloatArray | None = None, *, fault_effects: bool = False
    ) -> Estimates:
        """Return the poses of scans that are independent of one another: each starts from a closed form.

        Args:
            scans: The scans.
            thetas: For a counted theta: its value to half a bump [rad], shape (n,); None: unknown.
            fault_effects: Whether to compute them.

        Returns:
            The estimates; the previous pose and the count are forgotten afterwards.

        Raises:
            ParameterError: ``scans`` is no Scans.
            ShapeError: There is not one theta for each scan.

        """
        check_type(scans, Scans, "Posor.estimate_each")
        if thetas is not None and np.shape(thetas) != (len(scans),):
            raise ShapeError("thetas", received=np.shape(thetas), expected=f"({len(scans)},)")
        estimates = np.zeros(len(scans), dtype=ESTIMATE)
        effects = self.allocate_effects(len(scans) if fault_effects else 0)
        arrays = record_view(np.require(scans._records, requirements=["C", "W"])), record_view(estimates), effects
        run = self._bind_scans(*arrays)
        try:
            for n in range(len(scans)):
                self.reset()
                self._known_theta = None if thetas is None else float(thetas[n])
                _, left = run(n, n + 1)
                if left != DONE:
                    self.finish_scan(*arrays, n, left, run)
        finally:
            self._known_theta = None
            self.reset()
        return Estimates(estimates, scans, self.reason, fault_effects=effects if fault_effects else None)

    def estimate_records(
        self, scans: NDArray[np.void], estimates: NDArray[np.void], effects: NDArray[np.float32] | None = None
    ) -> None:
        """Estimate scan records (n,), contiguous, dtype SCAN, into estimate records (n,), dtype ESTIMATE.

        ``effects``: memory of ``allocate_effects`` for all scans. None or of length 0: effects are not computed.
        """
        scans, estimates = record_view(scans), record_view(estimates)
        effects = self.allocate_effects(0) if effects is None else effects
        run = self._bind_scans(scans, estimates, effects)
        done, count = 0, len(scans)
        while done < count:
            done, left = run(done, count)
            if left != DONE:
                self.finish_scan(scans, estimates, effects, done, left, run)
                done += 1

    def _bind_scans(
        self, scans: NDArray[np.void], estimates: NDArray[np.void], effects: NDArray[np.float32]
    ) -> Callable[[int, int], tuple[int, int]]:
        """Return a function that estimates scans from one number to another; it returns as ``estimate_scans``."""
        if not self._plain.present:
            return bind(estimate_scans, (self.model, scans, estimates, effects))
        return partial(self._estimate_plain, scans, estimates, effects)

    def _estimate_plain(
        self, scans: NDArray[np.void], estimates: NDArray[np.void], effects: NDArray[np.float32], begin: int, end: int
    ) -> tuple[int, int]:
        for n in range(begin, end):
            _, left = self._plain.estimate_scans(scans, estimates, n, n + 1)
            if left != DONE:
                return n, left
            if len(effects):
                write_fault_effects(self.model, scans[n], estimates[n], effects[n])
        return end, DONE

    def finish_scan(
        self,
        scans: NDArray[np.void],
        estimates: NDArray[np.void],
        effects: NDArray[np.float32],
        n: int,
        left: int,
        run: Callable[[int, int], tuple[int, int]] | None = None,
    ) -> None:
        """Do what ``estimate_scans`` left to do for scan n: start from a closed form, or retry from there.

        The arrays are those of ``estimate_records`` in the view for kernels (``numerics.compiled.record_view``).
        ``run``: estimates them, if that is known already.
        """
        run = run or self._bind_scans(scans, estimates, effects)
        if left == START and self.counts_bumps:
            self.tracker["counted"] = 0  # a closed form does not know the count
        self._start(scans, estimates, n)
        self.model.workspace["is_retry"] = 1
        try:
            run(n, n + 1)
        finally:
            self.model.workspace["is_retry"] = 0

    def _start(self, scans: NDArray[np.void], estimates: NDArray[np.void], n: int) -> None:
        """Make the best closed-form start for scan n the start of the solver."""
        self._linearise(scans, estimates, n)
        workspace, m = self.model.workspace[0], self.stack.readings
        rows, values, variances = workspace["rows"], workspace["values"][:m], workspace["variances"][:m]
        selected = self.stack.reading_rows[workspace["selected_rows"][:m]]
        pose = workspace["pose"]
        bump, known = float(self.settings["bump_angle"]), self._known_theta
        near = float(self.tracker["theta"]) if known is None and self.tracker["initialised"] else (known or 0.0)
        guesses = [near + bump * (i / PHASE_GUESSES - 0.5) for i in range(PHASE_GUESSES)]
        workspace["rows_active"] = 0
        self._solve_start = self._solve_start or bind(solve_start, (self.model, SINGULAR))
        best = math.inf
        for start in start_poses(selected, values, guesses if self.counts_bumps else [0.0]):
            rows[:m] = selected
            self.stack.expand_plain_rows(rows, start.rotation, start.translation)
            pose["rotation"], pose["translation"] = start.rotation, start.translation
            settled = self._solve_start() == CONVERGED
            misfit = float((1.0 / variances) @ np.square(workspace["residuals"][:m])) if settled else math.inf
            misfit += float(np.sum(np.square(pose["translation"][:2] / LIKELY_RUNOUT)))
            if settled and self.counts_bumps and known is not None:
                off = abs(wrapped(native_from_rotation(pose["rotation"])[2] - known))
                misfit = misfit if off < COUNT_WINDOW * bump else math.inf
            if misfit < best or math.isinf(best):
                best = min(best, misfit)
                if settled:
                    self._set_start(pose["rotation"], pose["translation"])
                else:
                    self._set_start(start.rotation, start.translation)
        if known is not None:
            self.tracker["counted"] = 1

    def _linearise(self, scans: NDArray[np.void], estimates: NDArray[np.void], n: int) -> None:
        """Linearise the readings of scan n, which are valid, into the workspace."""
        if self._plain.present:
            self._plain.linearise(scans, estimates, n)
        else:
            linearise_scan(self.model, scans[n], estimates[n])

    def _set_start(self, rotation: FloatArray, translation: FloatArray) -> None:
        start = self.tracker["start"]
        start["rotation"], start["translation"] = rotation, translation
        self.tracker["start_given"] = 1

    def predict(self, scan: Scan, T_R_T: pin.SE3) -> FloatArray:
        """Return what every linearised reading of a scan would be at a pose [m], shape (m,).

        The scan says only which rows are read (which light sources are lit).

        Raises:
            ScanError: The scan names no valid light source.

        """
        linearised = self.stack.linearise(Scans.of([scan]))
        selected = linearised.selected[0]
        if (selected < 0).any():
            raise self.stack.invalid_scan(scan, linearised)
        return self.stack.evaluate(selected, T_R_T.rotation, T_R_T.translation)[0]

    def reason(self, scan: Scan, estimate: Any) -> str:
        """Return the sentence on the fault of a scan's estimate (record of dtype ESTIMATE), empty where it has none."""
        return fault_sentence(self.stack, self.settings, self.tracker, scan, estimate)


class _OneScan:
    """Estimates one scan at a time in memory that is allocated once."""

    def __init__(self, posor: Posor) -> None:
        self._posor = posor
        self._buffer = ScanBuffer()
        self._estimates = np.zeros(1, dtype=ESTIMATE)
        self._faults = self._estimates["faults"]
        records = record_view(self._buffer.records), record_view(self._estimates)
        self._arguments = posor.model, *records, posor.allocate_effects(0), 0, 1
        self._compiled: Callable[..., tuple[int, int]] | None = None

    def estimate(self, scan: Scan) -> Estimate:
        try:
            self._buffer.write(scan)
        except AttributeError:
            check_type(scan, Scan, "Posor.estimate")
            raise
        self._run()
        return estimate_of(self._estimates, 0, self._posor.reason(scan, self._estimates[0]) if self._faults[0] else "")

    def _run(self) -> None:
        if self._posor.has_plain_sensors:
            self._posor.estimate_records(self._buffer.records, self._estimates)
            return
        if self._compiled is None:
            self._compiled = bind(estimate_scans, self._arguments)
        _, left = self._compiled()
        if left != DONE:
            self._posor.finish_scan(*self._arguments[1:5], left)
