# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every analytic derivative of every sensor against seeded central differences, for every calibration parameter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from posor.calibration.calibration_file import Calibration, calibration_from, load_calibration
from posor.calibration.designs import DesignName, design
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.estimation.sensor_stack import Stack
from posor.model.scan import Scan, Scans
from posor.numerics.array_types import FloatArray
from posor.sensors.base import RowSensor
from posor_lab.harness.random_poses import STACKS, readable_poses

RELATIVE = 1e-6
CURVES = 5


def residuals(stack: Stack, scan: Scan, rotation: FloatArray, translation: FloatArray) -> FloatArray:
    readings = stack.linearise(Scans.of([scan]))
    assert readings.valid.all()
    return np.asarray(readings.values[0] - stack.evaluate(readings.selected[0], rotation, translation)[0])


def check(stack: Stack, scan: Scan, rotation: FloatArray, translation: FloatArray) -> None:
    analytic = stack.residual_jacobian(scan, rotation, translation)
    values = stack.parameter_values
    moving = stack.with_parameter_values(values)
    assert analytic.shape == (stack.readings, values.size)
    for p, name in enumerate(stack.parameter_names):
        step = 1e-4 * max(abs(values[p]), 1e-2)

        def at(times: float, p: int = p, step: float = step) -> FloatArray:
            moved = values.copy()
            moved[p] += times * step
            moving.load_parameter_values(moved)
            return residuals(moving, scan, rotation, translation)

        found = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * step)
        rounding = 1e-15 / step
        assert analytic[:, p] == pytest.approx(found, rel=RELATIVE, abs=RELATIVE * np.max(np.abs(found)) + rounding), (
            name
        )
    changed = values + 1e-5 * np.abs(values)
    moving.load_parameter_values(changed)
    new_stack = stack.with_parameter_values(changed)
    kept = [sensor.rows["parameters"] for sensor in new_stack.sensors if isinstance(sensor, RowSensor)]
    np.testing.assert_array_equal(np.concatenate(kept), new_stack.reading_rows["parameters"])  # none of the old stack
    of_new_stack = residuals(new_stack, scan, rotation, translation)
    np.testing.assert_array_equal(residuals(moving, scan, rotation, translation), of_new_stack)
    assert not np.array_equal(residuals(stack, scan, rotation, translation), of_new_stack)


@pytest.mark.parametrize("name", STACKS)
def test_designs(name: DesignName, rng: np.random.Generator) -> None:
    posor = Posor(design(name))
    rotations, translations = readable_poses(posor, name, 3, rng)
    translations[:, 2] = 0.7e-3
    rotations, translations = rotations[:2], translations[:2]
    scans = scans_at(posor.stack, rotations, translations, np.arange(2, dtype=np.int64))
    scans = scans.with_fields({"supply_voltages": np.full(2, 15.3), "temperatures": np.full(2, 295.0)})
    for n in range(2):
        if np.isfinite(scans.gap_voltages[n]).all():
            check(posor.stack, scans[n], rotations[n], translations[n])


@pytest.mark.parametrize("name", ["printed", "section84"])
def test_rig_of_1985(rig_calibrations: dict[str, Path], name: str) -> None:
    calibration = load_calibration(rig_calibrations[name]).for_session("ymo")
    posor = Posor(calibration)
    ratios = np.array([[0.5148, 0.1029], [0.5071, 0.0611]])
    scan = Scan(
        gap_voltages=np.array([0.0755, 0.5013, 0.6304]),
        diode_currents=np.column_stack([1.0 + ratios, 1.0 - ratios]) * 5e-5,
        lit_sources=(0, 1),
    )
    pose = posor.estimate(scan).T_R_T
    assert pose is not None
    check(posor.stack, scan, pose.rotation, pose.translation)


def with_curves() -> Calibration:
    """The design with diodes, its maps replaced by maps of the 1985 kind, with curves that differ from line to line."""
    content = design("triad_diodes").model_dump(mode="json")
    at = np.linspace(-8e-3, 8e-3, CURVES)
    sag = 1.0 + 0.3 * (at / 8e-3) ** 2 * 0.05
    curves = [[1e-5, 6.4e-3 * s, 2e-5 * s, 3e-4, 1e-5] for s in sag]
    sigma = np.full((CURVES, 5), 1e-7).tolist()
    one = {
        "kind": "curves",
        "domain": {"value": [[-0.9, 0.9], [-0.9, 0.9]], "unit": "1"},
        "x_curves": {"value": curves, "sigma": sigma, "unit": "m"},
        "x_curves_at": {"value": at.tolist(), "sigma": 1e-6, "unit": "m"},
        "y_curves": {"value": (1.01 * np.array(curves)).tolist(), "sigma": sigma, "unit": "m"},
        "y_curves_at": {"value": (1.02 * at).tolist(), "sigma": 1e-6, "unit": "m"},
    }
    content["sensors"][1]["maps"] = {"curves": [one, one]}
    content["sensors"][1]["map"] = "curves"
    return calibration_from(content)


def test_maps_of_curves(rng: np.random.Generator) -> None:
    posor = Posor(with_curves())
    rotations, translations = readable_poses(posor, "triad_diodes", 2, rng)
    scans = scans_at(posor.stack, rotations, translations, np.arange(2, dtype=np.int64))
    scans = scans.with_fields({"supply_voltages": np.full(2, 15.3), "temperatures": np.full(2, 295.0)})
    for n in range(2):
        check(posor.stack, scans[n], rotations[n], translations[n])


def test_maps_of_curves_close(rng: np.random.Generator) -> None:
    posor = Posor(with_curves())
    rotations, translations = readable_poses(posor, "triad_diodes", 50, rng)
    found = posor.estimate_each(scans_at(posor.stack, rotations, translations, np.arange(50, dtype=np.int64)))
    assert found.translations == pytest.approx(translations, abs=1e-12)
    assert found.rotations == pytest.approx(rotations, abs=1e-11)
