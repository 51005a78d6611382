"""What parameters that are uncertain, but are not fitted, add to the uncertainty of those that are."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.calibrate.bundle_problem import BundleProblem
from posor_estimator.core.calibration.stated import root_of

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.bundle_data import BundleData
    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.calibrate.unknowns import Unknowns
    from posor_estimator.core.stack import Stack


def with_unfitted(fit: Fit, problem: BundleProblem, every: Unknowns, stack: Stack, data: BundleData) -> Fit:
    """Return a bundle fit whose covariance has the share of what was not fitted.

    The fit took the other parameters for exact. An error of one of them moves the result by the fit's gain times what
    it does to the residuals (JCGM 102, 6.2; "consider" parameters: Schmidt 1966). They are not found along with the
    rest and then dropped: with them as the file has them, it is these values that make the instrument read right.

    Args:
        fit: The fit of some of the unknowns.
        problem: What was fitted.
        every: All parameters of the calibration that are uncertain and that the recording depends on.
        stack: The sensors as they were before the fit.
        data: What was fitted to.

    """
    where = {name: index for index, name in enumerate(fit.names)}
    if all(name in where for name in every.names):
        return fit
    whole = BundleProblem(stack, every, data.scans, data.counts, data.poses, data.reference)
    at = whole.start.copy()
    for index, name in enumerate(whole.names):
        if name in where:
            at[index] = fit.values[where[name]]
    others = [index for index, name in enumerate(whole.names) if name not in where]
    ours = [whole.names.index(name) for name in fit.names]
    derivatives = np.sqrt(fit.weights)[:, None] * whole.jacobian(at)
    fitted, beside = derivatives[:, ours] * problem.scales, derivatives[:, others]
    known = np.linalg.inv(problem.prior / np.outer(problem.scales, problem.scales))
    gain = np.linalg.solve(fitted.T @ fitted + known, fitted.T @ beside @ root_of(whole.prior[np.ix_(others, others)]))
    pushed = problem.scales[:, None] * gain
    return replace(fit, covariance=fit.covariance + pushed @ pushed.T)
