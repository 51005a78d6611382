"""Sensitivity to the temperature: simulated truth from levels and from a drift, and temperatures that do not serve."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from posor.calibration.quantity import Quantity
from posor.errors import FitError
from posor_calibration.procedures.temperature_sensitivity import PROCEDURE
from posor_lab.harness.simulated_recordings import diode_calibration, dwell_path
from scipy.stats import binomtest

from .simulated_case import SimulatedCase

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

TRUE = np.array([5e-7, -2e-6, 1.5e-6])
"""Of the probes [m/K]."""
LEVELS = 293.15 + np.linspace(-4.0, 4.0, 9)
PERIOD_NS = 10_000_000_000
"""From scan to scan: a soak takes hours."""


def warm_calibration() -> Calibration:
    """Return a calibration whose probes have the sensitivities of this test."""
    calibration = diode_calibration()
    sensor: Any = calibration.sensors[0]
    probes = [
        probe.model_copy(
            update={
                "temperature": probe.temperature.model_copy(
                    update={"sensitivity": Quantity(value=float(value), unit="m/K")}
                )
            }
        )
        for probe, value in zip(sensor.probes, TRUE, strict=True)
    ]
    sensors = [sensor.model_copy(update={"probes": probes}), *calibration.sensors[1:]]
    return calibration.model_copy(update={"sensors": sensors})


def simulate(seed: int = 0, temperatures: FloatArray | None = None, levels: FloatArray = LEVELS) -> SimulatedCase:
    path = dwell_path(levels[:, None], 20)[:, 0] if temperatures is None else temperatures
    return SimulatedCase.at_rest(PROCEDURE, warm_calibration(), len(path), seed, temperatures=path, period_ns=PERIOD_NS)


def normalised_errors(case: SimulatedCase) -> FloatArray:
    """Return the error of each sensitivity over its standard uncertainty, (3,)."""
    fits = case.identify().fits.values()
    return np.array(
        [(fit.value("sensitivity") - true) / fit.sigma("sensitivity") for fit, true in zip(fits, TRUE, strict=True)]
    )


def test_the_truth_is_found_from_levels() -> None:
    case = simulate()
    assert np.abs(normalised_errors(case)).max() < 4.0
    sigmas = [fit.sigma("sensitivity") for fit in case.identify().fits.values()]
    assert max(sigmas) < 0.1 * np.abs(TRUE).min()


def test_readings_without_scatter_get_the_calibrated_noise_of_a_mean() -> None:
    """Every scan of a level has their mean voltages; 20 scans, the last level 25, and 5 lead from level to level."""

    def freeze(voltages: FloatArray) -> None:
        for start in range(0, len(voltages), 25):
            level = slice(start, start + (20 if start + 25 < len(voltages) else 25))
            voltages[level] = voltages[level].mean(axis=0)

    scattered, frozen = simulate(), simulate().with_readings("gap_voltages", freeze)
    sigmas = [[fit.sigma("sensitivity") for fit in case.identify().fits.values()] for case in (scattered, frozen)]
    np.testing.assert_allclose(sigmas[1], sigmas[0], rtol=0.2)


def test_the_table_has_the_effect_of_the_variation_in_use() -> None:
    (table,) = simulate().identify(variation=0.5).tables
    for row, true in zip(table.rows, TRUE, strict=True):
        sensitivity, effect = float(row[1]), float(row[3])
        assert sensitivity == pytest.approx(1e6 * true, rel=0.2)
        assert effect == pytest.approx(0.5 * abs(sensitivity))


def test_the_truth_is_found_from_a_slow_drift() -> None:
    """A room that warms up and cools down: pieces within the tolerance count as dwells."""
    drift = 293.15 + 2.0 * np.sin(np.linspace(0.0, 2.0 * np.pi, 1500))
    case = simulate(temperatures=drift)
    assert np.abs(normalised_errors(case)).max() < 4.0


@pytest.mark.long
def test_95_percent_intervals_cover_the_truth() -> None:
    inside = sum(int(np.sum(np.abs(normalised_errors(simulate(seed))) < 1.96)) for seed in range(40))
    assert binomtest(inside, 120, 0.95).pvalue > 0.01


def test_the_entry_of_the_file_keeps_the_reference_temperature() -> None:
    part = simulate().identify().parts[1]
    assert part.key == "sensors[0].probes[1].temperature"
    assert part.content["sensitivity"]["unit"] == "m/K"
    assert part.content["reference"] == {"value": 293.15, "sigma": 0.1, "unit": "K"}
    named = simulate().identify(reference=294.0, reference_sigma=0.2).parts[1].content["reference"]
    assert named == {"value": 294.0, "sigma": 0.2, "unit": "K"}


def test_the_supply_is_corrected_meanwhile() -> None:
    """A supply that follows the temperature acts on the voltages, and is measured: the result stays the same."""
    path = dwell_path(LEVELS[:, None], 20)[:, 0]
    supplies = 15.0 + 0.1 * (path - 293.15)
    case = SimulatedCase.at_rest(
        PROCEDURE, warm_calibration(), len(path), temperatures=path, supply_voltages=supplies, period_ns=PERIOD_NS
    )
    assert np.abs(normalised_errors(case)).max() < 4.0
    of_supply = 0.1 * 2e-6  # its uncertainty [m/V] times the slope of the supply [V/K]
    assert min(fit.sigma("sensitivity") for fit in case.identify().fits.values()) == pytest.approx(of_supply, rel=0.1)


def test_a_temperature_that_was_not_measured_or_not_varied_is_refused() -> None:
    def forget(temperatures: FloatArray) -> None:
        temperatures[:] = np.nan

    for case, sentence in (
        (
            simulate().with_readings("temperatures", forget),
            "the temperature of the plate was not measured; expected scans that",
        ),
        (simulate(levels=LEVELS[::4]), r"3 levels of the temperature of the plate; expected at least 4\.$"),
        (
            simulate(levels=293.15 + np.tile([0.0, 1.5], 4)),
            r"the temperature of the plate spans 1.5 K; expected at least 2 K\.$",
        ),
    ):
        case.check_refusal(FitError, f"^simulated: {sentence}")
