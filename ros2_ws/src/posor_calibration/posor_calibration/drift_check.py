# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Check whether a calibration still explains a recording, and which of its parameters have drifted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import FitError
from scipy.special import ndtri

from posor_calibration.fit_report import table_row
from posor_calibration.procedure import Table
from posor_calibration.procedures.bundle import BundleOptions, solve_bundle

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration

FALSE_ALARM = 1e-3  # probability that a valid calibration fails, for each of the two tests
LEAST_INFORMATION = 1e-3  # share of a parameter's variance that the recording must remove for its drift to be tested
LARGEST_SIGMA = 3.0
"""Standard uncertainty of a parameter from the recording alone, in stated ones, beyond which it is below the noise.

The recording shows only drifts many times larger than the stated uncertainty.
"""


@dataclass(frozen=True)
class DriftCheck:
    """Result of a check."""

    explains: bool
    chi_square: float  # of the residuals, with the readings' noise and the calibration's uncertainties
    freedoms: int
    probability: float  # of a chi-square at least as large if the calibration holds
    noise_ratio: float  # root of chi-square over the freedoms with the readings' noise only
    drifts: dict[str, float]
    """By parameter: its change in a fit that begins from the calibration, over the standard deviation of this change if
    the calibration holds."""
    limit: float  # largest drift that passes
    below_noise: int  # parameters of which only large drifts would show, see ``LARGEST_SIGMA``
    table: Table  # of the drifts, the largest first
    verdict: str  # one sentence


def check_drift(recording: Recording, calibration: Calibration, options: BundleOptions) -> DriftCheck:
    """Check whether a calibration explains a recording.

    All parameters may change within their uncertainties, so chi-square allows for noise and calibration together. If
    the calibration holds, a parameter with the prior standard uncertainty s0 and the fitted one s1 changes by a
    quantity of variance s0^2 - s1^2. Without a pose reference only the redundancy of the readings is tested. The loss
    is always linear. Raises as ``Procedure.identify``, and FitError where the recording shows no contradiction and is
    below the noise.
    """
    solved = solve_bundle(recording, calibration, options.model_copy(update={"loss": "linear"}))
    problem, fit = solved.problem, solved.fit
    before, after = np.square(problem.scales), np.diag(fit.covariance)
    information = np.maximum(1.0 - after / before, np.finfo(float).eps)  # below 0 by parameters that are not fitted
    sigmas_here = np.sqrt((1.0 - information) / information)  # of the recording alone, in stated ones
    tested = np.flatnonzero(information > LEAST_INFORMATION)
    change = fit.values - problem.start
    drifts = {problem.names[i]: float(change[i] / np.sqrt(before[i] - after[i])) for i in tested}
    rows = [
        (
            *table_row(problem.names[i], (change[i],)),
            problem.units[i],
            *map(float, np.sqrt([before[i], after[i]])),
            drifts[problem.names[i]],
        )
        for i in tested
    ]
    rows.sort(key=lambda row: -abs(float(row[-1])))
    limit = float(-ndtri(0.5 * FALSE_ALARM / max(len(rows), 1)))
    drifted = [name for name, drift in drifts.items() if abs(drift) > limit]
    reasons = []
    if fit.probability < FALSE_ALARM:
        reasons.append("the residuals are larger than noise and stated uncertainties allow")
    if drifted:
        reasons.append(f"{', '.join(drifted)} drifted")
    best = int(np.argmin(sigmas_here))
    if not reasons and sigmas_here[best] > LARGEST_SIGMA:
        raise FitError(
            f"the comparison is below the noise: not even {problem.names[best]}, the parameter that the recording "
            f"determines best, is seen to {LARGEST_SIGMA:g} times its stated uncertainty",
            where=recording.source,
            expected="more poses, or a pose reference that is more accurate",
        )
    chi_square = float(fit.spread**2 * fit.freedoms)
    figures = f"chi-square {chi_square:.4g} for {fit.freedoms} degrees of freedom, probability {fit.probability:.2g}"
    explains = "does not explain" if reasons else "explains"
    ending = f"; {'; '.join(reasons)}" if reasons else ", no parameter has drifted"
    columns = ("parameter", "change", "unit", "stated sigma", "sigma here", "drift / sigma")
    return DriftCheck(
        explains=not reasons,
        chi_square=chi_square,
        freedoms=fit.freedoms,
        probability=fit.probability,
        noise_ratio=float(np.sqrt(np.mean(np.square(problem.residuals(problem.start))))),
        drifts=drifts,
        limit=limit,
        below_noise=int(np.count_nonzero(sigmas_here > LARGEST_SIGMA)),
        table=Table("drift of the parameters, the largest first", columns, ("",) * len(columns), tuple(rows)),
        verdict=f"The calibration '{calibration.name}' {explains} {recording.source}: {figures}{ending}.",
    )
