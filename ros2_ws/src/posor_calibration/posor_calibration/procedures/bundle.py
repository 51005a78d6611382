# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bundle fit: any parameters of a POSOR together, through its measurement model, from the scans of many poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from posor.calibration.calibration_file import Calibration, TiltAngle
from posor.errors import FitError
from posor.estimation.sensor_stack import Stack
from posor.model.scan import DIODES_ESTIMATED, PROBES_ESTIMATED, SATURATED
from pydantic import Field

from posor_calibration.bundle_data import MIN_POSES, BundleDataOptions, make_bundle_data
from posor_calibration.bundle_problem import BundleData, BundleProblem, OutOfRangeError, add_unfitted_uncertainty
from posor_calibration.calibration_parameters import FreeParameters
from posor_calibration.data_checks import check_count
from posor_calibration.fit_report import check_spread, describe_spread, parameter_table, table_row
from posor_calibration.least_squares import UNDETERMINED, Fit, Loss, WeakDirection, weak_directions
from posor_calibration.pose_advice import propose_poses
from posor_calibration.procedure import LossOption, Outcome, Procedure, Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.bags.recording import Recording
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray

NAME = "bundle"
LARGE_CHANGE = 4.0  # change of a parameter, in prior standard uncertainties, that is reported
SHOWN_DIRECTIONS = 12
MOST_OUT_OF_RANGE = 0.1  # share of scans that may leave the calibrated range as the parameters change


class BundleOptions(BundleDataOptions):
    """Options of ``bundle``."""

    parameters: tuple[str, ...] = Field(
        default=("*",),
        min_length=1,
        description="keys of what may change, such as sensors[0].probes[*].tip; * for anything",
    )
    session: str = Field(
        default="", description="session of the calibration file in force during the recording; empty: none"
    )
    loss: LossOption = "huber"
    covariance: bool = Field(default=True, description="write the whole covariance into the file")
    seed: int = Field(default=1985, ge=0, description="seed of the proposed poses")


@dataclass(frozen=True)
class SolvedBundle:
    """A bundle fit with its data."""

    stack: Stack  # the sensors before the fit
    free: FreeParameters  # in the fit, those of the reference's mounting follow them
    data: BundleData  # the scans that count
    problem: BundleProblem
    fit: Fit
    uncertain: int  # uncertain parameters of the calibration, fitted or not


def solve_bundle(recording: Recording, calibration: Calibration, options: BundleOptions) -> SolvedBundle:
    """Fit parameters together; raises as ``Procedure.identify``."""
    if calibration.tilt_angle is not TiltAngle.THIS_SCAN:
        raise FitError(
            "its tilts turn by theta of the previous scan (tilt_angle previous_scan), but bundle and check use each "
            "scan by itself; use zero_drift or target_plane",
            where=f"calibration '{calibration.name}'",
            expected="tilt_angle this_scan",
        )
    recording = recording.without_status(PROBES_ESTIMATED | DIODES_ESTIMATED | SATURATED)
    applied = calibration.for_session(options.session)
    excluded = _find_unmeasured(recording.scans)
    free = FreeParameters(calibration, options.session, options.parameters, excluded)
    data = make_bundle_data(recording, applied, options)
    stack = Stack([sensor.build() for sensor in applied.sensors])
    problem, data, found = _fit(stack, free, data, options.loss, recording.source)
    every = FreeParameters(calibration, options.session, excluded=excluded)
    found = add_unfitted_uncertainty(found, problem, every, stack, data)
    return SolvedBundle(stack, free, data, problem, found, len(every))


def _fit(
    stack: Stack, free: FreeParameters, data: BundleData, loss: Loss, source: str
) -> tuple[BundleProblem, BundleData, Fit]:
    """Fit; a scan that leaves the calibrated range as the parameters change is left out, and the fit begins again."""
    count = len(data)
    check_count(count, MIN_POSES, "poses", source)
    while True:
        problem = BundleProblem(stack, free, data)
        try:
            found = problem.fit(loss=loss, what=NAME)
        except OutOfRangeError as error:
            data = data.select(np.flatnonzero(~error.which))
            if len(data) < (1.0 - MOST_OUT_OF_RANGE) * count:
                raise FitError(
                    f"{count - len(data)} of {count} poses leave the calibrated range as the parameters change",
                    where=source,
                    expected=f"at most {100 * MOST_OUT_OF_RANGE:g} %",
                ) from None
        else:
            return problem, data, found


def _find_unmeasured(scans: Scans) -> tuple[str, ...]:
    """Return the keys of parameters whose input no scan holds: a missing input counts as its reference value."""
    inputs = {"*.supply.*": scans.supply_voltages, "*.temperature.*": scans.temperatures}
    return tuple(pattern for pattern, levels in inputs.items() if not np.isfinite(levels).any())


def fit_bundle(recording: Recording, calibration: Calibration, options: BundleOptions) -> Outcome:
    """Fit parameters together and report what the data leave open; raises as ``Procedure.identify``."""
    _check_unused(recording, calibration)
    solved = solve_bundle(recording, calibration, options)
    stack, free, data, problem, found = solved.stack, solved.free, solved.data, solved.problem, solved.fit
    has_reference = data.reference is not None
    if data.reference is None or data.reference.sigmas.any():
        names = [f"{name} of scan {number}" for number in data.scans.numbers for name in stack.reading_names]
        check_spread(found, names if has_reference else [], f"{NAME}, {recording.source}")
    count = len(free)
    replacements, joint = free.file_changes(found.values[:count], found.covariance[:count, :count])
    weak, unseen = _find_weak(np.sqrt(found.weights)[:, None] * found.jacobian * problem.scales, problem.names)
    advice = propose_poses(weak, stack, free, found.values, data, np.random.default_rng(options.seed))
    mounting = f", {len(problem.names) - count} of the reference's mounting" if len(problem.names) > count else ""
    poses = "poses by a reference with its uncertainty" if has_reference else "poses unknown, eliminated scan by scan"
    return Outcome(
        method=f"joint fit of {count} parameters{mounting} to {len(data)} poses through the measurement model; "
        f"{poses}; the former uncertainties as priors; loss {options.loss}",
        fits={NAME: found},
        replacements=tuple(replacements),
        covariances=(joint,) if options.covariance else (),
        tables=(
            parameter_table("parameters", found, problem.start, len(problem.names)),
            _tabulate_remaining(found, problem),
            *((_tabulate_weak(weak),) if weak else ()),
            *((advice,) if advice.rows else ()),
        ),
        warnings=tuple(_describe(solved, stack.reading_names, unseen)),
    )


def _check_unused(recording: Recording, calibration: Calibration) -> None:
    """Refuse a recording that the prior uncertainties contain: its readings would count twice."""
    for record in calibration.fits:
        if recording.sha256 and record.recording.sha256 == recording.sha256:
            raise FitError(
                f"calibration '{calibration.name}' is already fitted to it, by {record.procedure}",
                where=f"{NAME}, {recording.source}",
                expected="the calibration from before that fit, or another recording: no reading counts twice",
            )


def _find_weak(scaled_jacobian: FloatArray, names: Sequence[str]) -> tuple[tuple[WeakDirection, ...], tuple[str, ...]]:
    """Return the combinations that the data determine weakly, and the parameters that no reading depends on.

    ``scaled_jacobian``: d(normalised residual)/d(parameter over its prior standard uncertainty), (n, q).
    """
    sizes = np.linalg.norm(scaled_jacobian, axis=0)
    seen = sizes > UNDETERMINED * np.max(sizes)
    which = np.flatnonzero(seen).tolist()
    directions = []
    for direction in weak_directions(scaled_jacobian[:, seen], [names[i] for i in which]):
        shares = np.zeros(len(names))
        shares[which] = direction.shares
        directions.append(replace(direction, shares=shares))
    return tuple(directions), tuple(names[i] for i in np.flatnonzero(~seen).tolist())


def _tabulate_remaining(found: Fit, problem: BundleProblem) -> Table:
    sigmas, scales = found.sigmas, problem.scales
    changes = (found.values - problem.start) / scales
    rows = tuple(
        (*table_row(name, (scales[i], sigmas[i])), problem.units[i], float(sigmas[i] / scales[i]), float(changes[i]))
        for i, name in enumerate(problem.names)
    )
    columns = ("parameter", "prior sigma", "sigma now", "unit", "remaining", "change / prior sigma")
    return Table("information from the data", columns, ("",) * len(columns), rows)


def _tabulate_weak(weak: tuple[WeakDirection, ...]) -> Table:
    rows = tuple((" and ".join(d.names), d.remaining_with_prior()) for d in weak[:SHOWN_DIRECTIONS])
    columns = ("parameters", "remaining")
    return Table("weakly determined combinations", columns, ("", "of the prior uncertainty"), rows)


def _describe(solved: SolvedBundle, readings: tuple[str, ...], unseen: tuple[str, ...]) -> list[str]:
    found, problem, data = solved.fit, solved.problem, solved.data
    sentences = []
    unfitted = solved.uncertain - len(solved.free)
    if unfitted:
        sentences.append(
            f"{unfitted} uncertain parameters were not fitted: the uncertainty of the result includes theirs, the "
            "residuals show their errors."
        )
    if data.reference is not None and not data.reference.sigmas.any():
        sentences.append("The reference is taken as exact, since no uncertainty was given for it.")
    sentences += data.warnings
    if data.left_out:
        sentences.append(
            f"{data.left_out} scans are not used: no pose, no reference or one that a nearer "
            "scan uses, out of range, or thinned out."
        )
    changes = np.abs(found.values - problem.start) / problem.scales
    if np.any(changes > LARGE_CHANGE):
        worst = int(np.argmax(changes))
        sentences.append(
            f"{np.count_nonzero(changes > LARGE_CHANGE)} parameters changed by more than {LARGE_CHANGE:g} of their "
            f"prior standard uncertainties, {problem.names[worst]} by {changes[worst]:.1f}."
        )
    outliers = np.flatnonzero(found.outliers())
    if outliers.size:
        worst = int(outliers[np.argmax(np.abs(found.residuals[outliers]))])
        scan, row = divmod(worst, problem.per_scan)
        name = f", {readings[row]}" if data.reference is not None else ""
        sentences.append(
            f"{outliers.size} of {len(found.residuals)} residuals are outliers, the worst of scan "
            f"{data.scans.numbers[scan]}{name}, {abs(found.residuals[worst]):.1f} sigmas."
        )
    sentences += describe_spread(found)
    if unseen:
        sentences.append(f"No reading depends on {', '.join(unseen)}: left as before.")
    return sentences


PROCEDURE = Procedure(
    NAME,
    "fit any parameters of a POSOR together, from many poses, with or without a pose reference",
    BundleOptions,
    fit_bundle,
    drift_of=(),
)
