# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The formulas of TWIS and GEN: against printed results of YMO, against their own simulation, and their figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from posor.bags.calibration_recording import read_scans
from posor.calibration.calibration_file import load_calibration
from posor.estimation.posor import Posor
from posor_calibration.attitude_fit import deviation_from_first
from posor_lab.harness.rig_files import bag_path, calibration_path
from posor_lab.replay_1985.end_of_beam import (
    Z_LEVER,
    EndOfBeamProgram,
    SensorNoise,
    noise_of_1985,
    simulated_errors,
    simulated_readings,
)
from posor_lab.replay_1985.printed_results import EndOfBeamResults, EndOfBeamTest, PrintedColumns, read_end_of_beam
from posor_lab.thesis_budgets.motion_predictions import dimensions
from posor_lab.thesis_data import URAD
from scipy.constants import inch

TESTS: tuple[EndOfBeamTest, ...] = ("TWIS", "GEN")
NO_NOISE = SensorNoise(np.zeros(3), np.zeros(4), 0.0)


@pytest.fixture(scope="module")
def rigid_program() -> EndOfBeamProgram:
    """Return the evaluation of a plate without flatness errors, in which no step uses theta of the step before."""
    return EndOfBeamProgram(
        {**dimensions(), "flatness_D1": 0.0, "flatness_D2_D3_listing": 0.0, "sigma1": 0.0, "sigma2": 0.0}
    )


def test_alpha_of_ymo_is_the_printed_one(printed: PrintedColumns) -> None:
    posor = Posor(load_calibration(calibration_path("printed")).for_session("ymo"))
    readings = posor.stack.linearise(read_scans(bag_path("ymo"))).values / inch
    sizes = dimensions()
    program = EndOfBeamProgram({**sizes, "flatness_D2_D3_listing": sizes["flatness_D2_D3_tables"]})
    results = program.evaluate(readings[None, :, :3], readings[None, :, 3:])[0]
    np.testing.assert_allclose(results[:, 0], printed.posor[:, 0], rtol=0.0, atol=0.8 * URAD)
    with_listing = EndOfBeamProgram().evaluate(readings[None, :, :3], readings[None, :, 3:])[0]
    assert np.max(np.abs(with_listing[:, 0] - printed.posor[:, 0])) > 5.0 * URAD


def test_the_distance_at_each_probe_is_its_gap() -> None:
    program = EndOfBeamProgram()
    gaps = np.array([0.030, 0.034, 0.041])
    at_probes = ((-program.sizes["c"], 0.0), (0.0, program.sizes["a"]), (0.0, -program.sizes["b"]))
    np.testing.assert_allclose([program.distance(gaps, *at) for at in at_probes], gaps, rtol=1e-12)


def test_inclined_light_shifts_the_spots_as_in_the_listing() -> None:
    """The signs of the listing of GEN: X1 + cos, Y1 - sin, X2 + cos, Y2 + sin."""
    inclined = {"sigma1": 0.004, "sigma2": 0.002, "rho1": np.radians(20.0), "rho2_listing": np.radians(50.0)}
    program = EndOfBeamProgram({**dimensions(), **inclined})
    changes, theta = (np.array([0.01]), np.array([0.03])), np.array([np.radians(10.0)])
    expected = [4e-5 * np.sqrt(0.75), -4e-5 * 0.5, 6e-5 * 0.5, 6e-5 * np.sqrt(0.75)]
    np.testing.assert_allclose(program.ray_shifts(changes, theta)[0], expected, rtol=1e-12)


@pytest.mark.parametrize("test", TESTS)
def test_a_rigid_plate_gives_the_motion_back(test: EndOfBeamTest, rigid_program: EndOfBeamProgram) -> None:
    gaps, spots = simulated_readings(test, rigid_program)
    results = rigid_program.evaluate(gaps[None], spots[None])[0]
    np.testing.assert_allclose(results, read_end_of_beam(test).motion, rtol=0.0, atol=1e-9)


def test_a_change_of_a_reading_changes_the_end_of_the_beam(rigid_program: EndOfBeamProgram) -> None:
    gaps, spots = (readings[None] for readings in simulated_readings("GEN", rigid_program))
    before = rigid_program.evaluate(gaps, spots)[0, -1]
    change = 1e-4
    farther = gaps.copy()
    farther[0, -1, 0] += change  # probe 1 turns the beam to the side
    moved = rigid_program.evaluate(farther, spots)[0, -1] - before
    assert moved[2] == pytest.approx(33.4 * change / dimensions()["c"], rel=1e-3)
    turned = spots.copy()
    turned[0, -1, 0] += change  # spot 1 along X turns the beam up or down
    moved = rigid_program.evaluate(gaps, turned)[0, -1] - before
    assert moved[1] == pytest.approx(-Z_LEVER * change / 3.02, rel=0.02)


def test_theta_of_the_previous_step_matters_where_the_motion_jumps() -> None:
    """The last step of GEN is 2.8 times as long as the one before; flatness terms lag behind by one step."""
    errors = simulated_errors("GEN", noise=NO_NOISE, draws=1)[0]
    assert abs(errors[-1, 0]) > 4.0 * np.max(np.abs(errors[:-2, 0]))
    assert np.max(np.abs(simulated_errors("TWIS", noise=NO_NOISE, draws=1)[0, :, 0])) < 3.0 * URAD


def test_simulated_errors_grow_with_the_noise() -> None:
    noise = noise_of_1985()
    np.testing.assert_allclose(noise.gaps, [7e-6, 21e-6, 25e-6])
    np.testing.assert_allclose(noise.spots, [80e-6, 80e-6, 50e-6, 50e-6])
    once = simulated_errors("TWIS", draws=500)
    twice = simulated_errors("TWIS", noise=replace(noise, spots=2.0 * noise.spots), draws=500)
    deviations = [np.median(deviation_from_first(np.swapaxes(errors, 0, 1)), axis=0) for errors in (once, twice)]
    assert deviations[1][1] == pytest.approx(2.0 * deviations[0][1], rel=0.1)  # z: the readout is small beside theta
    assert deviations[1][0] == pytest.approx(deviations[0][0], rel=0.01)


def test_simulated_z_is_the_propagated_noise(rigid_program: EndOfBeamProgram) -> None:
    """Root 2, because every error is referred to step 1; theta from X of both spots, 3.02 in apart."""
    x_noise = np.hypot(80e-6, 50e-6)
    expected = np.sqrt(2.0) * np.hypot(Z_LEVER / 3.02 * x_noise, 2e-4)
    errors = simulated_errors("TWIS", program=rigid_program, draws=2000)
    assert np.std(errors[:, 1:, 1]) == pytest.approx(expected, rel=0.05)


def test_simulated_noise_of_the_machining_centre() -> None:
    """Root 2 as above; alpha and z from two readings .0002 in each, 3.5 in apart, runout 50 uin over 3 in (8.2)."""
    readout, twist = 2e-4, np.sqrt(2.0) * 2e-4 / 3.5
    share = 1.822 / 3.5
    expected = np.sqrt(2.0) * np.array(
        [np.hypot(twist, 50e-6 / 3.0), readout * np.hypot(share, 1.0 - share), np.hypot(readout, 1.34 * twist)]
    )
    errors = simulated_errors("TWIS", noise=replace(NO_NOISE, readout=readout), draws=4000)
    np.testing.assert_allclose(np.std(errors[:, 1:], axis=0).mean(axis=0), expected, rtol=0.02)


@pytest.mark.parametrize(
    ("test", "legible", "deviation_of_alpha", "root_mean_squares"),
    [("TWIS", (14, 9, 13), 54.6, (0.00372, 0.00443)), ("GEN", (9, 5, 5), 177.8, (0.00953, 0.00489))],
)
def test_figures_of_the_legible_tables(
    test: EndOfBeamTest,
    legible: tuple[int, int, int],
    deviation_of_alpha: float,
    root_mean_squares: tuple[float, float],
) -> None:
    results = read_end_of_beam(test)
    assert tuple(np.count_nonzero(results.legible[1:], axis=0)) == legible
    assert deviation_from_first(results.errors[:, 0]) / URAD == pytest.approx(deviation_of_alpha, abs=0.05)
    found = results.root_mean_square(1), results.root_mean_square(2)
    assert found == pytest.approx(root_mean_squares, abs=5e-6)


def test_missing_cells_are_interpolated_and_do_not_count() -> None:
    measured = np.array([[0.0, 0.0, 0.0], [1.0, np.nan, 2.0], [2.0, 4.0, 4.0]])
    results = EndOfBeamResults(measured, measured + np.array([[0.0], [1.0], [3.0]]))
    np.testing.assert_array_equal(results.motion[:, 1], [0.0, 2.0, 4.0])
    assert results.root_mean_square(1) == pytest.approx(3.0)
    assert results.root_mean_square(0) == pytest.approx(np.sqrt(5.0))
