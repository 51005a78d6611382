# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sensitivity of the pose to each reading: of the last estimate, and at any pose."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.designs import DesignName, design
from posor.errors import ScanError
from posor.estimation.posor import Posor
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import NO_SOURCE, Scans
from posor.uncertainty.reading_sensitivity import sensitivity_at
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.random_poses import STACKS, turning_scans

THETAS = np.linspace(0.05, 0.06, 5)


@pytest.mark.parametrize("temperature", [math.nan, 293.15])
@pytest.mark.parametrize("stack", STACKS)
def test_the_sensitivity_of_the_last_estimate_is_that_at_its_pose(stack: DesignName, temperature: float) -> None:
    posor = Posor(design(stack))
    scans = turning_scans(posor, THETAS)
    for n in range(len(scans)):
        scan = replace(scans[n], temperature=temperature)
        estimates = posor.estimate_all(Scans.of([scan]), fault_effects=True)
        expected = sensitivity_at(posor, scan, pin.XYZQUATToSE3(estimates.poses[0]))
        faults = posor.model.faults  # of the kernel; the first cause moves each reading
        own = [posor.hypotheses.names.index(f"reading: {name}") for name in posor.stack.reading_names]
        squares = np.square(faults.components[own]).sum(axis=1)
        for found, known in ((faults.shifts[own], expected.gain.T), (squares, expected.chi_square)):
            np.testing.assert_allclose(found, known, rtol=1e-6, atol=1e-7 * np.abs(known).max())
        assert expected.redundancy_numbers.sum() == pytest.approx(posor.redundancy)


def test_sensitivity_needs_valid_readings() -> None:
    posor = Posor(design("triad_diodes"))
    scan = turning_scans(posor, THETAS)[0]
    pose = pin.SE3(rotation_from_native(1e-4, -2e-4, THETAS[0]), np.array([2e-5, 1e-5, 0.7e-3]))
    dark = replace(scan, lit_sources=(NO_SOURCE,) * len(scan.lit_sources))
    without_voltage = replace(scan, gap_voltages=np.full_like(scan.gap_voltages, np.nan))
    for invalid in (dark, without_voltage):
        refusal(ScanError, sensitivity_at, posor, invalid, pose)
