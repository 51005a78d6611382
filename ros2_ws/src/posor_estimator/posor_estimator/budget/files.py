"""A budget as files: a CSV line for each contribution and judged quantity, and all of it as JSON."""

from __future__ import annotations

import csv
import json
from typing import TYPE_CHECKING, Any

from posor_estimator.core.budget.first_order import Kind
from posor_estimator.core.budget.outputs import NATIVE
from posor_estimator.core.native import native_from_rotation

if TYPE_CHECKING:
    from pathlib import Path

    from posor_estimator.budget.told import ToldBudget

CSV_COLUMNS = ("rank", "contribution", "kind", "quantity", "unit", "standard_uncertainty", "share_of_variance")


def write_csv(path: Path, told: ToldBudget) -> None:
    """Write the contributions, ranked, in SI units."""
    shares = told.budget.shares()
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(CSV_COLUMNS)
        for rank, (part, share) in enumerate(zip(told.budget.contributions, shares, strict=True), start=1):
            for i, output in enumerate(told.budget.outputs):
                sigma, of_total = (f"{float(value):.9g}" for value in (part.effects[i], share[i]))
                writer.writerow((rank, part.name, part.kind, output.name, output.unit, sigma, of_total))


def as_json(told: ToldBudget) -> dict[str, Any]:
    """Return everything by name, in SI units."""
    budget, drawn = told.budget, told.drawn
    native = [*budget.T_R_T.translation, *native_from_rotation(budget.T_R_T.rotation)]
    outputs = {}
    for i, (output, validation) in enumerate(zip(budget.outputs, told.validations, strict=True)):
        outputs[output.name] = {
            "unit": output.unit,
            "value": float(budget.values[i]),
            "random": float(budget.root_sum_square(Kind.RANDOM)[i]),
            "systematic": float(budget.root_sum_square(Kind.SYSTEMATIC)[i]),
            "root_sum_square": float(budget.root_sum_square()[i]),
            "full_covariance": float(budget.sigmas[i]),
            "monte_carlo": {
                "mean": float(drawn.means[i]),
                "standard_uncertainty": float(drawn.sigmas[i]),
                "interval_95": [float(drawn.low[i]), float(drawn.high[i])],
            },
            "validation": {
                "numerical_tolerance": validation.tolerance,
                "d_low": validation.low,
                "d_high": validation.high,
                "stable": validation.stable,
                "holds": validation.holds,
            },
        }
    return {
        "calibration": told.calibration,
        "content_hash": told.content_hash,
        "session": told.session,
        "pose": dict(zip((name for name, _ in NATIVE), map(float, native), strict=True)),
        "quantities": outputs,
        "covariance": budget.covariance.tolist(),
        "contributions": [
            {
                "rank": rank,
                "name": part.name,
                "kind": str(part.kind),
                "standard_uncertainty": {
                    output.name: float(effect) for output, effect in zip(budget.outputs, part.effects, strict=True)
                },
            }
            for rank, part in enumerate(budget.contributions, start=1)
        ],
        "taken_as_exact": list(budget.unstated),
        "vary_together": list(budget.together),
        "draws": {"seed": told.seed, "used": drawn.trials, "without_a_pose": drawn.lost},
    }


def write_json(path: Path, told: ToldBudget) -> None:
    """Write everything as JSON."""
    path.write_text(json.dumps(as_json(told), indent=2) + "\n", encoding="utf-8")
