from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor_estimator.core.calibrate.supply_sensitivity import SupplySensitivityOptions, run
from posor_estimator.core.calibration.quantity import Quantity
from posor_estimator.core.designs import STANDOFF
from posor_estimator.errors import FitError
from posor_estimator.testing.campaign import held, posor, recording
from scipy.stats import binomtest

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.procedure import Outcome
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.types import FloatArray

LEVELS = np.linspace(14.5, 15.5, 11)
TRUE = 2e-5
"""Of the design [m/V]."""


def taken(seed: int, levels: FloatArray = LEVELS, scans_each: int = 20) -> Recording:
    supplies = held(levels[:, None], scans_each)[:, 0]
    count = len(supplies)
    rotations = np.tile(np.eye(3), (count, 1, 1))
    translations = np.tile([0.0, 0.0, STANDOFF], (count, 1))
    rng = np.random.default_rng(seed)
    return recording(posor(), rotations, translations, np.zeros((count, 1)), rng, supply_voltages=supplies)


def found(taken: Recording, **options: Any) -> Outcome:
    return run(taken, posor(), SupplySensitivityOptions(**options))


def test_truth_lies_in_the_95_percent_intervals_of_95_percent_of_campaigns() -> None:
    inside = 0
    for seed in range(40):
        for fit in found(taken(seed)).fits.values():
            inside += abs(fit.value("sensitivity") - TRUE) < 1.96 * fit.sigma("sensitivity")
    assert binomtest(inside, 120, 0.95).pvalue > 0.01


def test_result_is_a_part_of_the_file_that_keeps_the_reference() -> None:
    outcome = found(taken(0))
    part = outcome.parts[1]
    assert part.key == "sensors[0].probes[1].supply"
    assert abs(part.content["sensitivity"]["value"] - TRUE) < 4.0 * part.content["sensitivity"]["sigma"]
    assert part.content["reference"] == {"value": 15.0, "sigma": 0.01, "unit": "V"}
    named = found(taken(0), reference=14.8, reference_sigma=0.02).parts[1].content["reference"]
    assert named == {"value": 14.8, "sigma": 0.02, "unit": "V"}


def test_probe_without_a_supply_so_far_is_linearised_at_the_mean_of_the_levels() -> None:
    sensor: Any = posor().sensors[0]
    probes = [probe.model_copy(update={"supply": None}) for probe in sensor.probes]
    others = [sensor.model_copy(update={"probes": probes}), *posor().sensors[1:]]
    calibration = posor().model_copy(update={"sensors": others})
    outcome = run(taken(0), calibration, SupplySensitivityOptions())
    assert outcome.parts[0].content["reference"]["value"] == pytest.approx(15.0)


def test_supply_that_was_not_measured_or_not_varied_is_refused() -> None:
    before = taken(0)
    unknown = before.scans.with_fields({"supply_voltages": np.full(len(before.scans), np.nan)})
    with pytest.raises(FitError, match=r"^simulated: the supply voltage was not measured; expected scans that hold it"):
        found(replace(before, scans=unknown))
    with pytest.raises(FitError, match=r"^simulated: 3 levels of the supply voltage; expected at least 4\.$"):
        found(taken(0, LEVELS[::5]))
    with pytest.raises(FitError, match=r"^simulated: the supply voltage spans 0.1\d* V; expected at least 0.2 V\.$"):
        found(taken(0, 15.0 + np.tile([0.0, 0.11], 4)))


def test_target_that_moves_meanwhile_enlarges_the_uncertainty_and_is_told() -> None:
    before = taken(0)
    rng = np.random.default_rng(1)
    moving = np.repeat(rng.normal(size=len(LEVELS)), 25)[: len(before.scans)] * 0.05
    volts = before.scans.gap_voltages + moving[:, None]
    outcome = found(replace(before, scans=before.scans.with_fields({"gap_voltages": volts})))
    assert "gap probe gap_1: the residuals are" in outcome.warnings[0]
    fit = outcome.fits["gap probe gap_1"]
    assert fit.sigma("sensitivity") > 20.0 * found(before).fits["gap probe gap_1"].sigma("sensitivity")


def test_level_at_which_the_target_was_touched_is_named_and_survived() -> None:
    before = taken(0)
    volts = before.scans.gap_voltages.copy()
    volts[25 * 4 : 25 * 4 + 20] += 0.1
    outcome = found(replace(before, scans=before.scans.with_fields({"gap_voltages": volts})), loss="cauchy")
    assert any("left out level 5, which do not fit the others" in warning for warning in outcome.warnings)
    fit = outcome.fits["gap probe gap_2"]
    assert abs(fit.value("sensitivity") - TRUE) < 4.0 * fit.sigma("sensitivity")


def test_quantity_of_the_design_is_what_the_test_takes_for_true() -> None:
    sensor: Any = posor().sensors[0]
    assert sensor.probes[0].supply.sensitivity == Quantity(value=TRUE, sigma=2e-6, unit="m/V")
