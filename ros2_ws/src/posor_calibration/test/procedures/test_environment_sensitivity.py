# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sensitivity to supply voltage and temperature: simulated truth, the entry of the file, and unsuitable levels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from posor.calibration.calibration_file import Calibration
from posor.calibration.quantity import Quantity
from posor.errors import FitError
from posor.numerics.array_types import FloatArray
from posor_calibration.procedure import Procedure
from posor_calibration.procedures.environment_sensitivity import SUPPLY_SENSITIVITY, TEMPERATURE_SENSITIVITY
from posor_lab.harness.simulated_recordings import PERIOD_NS, diode_calibration, dwell_path
from scipy.stats import binomtest

from .simulated_case import SimulatedCase


@dataclass(frozen=True)
class Environment:
    procedure: Procedure[Any]
    field: str
    part: str
    unit: str
    truth: FloatArray  # sensitivity of each probe [m per unit]
    levels: FloatArray
    period_ns: int
    title: str
    reference: float  # of the design
    reference_sigma: float
    least_span: float

    def simulate(self, seed: int = 0, path: FloatArray | None = None, **others: FloatArray) -> SimulatedCase:
        """Return 20 scans at each level, or scans at the values of a path."""
        path = dwell_path(self.levels[:, None], 20)[:, 0] if path is None else path
        values = {self.field: path, "period_ns": self.period_ns, **others}
        return SimulatedCase.at_rest(self.procedure, with_part(self.part, self.truth), len(path), seed, **values)

    def normalised_errors(self, case: SimulatedCase) -> FloatArray:
        """Return the error of each sensitivity over its standard uncertainty, (3,)."""
        found = np.array([(f.value("sensitivity"), f.sigma("sensitivity")) for f in case.identify().fits.values()])
        return np.asarray((found[:, 0] - self.truth) / found[:, 1])


def with_part(part: str, truth: FloatArray | None) -> Calibration:
    """Return a calibration whose probes have these sensitivities, or none."""
    calibration = diode_calibration()
    sensor: Any = calibration.sensors[0]
    probes = []
    for index, probe in enumerate(sensor.probes):
        present = getattr(probe, part)
        slope = None if truth is None else Quantity(value=float(truth[index]), unit=present.sensitivity.unit)
        new = None if slope is None else present.model_copy(update={"sensitivity": slope})
        probes.append(probe.model_copy(update={part: new}))
    sensors = [sensor.model_copy(update={"probes": probes}), *calibration.sensors[1:]]
    return calibration.model_copy(update={"sensors": sensors})


SUPPLY = Environment(
    procedure=SUPPLY_SENSITIVITY,
    field="supply_voltages",
    part="supply",
    unit="V",
    truth=np.array([2e-5, -1e-5, 3e-5]),
    levels=np.linspace(14.5, 15.5, 11),
    period_ns=PERIOD_NS,
    title="supply voltage",
    reference=15.0,
    reference_sigma=0.01,
    least_span=0.2,
)
TEMPERATURE = Environment(
    procedure=TEMPERATURE_SENSITIVITY,
    field="temperatures",
    part="temperature",
    unit="K",
    truth=np.array([5e-7, -2e-6, 1.5e-6]),
    levels=293.15 + np.linspace(-4.0, 4.0, 9),
    period_ns=10_000_000_000,  # a soak takes hours
    title="temperature of the plate",
    reference=293.15,
    reference_sigma=0.1,
    least_span=2.0,
)
BOTH = pytest.mark.parametrize("environment", [SUPPLY, TEMPERATURE], ids=["supply", "temperature"])


@BOTH
def test_the_truth_is_found_and_the_entry_of_the_file_keeps_the_reference(environment: Environment) -> None:
    case = environment.simulate()
    assert np.abs(environment.normalised_errors(case)).max() < 4.0
    part = case.identify().parts[1]
    assert part.key == f"sensors[0].probes[1].{environment.part}"
    assert part.content["sensitivity"]["unit"] == f"m/{environment.unit}"
    assert part.content["sensitivity"]["sigma"] < 0.1 * abs(environment.truth[1])
    reference, sigma, unit = environment.reference, environment.reference_sigma, environment.unit
    assert part.content["reference"] == {"value": reference, "sigma": sigma, "unit": unit}
    named = case.identify(reference=reference - 0.2, reference_sigma=0.02).parts[1].content["reference"]
    assert named == {"value": reference - 0.2, "sigma": 0.02, "unit": unit}


@pytest.mark.long
@BOTH
def test_95_percent_intervals_cover_the_truth(environment: Environment) -> None:
    errors = [environment.normalised_errors(environment.simulate(seed)) for seed in range(40)]
    assert binomtest(int(np.sum(np.abs(errors) < 1.96)), 120, 0.95).pvalue > 0.01


@BOTH
def test_a_quantity_that_was_not_measured_or_not_varied_is_refused(environment: Environment) -> None:
    title, unit, span = environment.title, environment.unit, environment.least_span
    few = dwell_path(environment.levels[:: len(environment.levels) // 2, None], 20)[:, 0]
    narrow = dwell_path(environment.reference + 0.6 * span * np.tile([0.0, 1.0], 4)[:, None], 20)[:, 0]
    for case, sentence in (
        (environment.simulate().with_readings(environment.field, np.nan), f"{title} was not measured; expected scans"),
        (environment.simulate(path=few), rf"3 levels of the {title}; expected at least 4\.$"),
        (environment.simulate(path=narrow), rf"the {title} spans [\d.]+ {unit}; expected at least {span:g} {unit}\.$"),
    ):
        case.check_refusal(FitError, f"^simulated: .*{sentence}")


def test_readings_without_scatter_get_the_calibrated_noise_of_a_mean() -> None:
    """Every scan of a level has their mean voltages; 20 scans, the last level 25, and 5 lead from level to level."""

    def freeze(voltages: FloatArray) -> FloatArray:
        for start in range(0, len(voltages), 25):
            level = slice(start, start + (20 if start + 25 < len(voltages) else 25))
            voltages[level] = voltages[level].mean(axis=0)
        return voltages

    scattered = TEMPERATURE.simulate()
    frozen = scattered.with_readings("gap_voltages", freeze)
    sigmas = [[fit.sigma("sensitivity") for fit in case.identify().fits.values()] for case in (scattered, frozen)]
    np.testing.assert_allclose(sigmas[1], sigmas[0], rtol=0.2)


def test_the_table_has_the_effect_of_the_variation_in_use() -> None:
    (table,) = TEMPERATURE.simulate().identify(variation=0.5).tables
    for row, true in zip(table.rows, TEMPERATURE.truth, strict=True):
        assert float(row[1]) == pytest.approx(1e6 * true, rel=0.2)
        assert float(row[3]) == pytest.approx(0.5 * abs(float(row[1])))


def test_the_truth_is_found_from_a_slow_drift() -> None:
    """A room that warms up and cools down: pieces within the tolerance count as dwells."""
    case = TEMPERATURE.simulate(path=293.15 + 2.0 * np.sin(np.linspace(0.0, 2.0 * np.pi, 1500)))
    assert np.abs(TEMPERATURE.normalised_errors(case)).max() < 4.0


def test_the_supply_is_corrected_meanwhile() -> None:
    """A supply that follows the temperature acts on the voltages, and is measured: the result stays the same."""
    path = dwell_path(TEMPERATURE.levels[:, None], 20)[:, 0]
    case = TEMPERATURE.simulate(path=path, supply_voltages=15.0 + 0.1 * (path - 293.15))
    assert np.abs(TEMPERATURE.normalised_errors(case)).max() < 4.0
    of_supply = 0.1 * 2e-6  # its uncertainty [m/V] times the slope of the supply [V/K]
    assert min(fit.sigma("sensitivity") for fit in case.identify().fits.values()) == pytest.approx(of_supply, rel=0.1)


@pytest.mark.parametrize("environment", [SUPPLY, TEMPERATURE])
def test_a_probe_without_an_entry_needs_the_reference_of_its_linearisation(environment: Environment) -> None:
    recording = environment.simulate().recording
    case = SimulatedCase(environment.procedure, with_part(environment.part, None), recording)
    with pytest.raises(FitError, match=f"at which the gaps were linearised is not known; .* in {environment.unit}"):
        case.identify()
    stated = case.identify(reference=environment.reference, reference_sigma=0.1).parts[0].content["reference"]
    assert stated == {"value": environment.reference, "sigma": 0.1, "unit": environment.unit}


def test_a_moving_target_enlarges_the_uncertainty() -> None:
    at_rest = SUPPLY.simulate()
    steps = np.repeat(0.05 * np.random.default_rng(1).normal(size=11), 25)[: len(at_rest.recording.scans), None]
    outcome = at_rest.with_readings("gap_voltages", lambda volts: volts + steps).identify()
    assert "gap probe gap_1: the residuals are" in outcome.warnings[0]
    moving, resting = (found.fits["gap probe gap_1"] for found in (outcome, at_rest.identify()))
    assert moving.sigma("sensitivity") > 20.0 * resting.sigma("sensitivity")


def test_a_level_at_which_the_target_was_touched_is_named_and_survived() -> None:
    touched = SUPPLY.simulate().with_readings("gap_voltages", lambda volts: volts + 0.1, np.s_[100:120])
    outcome = touched.identify(loss="cauchy")
    assert any("left out level 5, which do not fit the others" in warning for warning in outcome.warnings)
    fit = outcome.fits["gap probe gap_2"]
    assert abs(fit.value("sensitivity") - SUPPLY.truth[1]) < 4.0 * fit.sigma("sensitivity")
