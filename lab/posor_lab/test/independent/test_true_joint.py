# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The independent model of one joint: ray-traced cases, the averaged area, curves and sessions, refused files."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from posor.calibration.calibration_file import calibration_from
from posor.calibration.designs import design
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor_lab.accuracy.golden_command import StackName, read_cases
from posor_lab.independent.file_values import si_values
from posor_lab.independent.probe_distance import AREA_RADIUS, ProbedPlane
from posor_lab.independent.true_joint import TrueJoint
from posor_lab.mutations.model_checks import GOLDEN_CASES, GOLDEN_STACKS
from posor_lab.true_scans import TruePosor
from scipy.spatial.transform import Rotation

AREA_EFFECT = 1e-7
"""Largest effect of the averaged area on the gaps of the ray-traced cases, which lean by up to 17 mrad [m]."""


def ratios(currents: np.ndarray) -> np.ndarray:
    return np.asarray((currents[..., :2] - currents[..., 2:]) / (currents[..., :2] + currents[..., 2:]))


@pytest.mark.parametrize("stack", GOLDEN_STACKS)
def test_ray_traced_cases(stack: StackName) -> None:
    for case in read_cases(GOLDEN_CASES, stack):
        truth = TrueJoint(case.calibration.model_dump(mode="json"))
        found = truth.readings(case.T_R_T.rotation[None], case.T_R_T.translation[None])
        averaged = case.scan.gap_voltages - found["gap_voltages"][0]  # a volt is a metre there
        assert np.all((averaged > -1e-10) & (averaged < AREA_EFFECT)), case.name
        if stack == "triad_diodes":
            exact = ratios(case.scan.diode_currents)
            np.testing.assert_allclose(ratios(found["diode_currents"][0]), exact, rtol=0.0, atol=1e-12)
        else:
            averaged = case.scan.ring_voltages - found["ring_voltages"][0]
            assert np.all((averaged > -1e-10) & (averaged < AREA_EFFECT)), case.name


@pytest.mark.parametrize("lean", [1e-3, 1e-2])
def test_the_area_of_a_probe_shortens_the_reading_of_a_leaning_plane(lean: float) -> None:
    plane, gap = ProbedPlane(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.zeros(3), np.zeros(2)), 3e-4
    pose = Rotation.from_rotvec([lean, 0.0, 0.0]).as_matrix()[None], np.array([[0.0, 0.0, gap]])
    found = plane.distances(*pose)[0, 0]
    assert gap - found == pytest.approx((AREA_RADIUS * np.tan(lean)) ** 2 / (4.0 * gap), rel=1e-3)


def test_curves_and_zero_shifts_of_a_session_read_as_in_the_estimator() -> None:
    content = design("triad_diodes").model_dump(mode="json", exclude_none=True)
    curves = [[1e-5 * i, (6.0 + 0.2 * i) * 1e-3, 1e-4, 5e-4] for i in range(3)]
    one = {
        "kind": "curves",
        "domain": {"value": [[-0.8, 0.8], [-0.8, 0.8]], "unit": "1"},
        **{key: {"value": curves, "unit": "m"} for key in ("x_curves", "y_curves")},
        **{key: {"value": [-6e-3, 0.0, 6e-3], "unit": "m"} for key in ("x_curves_at", "y_curves_at")},
    }
    content["sensors"][1]["maps"]["1985"] = [one, one]
    content["sessions"] = {
        "day": {"note": "", "zero_shifts": {"value": [0.1, -0.2, 0.3], "unit": "V"}, "diode_map": "1985"}
    }
    posor, random = Posor(calibration_from(content).for_session("day")), np.random.default_rng(5)
    turn = Rotation.from_rotvec(random.uniform(-0.02, 0.02, (50, 1)) * [0.0, 0.0, 1.0]).as_matrix()
    place = turn, random.uniform([-2e-3, -2e-3, 0.6e-3], [2e-3, 2e-3, 0.8e-3], (50, 3))
    expected, found = scans_at(posor.stack, *place, np.arange(50)), TrueJoint(content, "day").readings(*place)
    np.testing.assert_allclose(found["diode_currents"], expected.diode_currents, rtol=1e-9)
    np.testing.assert_allclose(found["gap_voltages"], expected.gap_voltages, rtol=0.0, atol=5e-5)
    assert np.isfinite(found["diode_currents"]).all()
    assert not np.allclose(TrueJoint(content).readings(*place)["gap_voltages"], found["gap_voltages"], atol=0.05)


@pytest.mark.parametrize("name", ["triad_diodes", "quad_bumpy_ring"])
def test_drawn_parts_read_as_in_the_estimator(name: Any) -> None:
    calibration, random = design(name), np.random.default_rng(3)
    stack = Posor(calibration).stack
    errors = stack.parameter_sigmas * random.normal(size=stack.parameters)
    drawn = stack.with_parameter_values(stack.parameter_values + errors)
    place = np.eye(3)[None], np.array([[1e-5, 2e-5, 0.7e-3]])
    arguments: Any = {"supply_voltages": np.array([15.2]), "temperatures": np.array([291.0])}
    expected = scans_at(drawn, *place, np.arange(1), **arguments)
    found = TruePosor(calibration).scans_at(drawn, *place, np.arange(1), **arguments)
    for field in ("gap_voltages", "ring_voltages", "diode_currents"):
        np.testing.assert_allclose(getattr(found, field), getattr(expected, field), rtol=1e-9, atol=5e-5, err_msg=field)
    assert not np.allclose(
        found.gap_voltages, scans_at(stack, *place, np.arange(1), **arguments).gap_voltages, rtol=1e-5
    )


def test_quantities_in_all_units_of_files() -> None:
    entry = {"value": ["20 mm", 0.5, "3e-3"], "unit": "m"}
    np.testing.assert_allclose(si_values(entry, "m"), [0.02, 0.5, 0.003])
    np.testing.assert_allclose(si_values({"value": [[180.0]], "unit": "deg"}, "rad"), [[np.pi]])
    with pytest.raises(ValueError, match=r"has the unit 'V'; expected 'm'$"):
        si_values({"value": 1.0, "unit": "V"}, "m")
    with pytest.raises(ValueError, match=r"'2 V' is not a number in 'm'$"):
        si_values({"value": ["2 V"], "unit": "m"}, "m")


def test_parts_that_the_model_does_not_know_are_refused() -> None:
    content = design("triad_diodes").model_dump(mode="json")
    with pytest.raises(ValueError, match="habit of 1985"):
        TrueJoint(content | {"tilt_angle": "previous_scan"})
    with pytest.raises(ValueError, match=r"sensor of type 'wire'; expected one of gap_probes, bumpy_ring, diodes$"):
        TrueJoint(content | {"sensors": [{"type": "wire"}]})
    with pytest.raises(ValueError, match=r"error of 'Wire.x\[0\]'; expected a name such as"):
        TrueJoint(content).with_errors({"Wire.x[0]": 1.0})
