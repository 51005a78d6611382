"""Fit of parameters to what a reference says of the target's attitude while it moves: alpha, beta, theta.

The estimator itself is the model: at each set of parameters the scans are located again and their angles compared with
the reference's. Constant differences between the two mean nothing, since each has a zero of its own; what must agree
is how the angles change. All else that the calibration says is taken as it is, with its uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.calibrate.channels import KINDS, check_channels
from posor_estimator.core.calibrate.checks import check_axis, check_spread, check_unit
from posor_estimator.core.calibrate.clock import check_clock
from posor_estimator.core.calibrate.fit import Fit, Loss, fit
from posor_estimator.core.calibrate.orientation import ANGLES
from posor_estimator.core.calibrate.parameters import changed
from posor_estimator.core.calibrate.reporting import honest
from posor_estimator.core.calibrate.stated import Taken
from posor_estimator.core.native import native_from_rotation, native_jacobian
from posor_estimator.core.posor import Posor
from posor_estimator.errors import FitError, TrackError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.calibrate.orientation import Orientation
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import BoolArray, FloatArray, IntArray

CLEAR_MOTION = 50.0
"""Standard deviations of noise from which a motion is large enough to compare the reference's with."""
ERROR_OF_MOTION = 0.03
"""Share of a motion that a wrong calibration can feign where the reference stands: below it nothing is compared."""


@dataclass(frozen=True)
class Unknown:
    """A parameter to be found.

    Attributes:
        name: What to call it.
        unit: Its unit.
        index: Where it stands in the stack's parameter vector.
        scale: Standard uncertainty of what is known of it before.

    """

    name: str
    unit: str
    index: int
    scale: float


@dataclass(frozen=True)
class AttitudeFit:
    """What came of it.

    Attributes:
        fit: Of the unknowns, and of the angles' zeros if those were not taken for exact.
        readings: What each residual is of: ``alpha of scan 7``, (n,).
        values: The unknowns, (p,).
        used: Which scans were used, (n,) of truth values.
        thetas: Theta of each scan by the POSOR [rad], (n,).
        before: Error of the angles, POSOR less reference, with the parameters as they were [rad], (n, 3), the one of
            the first scan used taken off; NaN where there is none.
        after: The same with the parameters found.
        taken: What of the calibration was taken for known.

    """

    fit: Fit
    readings: tuple[str, ...]
    values: FloatArray
    used: BoolArray
    thetas: FloatArray
    before: FloatArray
    after: FloatArray
    taken: Taken


class _Angles:
    """Angles that a POSOR finds as a function of its parameters."""

    def __init__(self, calibration: Calibration, scans: Scans) -> None:
        # Nothing is refused: a wrong parameter is what this is about.
        self.posor = Posor(calibration.model_copy(update={"motion": None}), false_alarm=0.0)
        self.start = self.posor.stack.parameter_values
        self._scans = scans

    def at(self, where: IntArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return alpha, beta, theta [rad] (n, 3) and their random covariances (n, 3, 3)."""
        moved = self.posor.with_parameter_values(changed(self.start, where, values))
        found = moved.locate_all(self._scans)
        angles = np.array([native_from_rotation(rotation) for rotation in found.rotations])
        angles[:, 2] = found.thetas
        return angles, found.covariances_random[:, 3:, 3:]

    def derivatives(self, used: BoolArray) -> FloatArray:
        """Return d(alpha, beta, theta)/d(parameter) at the scans that are used, zero at the others, (n, 3, p)."""
        found = self.posor.locate_all(self._scans)
        out = np.zeros((len(self._scans), 3, self.posor.stack.parameters))
        for n in np.flatnonzero(used).tolist():
            scan, T_R_T = self._scans[n], pin.SE3(found.rotations[n], found.translations[n])
            by_reading = native_jacobian(T_R_T.rotation) @ self.posor.sensitivity(scan, T_R_T)[0][3:]
            out[n] = by_reading @ self.posor.stack.residual_jacobian(scan, T_R_T.rotation, T_R_T.translation)
        return out


def fit_attitude(
    calibration: Calibration,
    session: str,
    scans: Scans,
    sound: BoolArray,
    reference: Orientation,
    unknowns: Sequence[Unknown],
    angles: Sequence[str],
    *,
    first_sigma: float | None,
    check: bool,
    along: bool,
    loss: Loss,
    trust_sigmas: bool,
    what: str,
) -> AttitudeFit:
    """Find the parameters with which the angles change as the reference's do.

    Args:
        calibration: As it is, its session not yet applied.
        session: The session that holds; empty: none.
        scans: In the order of time.
        sound: Which of them count, (n,) of truth values; the others only lead from one to the next.
        reference: Orientation at the time of each scan.
        unknowns: What to find.
        angles: Which of alpha, beta, theta to compare.
        first_sigma: How well the zero of the angles at the first scan is known [rad]: zero where it counts as exact,
            since all motion is referred to it, as in 1985; None where it is as uncertain as that of any other scan.
        check: Whether to refuse a reference that moves unlike the angles, in a wrong unit or with its axes swapped.
        along: Whether what is taken for known is found along, which takes a motion far larger than its noise.
        loss: Of the fit.
        trust_sigmas: Whether the readings scatter as stated.
        what: What to call the fit in complaints.

    Raises:
        FitError: No scan gives a pose whose orientation the reference knows, a channel is stuck, or the fit fails.
        TrackError: The check says so.

    """
    check_channels(scans.chosen(sound), KINDS, what)
    model = _Angles(calibration.for_session(session), scans)
    where = np.array([unknown.index for unknown in unknowns])
    columns = [ANGLES.index(angle) for angle in angles]
    start = model.start[where]
    found, covariances = model.at(where, start)
    used = sound & np.isfinite(found).all(axis=1) & np.isfinite(reference.angles[:, columns]).all(axis=1)
    if not used.any():
        raise FitError(
            f"none of {len(scans)} scans gives a pose whose orientation the reference knows",
            where=what,
            expected="some",
        )
    if check:
        stamps = scans.stamps_ns[used]
        _check_reference(stamps, found[used], reference.angles[used], columns, covariances[used], what)
    covariance = covariances[used][:, columns][:, :, columns] + np.diag(np.square(reference.sigmas[columns]))
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))

    def errors(values: FloatArray) -> FloatArray:
        every = np.full(found.shape, np.nan)
        every[used] = (model.at(where, values)[0] - reference.angles)[used]
        lost = used & np.isnan(every[:, columns]).any(axis=1)
        if lost.any():
            raise FitError(
                f"scan {scans.numbers[int(np.argmax(lost))]} gives no pose any more as the parameters move, to "
                + ", ".join(
                    f"{unknown.name} {value:.3g} {unknown.unit}"
                    for unknown, value in zip(unknowns, values, strict=True)
                ),
                where=what,
                expected="readings and a reference that fit the calibration, or a loss that survives outliers",
            )
        return np.asarray(every - every[int(np.argmax(used))])

    count = len(unknowns)
    zeros = [] if first_sigma == 0.0 else list(angles)

    def residuals(values: FloatArray) -> FloatArray:
        zero = np.zeros(len(columns))
        zero[: len(zeros)] = values[count:]
        rest = errors(values[:count])[used][:, columns] - zero
        # The first scan's error is what the others are referred to; its own row speaks of the zero only.
        white = np.einsum("nij,nj->ni", whiten, rest)
        if first_sigma is None:
            return np.asarray(white.ravel())
        prior = zero[: len(zeros)] / first_sigma if zeros else np.empty(0)
        return np.concatenate([white[1:].ravel(), prior])

    taken = Taken(calibration, where, session)
    by_parameter = model.derivatives(used)
    by_parameter = (by_parameter - by_parameter[int(np.argmax(used))])[used][:, columns]
    effects = taken.effects(np.einsum("nij,njp->nip", whiten, by_parameter))
    if first_sigma is not None:  # the first scan speaks of the zero only, whose own reading, if any, stands last
        effects = np.concatenate([*effects[1:], np.zeros((len(zeros), effects.shape[2]))])
    else:
        effects = np.concatenate(list(effects))
    outcome = fit(
        residuals,
        np.concatenate([start, np.zeros(len(zeros))]),
        [*(unknown.name for unknown in unknowns), *(f"zero of {angle}" for angle in zeros)],
        [*(unknown.unit for unknown in unknowns), *("rad" for _ in zeros)],
        np.array([*(unknown.scale for unknown in unknowns), *(1e-3 for _ in zeros)]),
        taken=effects if along else None,
        loss=loss,
        trust_sigmas=trust_sigmas,
        what=what,
    )
    outcome = outcome if along else outcome.considering(effects)
    best = outcome.values[:count]
    numbers = scans.numbers[used][0 if first_sigma is None else 1 :]
    readings = [f"{angle} of scan {number}" for number in numbers for angle in angles]
    readings += [] if first_sigma is None else [f"zero of {angle}" for angle in zeros]
    if trust_sigmas:
        check_spread(outcome, readings, what)
        outcome = honest(outcome) if loss == "linear" else outcome
    return AttitudeFit(outcome, tuple(readings), best, used, found[:, 2], errors(start), errors(best), taken)


def _check_reference(
    stamps_ns: IntArray,
    found: FloatArray,
    reference: FloatArray,
    columns: list[int],
    covariances: FloatArray,
    what: str,
) -> None:
    """Refuse a reference that stands, in a wrong unit, of the wrong sense, of another clock, or with its axes swapped.

    Raises:
        TrackError: It is; the sentence says which.

    """
    noise = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2).mean(axis=0))
    travels = np.ptp(found, axis=0)
    for column in columns:
        moved, said = travels[column], float(np.ptp(reference[:, column]))
        where = f"{what}, {ANGLES[column]} of the reference"
        if moved < CLEAR_MOTION * noise[column]:
            if said > max(CLEAR_MOTION * noise[column], moved / ERROR_OF_MOTION):
                raise TrackError(
                    f"goes over {said:.3g} rad while the POSOR stands", where=where, expected="scans of the same joint"
                )
            continue
        check_axis(found[:, column], reference, column, ANGLES, where)
        if said < ERROR_OF_MOTION * moved:
            if moved > ERROR_OF_MOTION * np.max(travels):
                raise TrackError(
                    f"stands within {said:.3g} rad while the POSOR's goes over {moved:.3g} rad",
                    where=where,
                    expected="a reference that watches this joint, in metres and radians",
                )
            continue
        check_clock(stamps_ns, found[:, column], reference[:, column], where)
        if np.corrcoef(found[:, column], reference[:, column])[0, 1] < 0.0:
            raise TrackError("turns the other way than the POSOR", where=where, expected="the sense of R's axes")
        check_unit(found[:, column], reference[:, column], where, "metres and radians")


def deviation(errors: FloatArray) -> FloatArray:
    """Return the thesis' standard deviation of errors referred to the first, shape (n,) or (n, k), along n.

    The root of the sum of squares of all but the first, over their number less one (listings of thesis appendix 8A).
    NaN for fewer than three.
    """
    freedoms = len(errors) - 2
    if freedoms <= 0:
        return np.full(errors.shape[1:], np.nan)
    return np.asarray(np.sqrt(np.sum(np.square(errors[1:]), axis=0) / freedoms))
