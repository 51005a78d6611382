# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fit of all parameters of an arm to references of its endpoint, and its test on readings that are not used.

The prior uncertainties of the files are readings of their own, so that what the references do not determine stays as it
was. Readings of one pose share the noise of the POSORs and are weighted together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from posor.bags.recording import POINT
from posor.errors import FitError
from scipy.linalg import block_diag, solve_triangular

from posor_calibration.arm.arm_model import EXACT, UNITS, Parameter
from posor_calibration.data_checks import MOST_OUTLIERS, POSE_AXES
from posor_calibration.fit_report import check_spread, describe_spread
from posor_calibration.least_squares import fit_parameters

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from posor.numerics.array_types import BoolArray, FloatArray

    from posor_calibration.arm.arm_model import ArmModel, ArmStates, Motion
    from posor_calibration.arm.endpoint_references import EndpointReferences, Reading
    from posor_calibration.least_squares import Fit, Loss

NAME = "calibrate-arm"
CENTRE = "fixed ball"
CENTRE_SIGMA = 10.0  # prior standard uncertainty of the fixed ball [m]: not known beforehand
STEP = 1e-3  # expected size of what is not known beforehand [m], [rad]
UNDETERMINED = 0.5  # share of its prior standard uncertainty that a parameter keeps if the references leave it open
MOST_CORRECTION = 10.0  # correction over its prior standard uncertainty: beyond it, file and arm do not belong together
STEP_SHARE = 0.5  # of the squares of residuals that one step explains, if the tracker or the base has moved
LEAST_MOVED = 3  # outliers in a row, up to the last reading or from the first one, that a moved reflector explains
SCALE_SIGMAS = 3.0  # of a share common to all beams
SPARE = 3  # numbers that there must be beyond the unknown mounting


@dataclass(frozen=True)
class Tool:
    """A reflector on the endpoint."""

    T_endpoint_reflector: pin.SE3  # as drawn
    sigmas: tuple[float, float]  # its prior standard uncertainty [m], [rad]


class Misfit(NamedTuple):
    """Root mean squares of differences of readings from the arm."""

    position: float  # of points, of all three axes together, and of distances [m]
    orientation: float  # of poses [rad]; NaN: no poses
    largest: float  # [m]
    readings: int


@dataclass(frozen=True)
class ArmCalibration:
    """Result: the parameters, and how readings fit before and after."""

    parameters: tuple[Parameter, ...]
    values: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)
    spread: float  # root of chi-square over the freedoms; 1 if the stated uncertainties are right
    undetermined: tuple[str, ...]  # parameters that stay as they were
    outliers: tuple[str, ...]  # readings that were left out
    before: Mapping[str, Misfit]  # with the mounting alone fitted: readings "used" and "held out"
    after: Mapping[str, Misfit]
    warnings: tuple[str, ...]

    @property
    def sigmas(self) -> FloatArray:
        """Standard uncertainty of each parameter, (p,)."""
        return np.sqrt(np.diagonal(self.covariance))


class Prediction(NamedTuple):
    """Places in the frame of the references, as calibrated."""

    places: list[pin.SE3]
    covariances: FloatArray  # axes of the place, (n, 6, 6) of x, y, z [m], about X, Y, Z [rad]


class ArmProblem:
    """Readings at poses of an arm, and their residuals for all parameters.

    Attributes:
        model: The arm.
        states: Its poses.
        readings: Of its endpoint.
        T_reference_base: The base in the frame of the references, where its parameters are zero.
        parameters: Those of the model, then of the reflectors and of the fixed ball.
        prior: Their covariance before the fit, (p, p).

    """

    def __init__(
        self, model: ArmModel, states: ArmStates, references: EndpointReferences, tools: Mapping[str, Tool]
    ) -> None:
        """Place the base at the references, and weigh the readings; ``tools``: of each reflector, by name."""
        self.model, self.states, self.readings = model, states, references.readings
        self.T_reference_base = pin.SE3.Identity()
        self._tools = tools
        self.parameters = [*model.parameters]
        sigmas: list[FloatArray] = []
        self._first: dict[str, slice] = {}
        for name, kind in references.reflectors.items():
            size, known = (6 if kind == "pose" else POINT), np.repeat(self._tools[name].sigmas, 3)
            self._add(f"tool {name}", known[:size], sigmas)
        self.centre = np.zeros(POINT)
        if "distance" in references.reflectors.values():
            self._add(CENTRE, np.full(POINT, CENTRE_SIGMA), sigmas)
        self.prior = block_diag(model.prior, np.diag(np.square(np.concatenate(sigmas))))
        self._placed = any(kind != "distance" for kind in references.reflectors.values())
        if not self._placed:  # distances do not see where the base is: their frame is that of the base
            self.prior[:6, :6] = EXACT**2 * np.eye(6)
            self.parameters[:6] = [each._replace(sigma=EXACT) for each in self.parameters[:6]]
        zero = np.zeros(len(self.parameters))
        self._place(model.move(states, zero, self.T_reference_base))
        self._covariance = self._covariance_of_readings(model.move(states, zero, self.T_reference_base))
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def _add(self, name: str, sigmas: FloatArray, all_sigmas: list[FloatArray]) -> None:
        begin = len(self.parameters)
        self._first[name] = slice(begin, begin + len(sigmas))
        all_sigmas.append(sigmas)
        rows = zip(POSE_AXES, UNITS, sigmas, strict=False)
        self.parameters += [Parameter(f"{name} {axis}", unit, float(sigma)) for axis, unit, sigma in rows]

    def _place(self, start: Motion) -> None:
        """Find the base in the frame of the references from points and poses, and the fixed ball from distances."""
        seen = [reading for reading in self.readings if reading.kind != "distance"]
        places = {
            r.name: start.endpoints[r.pose] * self._tools[r.reflector].T_endpoint_reflector for r in self.readings
        }
        if seen:
            arm = np.array([places[reading.name].translation for reading in seen])
            points = np.array([reading.values[:POINT] for reading in seen])
            left, _, right = np.linalg.svd((points - points.mean(axis=0)).T @ (arm - arm.mean(axis=0)))
            turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
            poses = [reading for reading in seen if reading.kind == "pose"]
            if poses:
                turn = (pin.XYZQUATToSE3(poses[0].values) * places[poses[0].name].inverse()).rotation
            self.T_reference_base = pin.SE3(turn, points.mean(axis=0) - turn @ arm.mean(axis=0))
        lengths = [reading for reading in self.readings if reading.kind == "distance"]
        if lengths:
            arm = np.array([self.T_reference_base.act(places[reading.name].translation) for reading in lengths])
            squares = np.sum(np.square(arm), axis=1) - [reading.values[0] ** 2 for reading in lengths]
            equations = np.hstack([2.0 * arm, np.ones((len(arm), 1))])
            found = np.linalg.lstsq(equations, squares, rcond=1e-9)[0][:POINT]
            touching = all(reading.values[0] == 0.0 for reading in lengths)
            self.centre = arm.mean(axis=0) if touching else found

    def evaluate(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return differences of the arm from the readings (m,), and their derivatives, (m, p)."""
        if self._last is not None and np.array_equal(self._last[0], values):
            return self._last[1], self._last[2]
        motion = self.model.move(self.states, values, self.T_reference_base)
        parts = [self._difference(reading, motion, values) for reading in self.readings]
        self._last = values.copy(), np.concatenate([each[0] for each in parts]), np.vstack([each[1] for each in parts])
        return self._last[1], self._last[2]

    def _reflector(
        self, name: str, motion: Motion, pose: int, values: FloatArray
    ) -> tuple[pin.SE3, FloatArray, FloatArray]:
        """Return a reflector in the frame of the references, its derivatives (6, p), and those by its endpoint, (6, 6).

        All derivatives are in the axes of the reflector.
        """
        of_tool = self._first[f"tool {name}"]
        size = of_tool.stop - of_tool.start
        error = np.zeros(6)
        error[:size] = values[of_tool]
        T_endpoint_reflector = self._tools[name].T_endpoint_reflector * pin.exp6(error)
        by_endpoint = T_endpoint_reflector.inverse().toActionMatrix()
        twist = np.zeros((6, len(self.parameters)))
        twist[:, : motion.by_parameter.shape[2]] = by_endpoint @ motion.by_parameter[pose]
        twist[:, of_tool] = pin.Jexp6(error)[:, :size]
        return motion.endpoints[pose] * T_endpoint_reflector, twist, by_endpoint

    def _difference(self, reading: Reading, motion: Motion, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        place, twist, _ = self._reflector(reading.reflector, motion, reading.pose, values)
        shift = place.rotation @ twist[:POINT]
        if reading.kind == "point":
            return place.translation - reading.values, shift
        if reading.kind == "pose":
            turn = pin.XYZQUATToSE3(reading.values).rotation.T @ place.rotation
            return (
                np.append(place.translation - reading.values[:POINT], pin.log3(turn)),
                np.vstack([shift, pin.Jlog3(turn) @ twist[POINT:]]),
            )
        of_centre = self._first[CENTRE]
        between = place.translation - self.centre - values[of_centre]
        shift[:, of_centre] -= np.eye(POINT)
        if reading.values[0] == 0.0:
            return between, shift
        length = float(np.linalg.norm(between))
        return np.array([length - reading.values[0]]), (between / length)[None] @ shift

    def predict(self, calibration: ArmCalibration, states: ArmStates, reflector: str) -> Prediction:
        """Return a reflector at any poses, with the covariance of all parameters and of what is new at each pose."""
        motion = self.model.move(states, calibration.values, self.T_reference_base)
        places, covariances = [], np.empty((len(motion.endpoints), 6, 6))
        for pose in range(len(motion.endpoints)):
            place, twist, by_endpoint = self._reflector(reflector, motion, pose, calibration.values)
            joints = np.hstack(list(by_endpoint @ motion.by_joint[pose]))
            own = joints @ block_diag(*states.own[pose]) @ joints.T
            covariances[pose] = twist @ calibration.covariance @ twist.T + own
            places.append(place)
        return Prediction(places, covariances)

    def _covariance_of_readings(self, motion: Motion) -> FloatArray:
        """Return the covariance of the differences by instruments, noise and varying errors of the POSORs, (m, m)."""
        covariance = np.diag(np.square(np.concatenate([reading.sigmas for reading in self.readings])))
        # A small motion of a joint acts like six parameters: it takes the place of the first ones.
        alone = motion.by_joint.swapaxes(1, 2).reshape(len(motion.by_joint), 6, -1)
        moved, zero = motion._replace(by_parameter=alone), np.zeros(len(self.parameters))
        for pose in range(len(alone)):
            here = [number for number, reading in enumerate(self.readings) if reading.pose == pose]
            if not here:
                continue
            effects = np.vstack([self._difference(self.readings[n], moved, zero)[1] for n in here])[:, : alone.shape[2]]
            rows = np.flatnonzero(self.rows_of(here))
            covariance[np.ix_(rows, rows)] += effects @ block_diag(*self.states.own[pose]) @ effects.T
        return covariance

    def rows_of(self, readings: Collection[int]) -> BoolArray:
        """Return which rows of the differences belong to readings, (m,)."""
        sizes = [len(reading.sigmas) for reading in self.readings]
        return np.asarray(np.repeat(np.isin(np.arange(len(sizes)), list(readings)), sizes))

    @property
    def mounting_unknowns(self) -> int:
        """Number of parameters of base, reflectors and fixed ball."""
        return (6 if self._placed else 0) + len(self.parameters) - len(self.model.parameters)

    def whitened_by_pose(self) -> dict[int, FloatArray]:
        """Return the derivatives of the readings of each pose, over their standard uncertainties, (m, p)."""
        derivatives, found = self.evaluate(np.zeros(len(self.parameters)))[1], {}
        for pose in dict.fromkeys(reading.pose for reading in self.readings):
            rows = self.rows_of([n for n, reading in enumerate(self.readings) if reading.pose == pose])
            root = np.linalg.cholesky(self._covariance[np.ix_(rows, rows)])
            found[pose] = np.asarray(solve_triangular(root, derivatives[rows], lower=True))
        return found

    def names_of(self, readings: Collection[int]) -> list[str]:
        """Return the name of the reading of each row of these readings."""
        return [self.readings[n].name for n in sorted(readings) for _ in self.readings[n].sigmas]

    def fit(
        self, readings: Collection[int], *, loss: Loss = "linear", mounting_only: bool = False, enlarged: float = 1.0
    ) -> Fit:
        """Fit all parameters, or those of base, tool and fixed ball alone, to readings (their numbers).

        ``enlarged``: factor of the standard uncertainties of the readings. Raises FitError: the fit does not converge.
        """
        rows, count = self.rows_of(readings), len(self.model.parameters)
        root = enlarged * np.linalg.cholesky(self._covariance[np.ix_(rows, rows)])
        mounting = [*range(6 if self._placed else 0), *range(count, len(self.parameters))]
        free = np.array(mounting if mounting_only else range(len(self.parameters)))

        def whole(values: FloatArray) -> FloatArray:
            every = np.zeros(len(self.parameters))
            every[free] = values
            return every

        def residuals(values: FloatArray) -> FloatArray:
            return np.asarray(solve_triangular(root, self.evaluate(whole(values))[0][rows], lower=True))

        def jacobian(values: FloatArray) -> FloatArray:
            return np.asarray(solve_triangular(root, self.evaluate(whole(values))[1][np.ix_(rows, free)], lower=True))

        own = [self.parameters[i] for i in free]
        return fit_parameters(
            residuals,
            np.zeros(len(free)),
            [each.name for each in own],
            [each.unit for each in own],
            np.array([each.sigma if each.unit == "1" else min(each.sigma, STEP) for each in own]),
            jacobian=jacobian,
            prior=self.prior[np.ix_(free, free)],
            loss=loss,
            what=NAME,
        )

    def whole(self, fit: Fit) -> FloatArray:
        """Return all parameters by a fit of some of them; the others are zero."""
        values = np.zeros(len(self.parameters))
        values[[index for index, each in enumerate(self.parameters) if each.name in fit.names]] = fit.values
        return values

    def misfit(self, fit: Fit, readings: Collection[int]) -> Misfit:
        """Return how readings (their numbers) differ from the arm with the parameters of a fit; none: NaN."""
        differences = self.evaluate(self.whole(fit))[0]
        own = [differences[self.rows_of([number])] for number in sorted(readings)]
        if not own:
            return Misfit(np.nan, np.nan, np.nan, 0)
        lengths = [float(np.linalg.norm(each[:POINT])) for each in own]
        turns = [float(np.linalg.norm(each[POINT:])) for each in own if len(each) > POINT]
        angle = float(np.sqrt(np.mean(np.square(turns)))) if turns else np.nan
        return Misfit(float(np.sqrt(np.mean(np.square(lengths)))), angle, max(lengths), len(own))


def calibrate_arm(problem: ArmProblem, held_out: Collection[int]) -> ArmCalibration:
    """Fit an arm to readings, and compare it with those of the poses ``held_out``, which are not used.

    Raises FitError: there are too few readings, more than a tenth are outliers, a reflector has moved, or readings,
    files and arm do not belong together.
    """
    every = range(len(problem.readings))
    _check_count(problem, [n for n in every if problem.readings[n].pose not in held_out])
    out = _find_outliers(problem)
    used = [n for n in every if n not in out and problem.readings[n].pose not in held_out]
    tested = [n for n in every if n not in out and problem.readings[n].pose in held_out]
    _check_count(problem, used)
    mounting, found = problem.fit(used, mounting_only=True), problem.fit(used)
    if found.is_too_large:
        _check_step(problem, found, used)
    check_spread(found, problem.names_of(used), NAME)
    spread, warnings = found.spread, describe_spread(found)
    if found.is_too_large:
        found = problem.fit(used, enlarged=spread)
        warnings += ("The readings count with uncertainties that are enlarged by this factor.",)
    sigmas = np.sqrt(np.diagonal(problem.prior))
    _check_corrections(found, sigmas)
    open_ones = (found.sigmas > UNDETERMINED * sigmas) & (sigmas > 2.0 * EXACT)
    groups = {"used": used, "held out": tested}
    return ArmCalibration(
        parameters=tuple(problem.parameters),
        values=found.values,
        covariance=found.covariance,
        spread=spread,
        undetermined=tuple(name for name, is_open in zip(found.names, open_ones, strict=True) if is_open),
        outliers=tuple(problem.readings[n].name for n in sorted(out)),
        before={name: problem.misfit(mounting, group) for name, group in groups.items()},
        after={name: problem.misfit(found, group) for name, group in groups.items()},
        warnings=(*warnings, *_describe_scale(problem, found)),
    )


def _describe_scale(problem: ArmProblem, found: Fit) -> tuple[str, ...]:
    """Return a warning if all beams are longer or shorter by one share than their prior uncertainties explain.

    Readings do not tell longer beams from a reference with a wrong scale. The share is that of weighted least squares
    over the beams; where the prior is right, its variance is what the fit takes from the prior.
    """
    errors = problem.states.errors.mean(axis=0)
    beams = [(n, each.beam) for n, each in enumerate(problem.model.elements) if each.beam is not None]
    if not beams:
        return ()
    by_parameter = np.vstack([errors[n, :3] for n, _ in beams])  # of the end of each beam in its axes
    spans = np.concatenate([beam.T_start_end.rotation.T @ beam.T_start_end.translation for _, beam in beams])
    count = by_parameter.shape[1]
    prior, left = (
        by_parameter @ matrix[:count, :count] @ by_parameter.T for matrix in (problem.prior, found.covariance)
    )
    weights = np.linalg.solve(prior, spans)
    weights /= spans @ weights
    share = float(weights @ by_parameter @ found.values[:count])
    sigma = math.sqrt(max(float(weights @ (prior - left) @ weights), 0.0))
    if not abs(share) > SCALE_SIGMAS * sigma:
        return ()
    size = f"{1e6 * abs(share):.0f} µm/m {'longer' if share > 0.0 else 'shorter'}"
    what = f"All beams are {size} than the files state, {abs(share) / sigma:.1f} standard uncertainties of this"
    return (f"{what}: is the scale of the references wrong, by their air, temperature or unit?",)


def _check_count(problem: ArmProblem, used: Sequence[int]) -> None:
    """Refuse fewer numbers than the mounting has unknowns."""
    numbers = sum(len(problem.readings[n].sigmas) for n in used)
    unknown = problem.mounting_unknowns
    if numbers < unknown + SPARE:
        poses = len({problem.readings[n].pose for n in used})
        what = f"{numbers} numbers at {poses} poses for {unknown} unknowns of base, tool and fixed ball alone"
        raise FitError(what, where=NAME, expected=f"at least {unknown + SPARE} numbers, better several hundred")


def _find_outliers(problem: ArmProblem) -> set[int]:
    """Return the numbers of readings that the others contradict."""
    every = range(len(problem.readings))
    robust = problem.fit(every, loss="soft_l1")
    names = problem.names_of(every)
    wrong = {name for name, is_out in zip(names, robust.outliers(), strict=True) if is_out}
    out = {n for n in every if problem.readings[n].name in wrong}
    for reflector in {problem.readings[n].reflector for n in out}:
        own = [n for n in every if problem.readings[n].reflector == reflector]
        is_out = [n in out for n in own]
        for flags, where in ((is_out[::-1], "after"), (is_out, "before")):
            count = flags.index(False) if False in flags else len(flags)
            if LEAST_MOVED <= count < len(own) and count == sum(is_out):
                edge = own[-count - 1] if where == "after" else own[count]
                what = f"all {count} readings {where} {problem.readings[edge].name} disagree with the others"
                expected = f"a reflector that stays in its place: has '{reflector}' moved?"
                raise FitError(what, where=NAME, expected=expected)
    if len(out) > MOST_OUTLIERS * len(problem.readings):
        some = ", ".join(problem.readings[n].name for n in sorted(out)[:LEAST_MOVED])
        what = f"{len(out)} of {len(problem.readings)} readings disagree with the others, such as {some}"
        raise FitError(what, where=NAME, expected=f"at most {100 * MOST_OUTLIERS:g} % outliers")
    return out


def _check_step(problem: ArmProblem, found: Fit, used: Sequence[int]) -> None:
    """Refuse residuals that are mostly one step of all points: the tracker or the base has moved between two poses."""
    differences = problem.evaluate(problem.whole(found))[0]
    points = [n for n in used if problem.readings[n].kind != "distance"]
    if not points:
        return
    poses = np.array([problem.readings[n].pose for n in points])
    rest = np.array([differences[problem.rows_of([n])][:POINT] for n in points])
    steps = []
    for last in np.unique(poses)[LEAST_MOVED - 1 : -LEAST_MOVED].tolist():
        before, after = rest[poses <= last], rest[poses > last]
        step = after.mean(axis=0) - before.mean(axis=0)
        steps.append((float(step @ step) * len(before) * len(after) / len(rest), last, step))
    explained, last, step = max(steps, default=(0.0, 0, np.zeros(POINT)), key=lambda each: each[0])
    if explained > STEP_SHARE * float(np.sum(np.square(rest - rest.mean(axis=0)))) > 0.0:
        name = [problem.readings[n].name for n in points if problem.readings[n].pose == last][-1]
        x, y, z = -1e3 * step
        what = f"all readings after {name} are off by {x:+.2f}, {y:+.2f}, {z:+.2f} mm from those before"
        raise FitError(
            what, where=NAME, expected="references in one frame: has the tracker or the base of the arm moved?"
        )


def _check_corrections(found: Fit, sigmas: FloatArray) -> None:
    """Refuse corrections that the uncertainties of the files exclude."""
    ratios = np.abs(found.values) / sigmas
    worst = int(np.argmax(ratios))
    if ratios[worst] > MOST_CORRECTION:
        what = f"{found.names[worst]} is {found.values[worst]:.3g} {found.units[worst]} off"
        expected = (
            f"at most {MOST_CORRECTION:g} times its stated standard uncertainty of {sigmas[worst]:.3g}; "
            "is it the file of this arm, and are the references in its units?"
        )
        raise FitError(what, where=NAME, expected=expected)
