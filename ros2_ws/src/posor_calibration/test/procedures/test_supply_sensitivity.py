"""Sensitivity to the supply voltage: simulated truth, the entry of the file, and supplies that do not serve."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor.calibration.quantity import Quantity
from posor.errors import FitError
from posor_calibration.procedures.supply_sensitivity import PROCEDURE
from posor_lab.harness.simulated_recordings import diode_calibration, dwell_path
from scipy.stats import binomtest

from .simulated_case import SimulatedCase

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

LEVELS = np.linspace(14.5, 15.5, 11)
TRUE = 2e-5
"""Of the design [m/V]."""


def simulate(seed: int = 0, levels: FloatArray = LEVELS, scans_each: int = 20) -> SimulatedCase:
    supplies = dwell_path(levels[:, None], scans_each)[:, 0]
    return SimulatedCase.at_rest(PROCEDURE, diode_calibration(), len(supplies), seed, supply_voltages=supplies)


@pytest.mark.long
def test_95_percent_intervals_cover_the_truth() -> None:
    inside = 0
    for seed in range(40):
        for fit in simulate(seed).identify().fits.values():
            inside += abs(fit.value("sensitivity") - TRUE) < 1.96 * fit.sigma("sensitivity")
    assert binomtest(inside, 120, 0.95).pvalue > 0.01


def test_the_entry_of_the_file_keeps_the_reference_supply() -> None:
    part = simulate().identify().parts[1]
    assert part.key == "sensors[0].probes[1].supply"
    assert abs(part.content["sensitivity"]["value"] - TRUE) < 4.0 * part.content["sensitivity"]["sigma"]
    assert part.content["reference"] == {"value": 15.0, "sigma": 0.01, "unit": "V"}
    named = simulate().identify(reference=14.8, reference_sigma=0.02).parts[1].content["reference"]
    assert named == {"value": 14.8, "sigma": 0.02, "unit": "V"}


def test_a_probe_without_a_supply_refers_to_the_mean_of_the_levels() -> None:
    calibration = diode_calibration()
    sensor: Any = calibration.sensors[0]
    probes = [probe.model_copy(update={"supply": None}) for probe in sensor.probes]
    sensors = [sensor.model_copy(update={"probes": probes}), *calibration.sensors[1:]]
    calibration = calibration.model_copy(update={"sensors": sensors})
    outcome = SimulatedCase(PROCEDURE, calibration, simulate().recording).identify()
    assert outcome.parts[0].content["reference"]["value"] == pytest.approx(15.0)


def test_a_supply_that_was_not_measured_or_not_varied_is_refused() -> None:
    def forget(supplies: FloatArray) -> None:
        supplies[:] = np.nan

    for case, sentence in (
        (
            simulate().with_readings("supply_voltages", forget),
            "the supply voltage was not measured; expected scans that",
        ),
        (simulate(levels=LEVELS[::5]), r"3 levels of the supply voltage; expected at least 4\.$"),
        (
            simulate(levels=15.0 + np.tile([0.0, 0.11], 4)),
            r"the supply voltage spans 0.1\d* V; expected at least 0.2 V\.$",
        ),
    ):
        case.check_refusal(FitError, f"^simulated: {sentence}")


def test_a_moving_target_enlarges_the_uncertainty() -> None:
    def move(volts: FloatArray) -> None:
        rng = np.random.default_rng(1)
        volts += np.repeat(rng.normal(size=len(LEVELS)), 25)[: len(volts), None] * 0.05

    outcome = simulate().with_readings("gap_voltages", move).identify()
    assert "gap probe gap_1: the residuals are" in outcome.warnings[0]
    moving, at_rest = (found.fits["gap probe gap_1"] for found in (outcome, simulate().identify()))
    assert moving.sigma("sensitivity") > 20.0 * at_rest.sigma("sensitivity")


def test_a_level_at_which_the_target_was_touched_is_named_and_survived() -> None:
    def touch(volts: FloatArray) -> None:
        volts[25 * 4 : 25 * 4 + 20] += 0.1

    outcome = simulate().with_readings("gap_voltages", touch).identify(loss="cauchy")
    assert any("left out level 5, which do not fit the others" in warning for warning in outcome.warnings)
    fit = outcome.fits["gap probe gap_2"]
    assert abs(fit.value("sensitivity") - TRUE) < 4.0 * fit.sigma("sensitivity")


def test_the_design_has_the_sensitivity_of_this_test() -> None:
    sensor: Any = diode_calibration().sensors[0]
    assert sensor.probes[0].supply.sensitivity == Quantity(value=TRUE, sigma=2e-6, unit="m/V")
