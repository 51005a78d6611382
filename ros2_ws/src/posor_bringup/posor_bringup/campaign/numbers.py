"""Tells calibration campaigns in numbers, for other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from posor_bringup.campaign.determined import determined
from posor_bringup.campaign.fresh import FREEDOMS
from posor_bringup.campaign.told import holds

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_bringup.campaign.many import Coverage, Family
    from posor_bringup.campaign.told import Told

ROOTS: Mapping[str, str] = {
    "errors": "errors",
    "budget": "sigmas",
    "errors_as_built": "before",
    "errors_without_noise": "still_errors",
    "budget_of_calibration": "still_sigmas",
}
"""By what they are called in the figures for other programs: attributes of ``Fresh`` and ``Coverage``."""


def as_json(all_told: Sequence[Told]) -> dict[str, Any]:
    """Return everything by name, in SI units."""
    return {told.plant.name: _posor_json(told) for told in all_told} | {"holds": holds(all_told)}


def _posor_json(told: Told) -> dict[str, Any]:
    fresh = told.fresh
    steps = determined(told.plant.known, [bag.calibration for bag in told.bagged])
    rms = {
        called: dict(zip(FREEDOMS, np.sqrt(np.nanmean(np.square(getattr(fresh, what)), axis=0)).tolist(), strict=True))
        for called, what in ROOTS.items()
    }
    return {
        "seed": told.plant.seed,
        "content_hash": told.calibration.content_hash,
        "parameters": {
            number.name: {
                "family": number.family,
                "unit": number.unit,
                "truth": number.truth,
                "estimate": number.estimate,
                "sigma": number.sigma,
                "within_95": number.inside,
                "measured_by": told.bagged[steps[number.name]].step.name if number.name in steps else None,
            }
            for number in told.numbers
        },
        "steps": {
            bag.step.name: {
                "procedure": record.procedure,
                "method": record.method,
                "instruments": {one.name: one.sigmas for one in record.instruments},
                "bag": record.recording.name,
                "sha256": record.recording.sha256,
                "date": record.date,
            }
            for bag, record in zip(told.bagged, told.calibration.fits, strict=True)
        },
        "fresh_poses": {
            "count": int(fresh.known.sum()),
            "root_mean_square": rms,
            "normalised_error_squared": float(np.mean(fresh.normalised[fresh.known])),
        },
        "campaigns": None if told.coverage is None else _coverage_json(told.coverage),
    }


def _coverage_json(coverage: Coverage) -> dict[str, Any]:
    def families(of: Sequence[Family]) -> dict[str, Any]:
        return {
            one.name: {
                "numbers": one.numbers,
                "within_95": one.inside.value,
                "sigma": one.inside.sigma,
                "interval_95": list(one.interval),
                "worst": {"name": one.worst[0], "within_95": one.worst[1]},
            }
            for one in of
        }

    return {
        "count": coverage.campaigns,
        "refused": list(coverage.refused),
        "within_95": {"value": coverage.pooled.value, "sigma": coverage.pooled.sigma},
        "binomial_band_of_one_number": list(coverage.band),
        "numbers_at_95_plus_minus_3": {
            "found": coverage.within_claim[0],
            "expected": coverage.within_claim[1],
            "of": len(coverage.by_number),
        },
        "least_probable_bonferroni": coverage.least_probable,
        "by_number": coverage.by_number,
        "families": families(coverage.families),
        "procedures": families(coverage.claims),
        "fresh_within_95_region": {"value": coverage.fresh_inside.value, "sigma": coverage.fresh_inside.sigma},
        "fresh_normalised_error_squared": {
            "value": coverage.fresh_normalised.value,
            "sigma": coverage.fresh_normalised.sigma,
        },
        "fresh_without_noise_within_95": {"value": coverage.still_inside.value, "sigma": coverage.still_inside.sigma},
        "fresh_root_mean_square": {
            called: dict(zip(FREEDOMS, getattr(coverage, what), strict=True)) for called, what in ROOTS.items()
        },
    }
