"""Fit any parameters of a POSOR together, through its measurement model, to the scans of many poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.bundle_data import BundleData, Joining, bundle_data
from posor_estimator.core.calibrate.bundle_problem import BundleProblem, OutOfRangeError
from posor_estimator.core.calibrate.checks import check_enough, check_spread
from posor_estimator.core.calibrate.directions import BLIND, Direction, weak_directions
from posor_estimator.core.calibrate.fit import Fit, Loss, fit
from posor_estimator.core.calibrate.identify import telling_poses
from posor_estimator.core.calibrate.procedure import Options, Outcome, Procedure, Table
from posor_estimator.core.calibrate.recording import DIODES_ESTIMATED, PROBES_ESTIMATED, SATURATED
from posor_estimator.core.calibrate.recording import POSE as POSE_TRACK
from posor_estimator.core.calibrate.reporting import parameter_table
from posor_estimator.core.calibrate.unfitted import with_unfitted
from posor_estimator.core.calibrate.unknowns import Unknowns
from posor_estimator.core.calibration.model import Calibration, TiltAngle
from posor_estimator.core.stack import Stack
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import FloatArray

NAME = "bundle"
LEAST = 8
"""Poses below which a fit of everything is refused."""
FAR = 4.0
"""A parameter found so many of its former standard uncertainties away is named."""
IMPROBABLE = 1e-3
WORST = 12
"""So many of the badly told combinations are shown."""
MOST_OUT = 0.1
"""Share of scans that may leave the calibrated range as the parameters move."""

Seconds = Annotated[float, Field(ge=0.0)]


class BundleOptions(Options):
    """Options of the bundle fit."""

    parameters: tuple[str, ...] = Field(
        default=("*",),
        min_length=1,
        description="keys of what may change, such as sensors[0].probes[*].tip; * for anything",
    )
    session: str = Field(
        default="", description="session of the calibration file that holds in the recording; empty: none"
    )
    reference: str = Field(
        default="", description="topic of the pose reference; empty: the only one, or none if there is none"
    )
    mounting_m: float = Field(
        default=0.0,
        ge=0.0,
        description="how well the places of the reference's frames on the plates are known [m]; 0: exactly",
    )
    mounting_rad: float = Field(default=0.0, ge=0.0, description="the same for their orientations [rad]")
    loss: Loss = Field(default="huber", description="of the fit; linear where no outliers are to be survived")
    least_stop: Seconds = Field(
        default=0.0, description="use stops of the reference at least this long [s]; 0: every scan"
    )
    still: float = Field(default=2e-6, gt=0.0, description="largest deviation of the reference within a stop [m]")
    settle: Seconds = Field(default=0.0, description="left out at the beginning of each stop [s]")
    longest_gap: float = Field(default=0.5, gt=0.0, description="references further apart are not joined by a line [s]")
    at_most: int = Field(default=500, ge=LEAST, description="poses beyond this number are thinned out evenly")
    covariance: bool = Field(default=True, description="write the whole covariance into the file")
    seed: int = Field(
        default=1985, ge=0, description="of the poses that are proposed where the data leave something open"
    )


@dataclass(frozen=True)
class Solved:
    """A bundle fit: what was fitted to what, and what came out.

    Attributes:
        stack: The sensors as they were before.
        unknowns: The parameters; those of the mounting follow them in the fit.
        data: The scans that count.
        problem: Residuals and derivatives.
        fit: The result.
        uncertain: How many parameters of the calibration are uncertain, fitted or not.

    """

    stack: Stack
    unknowns: Unknowns
    data: BundleData
    problem: BundleProblem
    fit: Fit
    uncertain: int


def solve(recording: Recording, calibration: Calibration, options: BundleOptions) -> Solved:
    """Fit parameters together; see ``BundleOptions``.

    Raises:
        FitError: The data do not serve.
        TrackError: The reference does not serve.
        CalibrationError: There is no such session.

    """
    if calibration.tilt_angle is not TiltAngle.THIS_SCAN:
        raise FitError(
            "its tilts turn by theta of the scan before (tilt_angle previous_scan), which bundle and check cannot "
            "follow, since they take each scan by itself; zero_drift and target_plane can",
            where=f"calibration '{calibration.name}'",
            expected="tilt_angle this_scan",
        )
    recording = recording.without(PROBES_ESTIMATED | DIODES_ESTIMATED | SATURATED)
    applied = calibration.for_session(options.session)
    held = _not_measured(recording.scans)
    unknowns = Unknowns(calibration, options.session, options.parameters, held)
    mounting = np.tile([options.mounting_m] * 3 + [options.mounting_rad] * 3, 2)
    how = Joining(options.least_stop, options.still, options.settle, options.longest_gap, options.at_most, mounting)
    has_poses = any(track.values.shape[1] == POSE_TRACK for track in recording.tracks.values())
    topic = options.reference if options.reference or has_poses else None
    data = bundle_data(recording, applied, topic, how)
    stack = Stack([sensor.build() for sensor in applied.sensors])
    problem, data, found = _fitted(stack, unknowns, data, options.loss, recording.source)
    every = Unknowns(calibration, options.session, held=held)
    return Solved(stack, unknowns, data, problem, with_unfitted(found, problem, every, stack, data), len(every))


def fit_bundle(recording: Recording, calibration: Calibration, options: BundleOptions) -> Outcome:
    """Fit parameters together and say what they are, and what the data leave open; raises what ``solve`` raises."""
    solved = solve(recording, calibration, options)
    stack, unknowns, data, problem, found = solved.stack, solved.unknowns, solved.data, solved.problem, solved.fit
    if data.reference is None or data.reference.sigmas.any():
        check_spread(found, _reading_names(data, stack), f"{NAME}, {recording.source}")
    own = len(unknowns)
    replacements, joint = unknowns.result(found.values[:own], found.covariance[:own, :own])
    scaled = np.sqrt(found.weights)[:, None] * found.jacobian * problem.scales
    weak, unseen = _untold(scaled, problem.names)
    advice = telling_poses(weak, stack, unknowns, found.values, data, np.random.default_rng(options.seed))
    return Outcome(
        method=_method(data, problem, own, options),
        fits={NAME: found},
        replacements=tuple(replacements),
        covariances=(joint,) if options.covariance else (),
        tables=(
            parameter_table("parameters", found, problem.start, len(problem.names)),
            _told(found, problem),
            *((_weak_table(weak),) if weak else ()),
            *((advice,) if advice.rows else ()),
        ),
        warnings=(
            *_unfitted_sentence(solved.uncertain - own),
            *_warnings(found, problem, data, stack.reading_names),
            *_unseen_sentence(unseen),
        ),
    )


def _fitted(
    stack: Stack, unknowns: Unknowns, data: BundleData, loss: Loss, source: str
) -> tuple[BundleProblem, BundleData, Fit]:
    """Fit; a scan that leaves the calibrated range as the parameters move is left out, and the fit begins again."""
    count = len(data)
    check_enough(count, LEAST, "poses", source)
    while True:
        problem = BundleProblem(stack, unknowns, data.scans, data.counts, data.poses, data.reference)
        try:
            found = fit(
                problem.residuals,
                problem.start,
                problem.names,
                problem.units,
                problem.scales,
                jacobian=problem.jacobian,
                prior=problem.prior,
                loss=loss,
                what=NAME,
            )
        except OutOfRangeError as error:
            data = data.chosen(np.flatnonzero(~error.which))
            if len(data) < (1.0 - MOST_OUT) * count:
                raise FitError(
                    f"{count - len(data)} of {count} poses leave the calibrated range as the parameters move",
                    where=source,
                    expected=f"at most {100 * MOST_OUT:g} %",
                ) from None
        else:
            return problem, data, found


def _not_measured(scans: Scans) -> tuple[str, ...]:
    """Return the keys of what cannot be told since no scan says what it depends on: a NaN counts as the reference."""
    measured = {"*.supply.*": scans.supply_voltages, "*.temperature.*": scans.temperatures}
    return tuple(pattern for pattern, levels in measured.items() if not np.isfinite(levels).any())


def _untold(scaled: FloatArray, names: Sequence[str]) -> tuple[tuple[Direction, ...], tuple[str, ...]]:
    """Return the combinations that the data tell badly, and the parameters that no reading depends on.

    Args:
        scaled: d(normalised residual)/d(parameter over what was known of it before), (n, q).
        names: Of the parameters.

    """
    sizes = np.linalg.norm(scaled, axis=0)
    seen = sizes > BLIND * np.max(sizes)
    which = [int(i) for i in np.flatnonzero(seen)]
    found = weak_directions(scaled[:, seen], [names[i] for i in which])
    whole = []
    for direction in found:
        shares = np.zeros(len(names))
        shares[which] = direction.shares
        whole.append(Direction(shares, direction.remaining, direction.names))
    return tuple(whole), tuple(name for name, told in zip(names, seen, strict=True) if not told)


def _unfitted_sentence(count: int) -> tuple[str, ...]:
    if not count:
        return ()
    said = f"{count} parameters that are uncertain were not fitted: their uncertainty is in the result's"
    return (f"{said}, and what they are off by is in the residuals.",)


def _unseen_sentence(unseen: tuple[str, ...]) -> tuple[str, ...]:
    if not unseen:
        return ()
    return (f"No reading depends on {', '.join(unseen)}: left as known before.",)


def _method(data: BundleData, problem: BundleProblem, own: int, options: BundleOptions) -> str:
    how = "poses by a reference with its uncertainty" if data.reference else "poses unknown, eliminated scan by scan"
    extra = f", {len(problem.names) - own} of the reference's mounting" if len(problem.names) > own else ""
    return (
        f"joint fit of {own} parameters{extra} to {len(data)} poses through the measurement model; {how}; "
        f"the former uncertainties as priors; loss {options.loss}"
    )


def _told(found: Fit, problem: BundleProblem) -> Table:
    """Return how much of the former uncertainty of each parameter remains."""
    rows = tuple(
        (name, float(scale), float(sigma), unit, float(sigma / scale), float((value - start) / scale))
        for name, scale, sigma, unit, value, start in zip(
            problem.names, problem.scales, found.sigmas, problem.units, found.values, problem.start, strict=True
        )
    )
    columns = ("parameter", "sigma before", "sigma now", "unit", "remaining", "change / sigma before")
    return Table("what the data told", columns, ("",) * len(columns), rows)


def _weak_table(weak: tuple[Direction, ...]) -> Table:
    rows = tuple((" and ".join(d.names), d.left()) for d in weak[:WORST])
    columns = ("parameters", "remaining")
    return Table("combinations that the data tell badly", columns, ("", "of the uncertainty before"), rows)


def _reading_names(data: BundleData, stack: Stack) -> list[str]:
    """Return what to call each residual; nothing where they are of combinations of readings."""
    if data.reference is None:
        return []
    return [f"{name} of scan {number}" for number in data.scans.numbers for name in stack.reading_names]


def _warnings(found: Fit, problem: BundleProblem, data: BundleData, readings: tuple[str, ...]) -> tuple[str, ...]:
    said = []
    if data.reference is not None and not data.reference.sigmas.any():
        said.append("The reference is taken as exact, since no uncertainty was given for it.")
    said += data.warnings
    if data.left_out:
        said.append(f"{data.left_out} scans count for nothing: no pose, no reference, out of range, or thinned out.")
    far = np.abs(found.values - problem.start) / problem.scales
    if np.any(far > FAR):
        worst = int(np.argmax(far))
        said.append(
            f"{np.count_nonzero(far > FAR)} parameters moved by more than {FAR:g} of their former standard "
            f"uncertainties, {problem.names[worst]} by {far[worst]:.1f}."
        )
    outliers = np.flatnonzero(found.outliers())
    if outliers.size:
        worst = int(outliers[np.argmax(np.abs(found.residuals[outliers]))])
        scan, row = divmod(worst, problem.per_scan)
        name = f", {readings[row]}" if data.reference is not None else ""
        said.append(
            f"{outliers.size} of {len(found.residuals)} residuals are outliers, the worst of scan "
            f"{data.scans.numbers[scan]}{name}, {abs(found.residuals[worst]):.1f} sigmas."
        )
    if found.probability < IMPROBABLE:
        said.append(
            f"The residuals are {found.spread:.2f} times as large as the stated uncertainties let expect: these are "
            "too small, or the model lacks something."
        )
    return tuple(said)


PROCEDURE = Procedure(
    NAME,
    "fit any parameters of a POSOR together, from many poses, with or without a pose reference",
    BundleOptions,
    fit_bundle,
)
