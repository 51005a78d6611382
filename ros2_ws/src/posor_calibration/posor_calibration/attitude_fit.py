# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Fit of parameters to a reference's attitude of the moving target: alpha, beta, theta.

The estimator itself is the model: for each set of parameters all scans are estimated again, and their angles compared
with the reference. Estimator and reference each have an arbitrary zero, so only changes of the angles are compared. All
other numbers of the calibration stay fixed, with their uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.bags.recording import POINT, POSE, unpack_poses
from posor.errors import FitError, TrackError
from posor.model.fault import State
from posor.model.native_coordinates import native_from_rotation, native_jacobian
from posor.model.scan import PROBES_ESTIMATED, SATURATED
from posor.sensors.base import READING_KINDS
from posor.uncertainty.reading_sensitivity import sensitivity_at
from pydantic import Field

from posor_calibration.calibration_parameters import FixedParameters, replace_values
from posor_calibration.data_checks import check_axis, check_channels_vary, check_clock, check_unit
from posor_calibration.dwells import use_values_once
from posor_calibration.fit_report import check_spread, describe_fit, enlarge_if_improbable, table_row
from posor_calibration.least_squares import Fit, fit_parameters
from posor_calibration.procedure import (
    Figure,
    LongestGapOption,
    LossOption,
    Options,
    SessionOption,
    Table,
    TrustSigmasOption,
)
from posor_calibration.recorded_poses import count_from_first_mark, counted_estimates, posor_without_rejection

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.bags.recording import Recording, Track
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

ANGLES = ("alpha", "beta", "theta")
CLEAR_MOTION = 50.0  # standard deviations of noise above which a motion is compared with the reference's
APPARENT_MOTION = 0.03  # share of a motion that a wrong calibration can produce in an angle that is at rest
LARGEST_ANGLE = 0.5  # largest plausible angle at the end of a lever [rad]
URAD = 1e-6


class AttitudeOptions(Options):
    """Options of procedures that compare the target's angles with a reference."""

    reference: str
    lever: float = Field(
        default=0.0, ge=0.0, description="distance of a reference point from the pivot [m]; 0: the reference is a pose"
    )
    session: SessionOption = ""
    longest_gap: LongestGapOption = 0.5
    loss: LossOption = "linear"
    trust_sigmas: TrustSigmasOption = True

    def read_reference(self, recording: Recording, twist_sigma: float) -> ReferenceAttitude:
        """Return the reference attitude at the times of the scans; see ``read_reference_attitude``."""
        how = {"lever": self.lever, "twist_sigma": twist_sigma, "longest_gap_s": self.longest_gap}
        return read_reference_attitude(recording, self.reference, **how)


@dataclass(frozen=True)
class ReferenceAttitude:
    """Alpha, beta, theta of the target by a reference whose axes are parallel to those of R."""

    angles: FloatArray  # [rad], (n, 3); NaN where unknown
    sigmas: FloatArray  # standard uncertainty of each angle [rad], (3,)
    track: Track | None  # of which the angles were interpolated

    def use_values_once(self, stamps_ns: IntArray, known: BoolArray) -> BoolArray:
        """Return which of the ``known`` scans (n,) to compare with the reference, see ``dwells.use_values_once``."""
        return known if self.track is None else use_values_once(self.track, stamps_ns, known)


def angles_from_displacements(displacements: FloatArray, lever: float) -> FloatArray:
    """Return alpha, beta, theta [rad] for displacements (n, 3) [m] at the end of a lever along X, (n, 3).

    X points along the lever, Y to its side, Z up. Alpha, the twist about the lever, is not observed and set to zero.
    Source: thesis appendix 8A.
    """
    angles = np.zeros_like(displacements)
    angles[:, 1:] = -np.arctan(displacements[:, 1:] / lever)
    return angles


def read_reference_attitude(
    recording: Recording, topic: str, *, lever: float, twist_sigma: float, longest_gap_s: float
) -> ReferenceAttitude:
    """Return the reference attitude at the times of the scans.

    The reference is a point at the end of a ``lever`` [m], whose twist alpha is known within ``twist_sigma`` [rad], or,
    with a lever of zero, a pose. Values further apart than ``longest_gap_s`` are not interpolated. Raises TrackError:
    there is no such reference; FitError: the lever is implausible.
    """
    gap_ns = round(longest_gap_s * 1e9)
    if lever > 0.0:
        track = recording.find_track(topic, POINT)
        angles = angles_from_displacements(track.interpolate(recording.scans.stamps_ns, gap_ns), lever)
        largest = np.nanmax(np.abs(angles), initial=0.0)
        if largest > LARGEST_ANGLE:
            what = f"a lever of {lever:g} m gives angles up to {largest:.3g} rad"
            raise FitError(what, where=track.source, expected="points in metres near the end of the lever")
        return ReferenceAttitude(angles, np.array([twist_sigma, *(track.sigmas[1:] / lever)]), track)
    try:
        track = recording.find_track(topic, POSE)
    except TrackError as error:
        expected = f"{error.expected}; or a lever, if the reference is a point"
        raise TrackError(error.what, where=error.where, expected=expected) from error
    values = track.interpolate(recording.scans.stamps_ns, gap_ns)
    known = np.isfinite(values).all(axis=1)
    angles = np.full((len(values), 3), np.nan)
    if known.any():
        angles[known] = [native_from_rotation(rotation) for rotation in unpack_poses(values[known])[0]]
        angles[known, 2] = np.unwrap(angles[known, 2])
    # A small rotation changes the components of a quaternion by half its angle.
    return ReferenceAttitude(angles, np.full(3, 2.0 * np.sqrt(np.mean(np.square(track.sigmas[3:])))), track)


@dataclass(frozen=True)
class AttitudeParameter:
    """A parameter to be fitted."""

    name: str
    unit: str
    index: int  # in the stack's parameter vector
    scale: float  # prior standard uncertainty


@dataclass(frozen=True)
class AttitudeFit:
    """Result of a fit to the attitude, over n scans."""

    fit: Fit  # of the parameters, and of the zeros of the angles unless these are exact
    readings: tuple[str, ...]  # name of each residual: ``alpha of scan 7``
    used: BoolArray  # scans that count, (n,)
    thetas: FloatArray  # theta of each scan by the POSOR [rad], (n,)
    before: FloatArray  # POSOR less reference with the former parameters, referred to the first scan used [rad], (n, 3)
    after: FloatArray  # the same with the fitted parameters
    fixed: FixedParameters
    scales: FloatArray  # prior standard uncertainty of each parameter of the fit, (p,)

    def describe(self, count: int) -> tuple[str, ...]:
        """Return the warnings on a fit whose first ``count`` parameters are the result."""
        unused = int(np.count_nonzero(~self.used))
        warning = (
            f"{unused} of {len(self.used)} scans are not used: they give no pose, theta is not counted, they have no "
            "reference or one that a nearer scan uses, or a reading was substituted or saturated."
        )
        return (*([warning] if unused else []), *describe_fit(self.fit, self.scales, count, self.readings))

    def error_figures(
        self, x: FloatArray, x_label: str, angles: Sequence[str] = ANGLES, title: str = "error of {}"
    ) -> tuple[Figure, ...]:
        """Return charts of the angles' errors before and after the fit over a quantity x, (n,)."""
        return tuple(
            Figure(
                title.format(angle),
                x_label,
                f"{angle}, POSOR less reference [urad]",
                {
                    name: (x[self.used], errors[self.used, ANGLES.index(angle)] / URAD)
                    for name, errors in (("before", self.before), ("after", self.after))
                },
            )
            for angle in angles
        )

    def error_table(self) -> Table:
        """Return standard deviation and maximum of the angles' errors, before and after the fit."""
        compared = np.isfinite(self.after).all(axis=1)
        both = (self.before[compared], self.after[compared])
        figures = [deviation_from_first(errors) for errors in both]
        figures += [np.max(np.abs(errors), axis=0, initial=0.0) for errors in both]
        return Table(
            "error of the angles, POSOR less reference, referred to the first scan",
            ("angle", "sd before", "sd after", "largest before", "largest after"),
            ("", *("urad",) * 4),
            tuple(table_row(angle, np.array(figures)[:, i] / URAD) for i, angle in enumerate(ANGLES)),
        )


class _AngleModel:
    """The angles that a POSOR estimates, as a function of its parameters."""

    def __init__(self, calibration: Calibration, scans: Scans, where: str) -> None:
        self.posor = posor_without_rejection(calibration)
        self.start = self.posor.stack.parameter_values
        self._scans = count_from_first_mark(self.posor, scans, where)
        self._estimates = counted_estimates(self.posor, self._scans, where)  # with the former parameters

    def estimate(self, where: IntArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return alpha, beta, theta [rad] (n, 3) and their random covariances (n, 3, 3).

        NaN: the scan gives no pose, or theta is not counted.
        """
        estimates = self.posor.with_parameter_values(replace_values(self.start, where, values)).estimate_all(
            self._scans
        )
        angles = np.array([native_from_rotation(rotation) for rotation in estimates.rotations])
        angles[:, 2] = estimates.thetas
        angles[estimates.states == int(State.UNCOUNTED)] = np.nan
        return angles, estimates.covariances_random[:, 3:, 3:]

    def derivatives(self, used: BoolArray) -> FloatArray:
        """Return d(alpha, beta, theta)/d(parameter) at the scans in use, zero elsewhere, (n, 3, p)."""
        estimates = self._estimates
        out = np.zeros((len(self._scans), 3, self.posor.stack.parameters))
        for n in np.flatnonzero(used).tolist():
            scan, T_R_T = self._scans[n], pin.SE3(estimates.rotations[n], estimates.translations[n])
            by_reading = native_jacobian(T_R_T.rotation) @ sensitivity_at(self.posor, scan, T_R_T).gain[3:]
            out[n] = by_reading @ self.posor.stack.residual_jacobian(scan, T_R_T.rotation, T_R_T.translation)
        return out


def fit_attitude(
    calibration: Calibration,
    recording: Recording,
    options: AttitudeOptions,
    reference: ReferenceAttitude,
    parameters: Sequence[AttitudeParameter],
    angles: Sequence[str],
    *,
    first_sigma: float | None = None,
    check_reference: bool,
    estimate_fixed: bool,
    what: str,
) -> AttitudeFit:
    """Find the parameters with which the angles change as those of the reference.

    Scans with substituted or saturated readings only lead from one scan to the next.

    Args:
        calibration: The calibration, its session not yet applied.
        recording: The scans.
        options: Session, loss, and whether the readings scatter as stated.
        reference: Attitude at the time of each scan.
        parameters: Those to fit.
        angles: The compared ones of alpha, beta, theta.
        first_sigma: Standard uncertainty of the angles' zero at the first scan [rad]. Zero: exact, all motion is
            referred to it, as in 1985; None: as uncertain as at any other scan.
        check_reference: Whether to refuse a reference that moves unlike the angles.
        estimate_fixed: Whether fixed parameters are estimated along; requires motion far larger than its noise.
        what: Name of the fit for error messages.

    Raises:
        FitError: No scan has a pose and a reference, a channel is stuck, or the fit fails.
        TrackError: The reference moves unlike the angles.

    """
    scans, valid = recording.scans, ~recording.has_status(PROBES_ESTIMATED | SATURATED)
    check_channels_vary(scans.select(valid), READING_KINDS, what)
    model = _AngleModel(calibration.for_session(options.session), scans, f"{what}, {recording.source}")
    where = np.array([parameter.index for parameter in parameters])
    columns = [ANGLES.index(angle) for angle in angles]
    start = model.start[where]
    found, covariances = model.estimate(where, start)
    used = valid & np.isfinite(found).all(axis=1) & np.isfinite(reference.angles[:, columns]).all(axis=1)
    if not used.any():
        raise FitError(
            f"none of {len(scans)} scans has both a pose and a reference attitude", where=what, expected="some"
        )
    if check_reference:
        _check_reference(scans.stamps_ns[used], found[used], reference.angles[used], columns, covariances[used], what)
    used = reference.use_values_once(scans.stamps_ns, used)
    first = int(np.argmax(used))
    covariance = covariances[used][:, columns][:, :, columns] + np.diag(np.square(reference.sigmas[columns]))
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))

    def errors(values: FloatArray) -> FloatArray:
        difference = np.full(found.shape, np.nan)
        difference[used] = (model.estimate(where, values)[0] - reference.angles)[used]
        lost = used & np.isnan(difference[:, columns]).any(axis=1)
        if lost.any():
            moved = zip(parameters, values, strict=True)
            raise FitError(
                f"scan {scans.numbers[int(np.argmax(lost))]} gives no pose, or no counted theta, when the fit tries "
                + ", ".join(f"{parameter.name} {value:.3g} {parameter.unit}" for parameter, value in moved),
                where=what,
                expected="readings and a reference that fit the calibration, or a loss that survives outliers",
            )
        return np.asarray(difference - difference[first])

    count = len(parameters)
    zeros = [] if first_sigma == 0.0 else list(angles)

    def residuals(values: FloatArray) -> FloatArray:
        zero = np.zeros(len(columns))
        zero[: len(zeros)] = values[count:]
        white = np.einsum("nij,nj->ni", whiten, errors(values[:count])[used][:, columns] - zero)
        if first_sigma is None:
            return np.asarray(white.ravel())
        # All errors are referred to the first scan: its own row concerns the zero only, whose prior stands last.
        prior = zero[: len(zeros)] / first_sigma if zeros else np.empty(0)
        return np.concatenate([white[1:].ravel(), prior])

    fixed = FixedParameters(calibration, where, options.session)
    derivatives = model.derivatives(used)
    derivatives = (derivatives - derivatives[first])[used][:, columns]
    effects = fixed.effects(np.einsum("nij,njp->nip", whiten, derivatives))
    if first_sigma is None:
        effects = np.concatenate(list(effects))
    else:
        effects = np.concatenate([*effects[1:], np.zeros((len(zeros), effects.shape[2]))])
    scales = np.array([*(parameter.scale for parameter in parameters), *(1e-3 for _ in zeros)])
    fit = fit_parameters(
        residuals,
        np.concatenate([start, np.zeros(len(zeros))]),
        [*(parameter.name for parameter in parameters), *(f"zero of {angle}" for angle in zeros)],
        [*(parameter.unit for parameter in parameters), *("rad" for _ in zeros)],
        scales,
        fixed_effects=effects if estimate_fixed else None,
        loss=options.loss,
        trust_sigmas=options.trust_sigmas,
        what=what,
    )
    fit = fit if estimate_fixed else fit.consider(effects)
    numbers = scans.numbers[used][0 if first_sigma is None else 1 :]
    readings = [f"{angle} of scan {number}" for number in numbers for angle in angles]
    readings += [] if first_sigma is None else [f"zero of {angle}" for angle in zeros]
    if options.trust_sigmas:
        check_spread(fit, readings, what)
        fit = enlarge_if_improbable(fit) if options.loss == "linear" else fit
    before, after = errors(start), errors(fit.values[:count])
    return AttitudeFit(fit, tuple(readings), used, found[:, 2], before, after, fixed, scales)


def _check_reference(
    stamps_ns: IntArray,
    found: FloatArray,
    reference: FloatArray,
    columns: list[int],
    covariances: FloatArray,
    what: str,
) -> None:
    """Raise TrackError if the reference is at rest, or has another unit, sense, clock, or order of axes."""
    noise = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2).mean(axis=0))
    travels = np.ptp(found, axis=0)
    for column in columns:
        travel, reference_travel = travels[column], float(np.ptp(reference[:, column]))
        where = f"{what}, {ANGLES[column]} of the reference"
        if travel < CLEAR_MOTION * noise[column]:
            if reference_travel > max(CLEAR_MOTION * noise[column], travel / APPARENT_MOTION):
                raise TrackError(
                    f"travels {reference_travel:.3g} rad while the POSOR is at rest",
                    where=where,
                    expected="scans of the same joint",
                )
            continue
        check_axis(found[:, column], reference, column, ANGLES, where)
        if reference_travel < APPARENT_MOTION * travel:
            if travel > APPARENT_MOTION * np.max(travels):
                raise TrackError(
                    f"stays within {reference_travel:.3g} rad while the POSOR travels {travel:.3g} rad",
                    where=where,
                    expected="a reference that watches this joint, in metres and radians",
                )
            continue
        check_clock(stamps_ns, found[:, column], reference[:, column], where)
        if np.corrcoef(found[:, column], reference[:, column])[0, 1] < 0.0:
            raise TrackError("turns opposite to the POSOR", where=where, expected="the sense of R's axes")
        check_unit(found[:, column], reference[:, column], where, "metres and radians")


def deviation_from_first(errors: FloatArray) -> FloatArray:
    """Return the thesis' standard deviation of errors referred to the first, (n,) or (n, k), along n.

    Root of the sum of squares of all but the first, over their number less one (listings of thesis appendix 8A). NaN
    for fewer than three.
    """
    freedoms = len(errors) - 2
    if freedoms <= 0:
        return np.full(errors.shape[1:], np.nan)
    return np.asarray(np.sqrt(np.sum(np.square(errors[1:]), axis=0) / freedoms))
