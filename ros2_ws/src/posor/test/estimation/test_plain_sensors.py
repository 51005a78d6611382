# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sensors in plain Python: the same sensor as plain sensor and as rows gives the same poses, states and covariances."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pytest
from posor.calibration.calibration_file import Calibration, TiltAngle
from posor.calibration.designs import BUMPS, design, sized_design
from posor.errors import ParameterError
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.estimation.sensor_stack import Stack
from posor.model.fault import Fault, State
from posor.model.reading_rows import differentiate_rows, evaluate_rows
from posor.model.scan import NO_SOURCE, Scan, Scans
from posor.numerics.array_types import FloatArray
from posor.sensors.base import PlainReadings, PlainSensor, RowSensor, SensorCalibration
from posor.uncertainty.budget_poses import middle_pose, scan_at
from posor.uncertainty.budget_quantities import PlatePoint
from posor.uncertainty.first_order import error_budget
from posor_design.monte_carlo import monte_carlo
from posor_lab.harness.random_poses import TICK_NS, readable_poses, turning_scans

BUMP = 2.0 * math.pi / BUMPS


class PlainTwin(PlainSensor):
    """Any sensor with rows whose scans all read the same rows, as a plain sensor."""

    def __init__(self, original: RowSensor) -> None:
        self._original = original
        self._rows = np.arange(len(original.reading_names))
        super().__init__({"all": original.parameter_values}, {"all": original.parameter_sigmas})

    @property
    def reading_names(self) -> tuple[str, ...]:
        return self._original.reading_names

    def read(self, scan: Scan) -> PlainReadings:
        readings = Stack([self._original]).linearise(Scans.of([scan]))
        if not readings.valid[0]:
            raise self._original.explain(scan, int(readings.codes[0, 0]))
        self._rows = readings.selected[0]
        jacobian = self._original._linearisation_jacobian(scan)
        channels = self._original.reading_source.channels
        by = (channels[name] for name in ("supply_sensitivity", "temperature_sensitivity")) if len(channels) else None
        sensitivities = None if by is None else np.column_stack(list(by))
        return PlainReadings(readings.values[0], readings.variances[0], jacobian, sensitivities)

    def predict(self, rotation: FloatArray, translation: FloatArray) -> tuple[FloatArray, FloatArray]:
        return evaluate_rows(self._original.rows[self._rows], rotation, translation)

    def predict_jacobian(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        out = np.zeros((len(self._rows), self._values.size))
        derivatives = differentiate_rows(self._original.rows[self._rows], rotation, translation)
        for row, ids, derivative in zip(out, self._original.row_parameters[self._rows], derivatives, strict=True):
            np.add.at(row, ids[ids >= 0], derivative[ids >= 0])
        return out


class TwinCalibration(SensorCalibration):
    """The calibration of a plain twin."""

    type: Literal["twin"] = "twin"
    original: SensorCalibration

    def build(self) -> PlainTwin:
        original = self.original.build()
        assert isinstance(original, RowSensor)
        return PlainTwin(original)

    @property
    def bump_angle(self) -> float:
        return self.original.bump_angle

    @property
    def home_theta(self) -> float:
        return self.original.home_theta


def twins(calibration: Calibration, plain: tuple[int, ...]) -> tuple[Posor, Posor]:
    """Return a POSOR, and the same with some of its sensors plain."""
    sensors: list[SensorCalibration] = list(calibration.sensors)
    for i in plain:
        sensors[i] = TwinCalibration.model_construct(original=sensors[i])
    return Posor(calibration), Posor(calibration.model_copy(update={"sensors": sensors}))


def check_alike(rows: Posor, plain: Posor, scans: Scans) -> None:
    expected, found = rows.estimate_all(scans), plain.estimate_all(scans)
    np.testing.assert_array_equal(found.states, expected.states)
    np.testing.assert_array_equal(found.faults, expected.faults)
    np.testing.assert_allclose(found.translations, expected.translations, rtol=0.0, atol=1e-10)
    # Where bumps are misread or noisy, the residuals stay, and the solver stops a little before the last digit.
    np.testing.assert_allclose(found.rotations, expected.rotations, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.thetas, expected.thetas, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.residuals, expected.residuals, rtol=1e-6, atol=1e-6)
    for name in ("covariances_random", "covariances_systematic"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-9 * np.nanmax(np.abs(theirs)))


@pytest.mark.parametrize("plain", [(0,), (1,), (0, 1)])
def test_noisy_scans_one_after_the_other(plain: tuple[int, ...]) -> None:
    rows, twin = twins(design("triad_diodes"), plain)
    check_alike(rows, twin, turning_scans(rows, 0.05 * np.sin(np.arange(40) * 0.3), seed=2))


def test_poses_that_have_nothing_to_do_with_one_another() -> None:
    rows, twin = twins(design("triad_diodes"), (1,))
    rotations, translations = readable_poses(rows, "triad_diodes", 20, np.random.default_rng(5))
    scans = scans_at(rows.stack, rotations, translations, np.arange(20, dtype=np.int64))
    found = twin.estimate_each(scans)
    assert (found.states == State.OK).all()
    np.testing.assert_allclose(found.translations, translations, rtol=0.0, atol=1e-12)


def test_a_dark_scan_beside_a_plain_sensor_has_no_pose_but_shows_the_ambient_light() -> None:
    calibration = sized_design("checked_light_ring", 0.1524, frames=("receiving", "target"), title="joint")
    _, twin = twins(calibration, (0,))
    scans = turning_scans(Posor(calibration), np.linspace(0.0, 8e-4, 9), seed=4).editable()
    scans.statuses[:], scans.lit_sources[[0, 5]], scans.diode_currents[[0, 5]] = 0, NO_SOURCE, 0.0
    scans.diode_currents[:] += 1e-6
    found = twin.estimate_all(scans)
    assert np.flatnonzero(found.states == State.LOST).tolist() == [0, 5]
    assert set(found.faults[[0, 5]]) == {int(Fault.AMBIENT)}
    assert np.all(found.states[[1, 2, 3, 4, 6, 7, 8]] == State.OK)


def test_faults_and_limits_of_motion() -> None:
    rows, twin = twins(design("triad_diodes", motion=True), (1,))
    thetas = np.concatenate([np.arange(20) * 1e-4, 0.05 + np.arange(20) * 1e-4])  # a jump by 48 mrad in a millisecond
    scans = turning_scans(rows, thetas, seed=6)
    scans.diode_currents[7] = np.nan
    scans.diode_currents[9, 0, :2] *= 1.02
    expected = rows.estimate_all(scans)
    assert expected.faults[7] == Fault.BAD_READING
    assert expected.faults[9] & Fault.RESIDUAL
    assert expected.faults[20] & Fault.INNOVATION
    rows.reset()
    check_alike(rows, twin, scans)


def test_tilts_at_the_theta_of_the_scan_before() -> None:
    """Gaps lag, ring readings never do: so the ring may be plain."""
    calibration = design("triad_bumpy_ring").model_copy(update={"tilt_angle": TiltAngle.PREVIOUS_SCAN})
    rows, twin = twins(calibration, (1,))
    check_alike(rows, twin, turning_scans(rows, 1e-3 * np.arange(30.0), home=(0,), seed=9))


def test_time_that_goes_back_starts_over() -> None:
    rows, twin = twins(design("triad_diodes", motion=True), (1,))
    scans = turning_scans(rows, np.concatenate([np.arange(10) * 1e-4, 0.05 + np.arange(10) * 1e-4]))
    scans = scans.with_fields({"stamps_ns": np.tile(np.arange(1, 11), 2) * TICK_NS})
    check_alike(rows, twin, scans)


def test_counting_and_the_home_mark() -> None:
    rows, twin = twins(design("triad_bumpy_ring", motion=True), (1,))
    check_alike(rows, twin, turning_scans(rows, np.linspace(-1.5 * BUMP, 0.1 * BUMP, 160), home=(150,)))


def test_home_marks_that_disagree() -> None:
    rows, twin = twins(design("triad_bumpy_ring"), (1,))
    thetas = np.concatenate([[0.0], np.linspace(2.0 * BUMP, -0.2 * BUMP, 100)])
    at_mark = int(np.argmin(np.abs(thetas[1:]))) + 1
    scans = turning_scans(rows, thetas, home=(0,))
    scans.at_home[at_mark : at_mark + 5] = 1
    assert rows.estimate_all(scans).faults[at_mark] == Fault.COUNT
    rows.reset()
    check_alike(rows, twin, scans)


def test_tilts_lag_the_scan_before_across_a_correction_at_home() -> None:
    calibration = design("triad_bumpy_ring", motion=True).model_copy(update={"tilt_angle": TiltAngle.PREVIOUS_SCAN})
    rows, twin = twins(calibration, (1,))
    thetas = np.linspace(0.0, 2.7e-3 * 119, 120)
    scans = turning_scans(rows, thetas, home=(0, 117))
    expected, found = rows.estimate_all(scans), twin.estimate_all(scans)
    assert abs(found.thetas[117]) < 0.5 * BUMP < abs(found.thetas[116])
    np.testing.assert_array_equal(found.states, expected.states)
    np.testing.assert_array_equal(found.faults, expected.faults)


def test_a_count_in_doubt() -> None:
    rows, twin = twins(design("triad_bumpy_ring"), (1,))
    scans = turning_scans(rows, 2e-3 * np.arange(120.0), home=(0,))
    gap = scans.with_fields({})
    gap.ring_voltages[40:105] = np.nan
    check_alike(rows, twin, gap)


def test_blind_phases_are_carried_over() -> None:
    rows, twin = twins(design("triad_bumpy_ring", ring_probes=3, motion=True), (1,))
    scans = turning_scans(rows, 3.5e-4 * np.arange(300.0), home=(0,))
    expected = rows.estimate_all(scans)
    assert (expected.faults == Fault.ILL_CONDITIONED).any()
    rows.reset()
    check_alike(rows, twin, scans)


@pytest.mark.long
def test_blind_phases_with_noise() -> None:
    """Which scan counts as blind depends on the way to its solution; the stated uncertainty holds all the same."""
    thetas = BUMP * np.linspace(0.1, 0.45, 300)
    rows, twin = twins(design("triad_bumpy_ring", ring_probes=3, motion=True), (1,))
    found = twin.estimate_all(turning_scans(rows, thetas, home=(0,), seed=7))
    usable = found.states != State.LOST
    assert (found.faults[usable] == Fault.ILL_CONDITIONED).any()
    lost = found.faults[~usable]  # without redundancy a solution beside the right one ends in the latch
    assert lost[0] & Fault.INNOVATION
    assert (lost[1:] & Fault.LATCHED).all()
    spread = np.sqrt(found.covariances_random[usable, 5, 5])
    assert (np.abs(found.thetas[usable] - thetas[usable]) < 5.0 * spread).all()


def test_the_error_budget_of_a_plain_sensor_is_that_of_its_rows_and_cannot_be_drawn() -> None:
    rows, plain = twins(design("triad_diodes"), (1,))
    pose = middle_pose(rows)
    scan = scan_at(rows, pose)
    points = [PlatePoint(0.01, -0.02)]
    expected, found = error_budget(rows, scan, pose, points), error_budget(plain, scan, pose, points)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-6, atol=1e-9 * expected.covariance.max())
    np.testing.assert_allclose(found.root_sum_square(), found.sigmas, rtol=1e-9)
    assert any(part.name.startswith("twin: all[") for part in found.contributions)
    with pytest.raises(ParameterError, match="PlainTwin has no forward model; expected sensors with a forward"):
        monte_carlo(plain, scan, pose, seed=1)
    with pytest.raises(ParameterError, match="PlainTwin has no forward model; expected sensors with a forward"):
        scan_at(plain, pose)
