"""Whether a calibration still explains a recording, and if not, which of its parameters have drifted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2, norm

from posor_estimator.core.calibrate.bundle import BundleOptions, solve
from posor_estimator.core.calibrate.procedure import Table
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration

FALSE_ALARM = 1e-3
"""Probability that a calibration that holds is said not to; for each of the two tests."""
TOLD = 1e-3
"""A parameter of which the recording tells less than this part of its variance says nothing of a drift."""


@dataclass(frozen=True)
class Explained:
    """How well a calibration explains a recording.

    Attributes:
        explains: Whether it does.
        chi_square: Of the residuals, both the readings' noise and the calibration's uncertainties allowed for.
        freedoms: Of it.
        probability: Of one at least as large if the calibration holds.
        noise_ratio: Root of chi-square over the freedoms where nothing but the readings' noise is allowed for: what the
            calibration's uncertainty, and drift within it, do to the readings.
        drifts: Drift of each parameter in sigmas, by name: its change in a fit that begins from the calibration, over
            the standard deviation that this change has if the calibration holds.
        limit: Largest drift that passes.
        table: Of the drifts, the largest first.
        verdict: In one sentence.

    """

    explains: bool
    chi_square: float
    freedoms: int
    probability: float
    noise_ratio: float
    drifts: dict[str, float]
    limit: float
    table: Table
    verdict: str


def explained(recording: Recording, calibration: Calibration, options: BundleOptions) -> Explained:
    """Return how well a calibration explains a recording.

    All of its parameters may change within their uncertainties, which makes the chi-square that of residuals whose
    covariance is the sum of noise and calibration. A parameter found with the former uncertainty s0 and the present one
    s1 has changed by a quantity of the variance s0^2 - s1^2 if the calibration holds.

    Args:
        recording: With a pose reference, or without: then only the redundancy of the readings tells.
        calibration: The calibration.
        options: Those of the bundle fit; the loss is that of a chi-square, whatever they say.

    Raises:
        FitError: The recording does not serve.
        TrackError: The reference does not serve.
        CalibrationError: There is no such session.

    """
    solved = solve(recording, calibration, options.model_copy(update={"loss": "linear"}))
    problem, fit = solved.problem, solved.fit
    chi_square = fit.spread**2 * fit.freedoms
    at_start = problem.residuals(problem.start)
    before, now = np.square(problem.scales), np.diag(fit.covariance)
    told = 1.0 - now / before > TOLD
    if not told.any():
        raise FitError(
            "it tells nothing of the parameters that the calibration is unsure of",
            where=recording.source,
            expected="more poses, or a pose reference",
        )
    change = fit.values - problem.start
    rows = []
    drifts = {}
    for i in np.flatnonzero(told):
        drifts[problem.names[i]] = float(change[i] / np.sqrt(before[i] - now[i]))
        rows.append(
            (
                problem.names[i],
                float(change[i]),
                problem.units[i],
                float(np.sqrt(before[i])),
                float(np.sqrt(now[i])),
                drifts[problem.names[i]],
            )
        )
    rows.sort(key=lambda row: -abs(float(row[-1])))
    limit = float(norm.isf(0.5 * FALSE_ALARM / len(rows)))
    probability = float(chi2.sf(chi_square, fit.freedoms))
    far = [name for name, drift in drifts.items() if abs(drift) > limit]
    columns = ("parameter", "change", "unit", "sigma stated", "sigma here", "drift / sigma")
    return Explained(
        explains=probability >= FALSE_ALARM and not far,
        chi_square=float(chi_square),
        freedoms=fit.freedoms,
        probability=probability,
        noise_ratio=float(np.sqrt(np.mean(np.square(at_start)))),
        drifts=drifts,
        limit=limit,
        table=Table("drift of the parameters, the largest first", columns, ("",) * len(columns), tuple(rows)),
        verdict=_verdict(calibration.name, recording.source, probability, far, float(chi_square), fit.freedoms),
    )


def _verdict(name: str, source: str, probability: float, far: list[str], chi_square: float, freedoms: int) -> str:
    figures = f"chi-square {chi_square:.4g} for {freedoms} degrees of freedom, probability {probability:.2g}"
    if probability >= FALSE_ALARM and not far:
        return f"The calibration '{name}' explains {source}: {figures}, no parameter has drifted."
    reasons = []
    if probability < FALSE_ALARM:
        reasons.append("the residuals are larger than noise and stated uncertainties allow")
    if far:
        reasons.append(f"{', '.join(far)} drifted")
    return f"The calibration '{name}' does not explain {source}: {figures}; {'; '.join(reasons)}."
