# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of a POSOR as the bundle fit takes them: which number of the file each is, and which is free."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from posor.calibration.calibration_file import load_calibration
from posor.calibration.designs import DesignName, design
from posor.calibration.parameter_entries import parameter_entries
from posor.errors import CalibrationError, FitError
from posor.estimation.sensor_stack import Stack
from posor_calibration.calibration_parameters import FixedParameters, FreeParameters
from posor_lab.harness.random_poses import STACKS


@pytest.mark.parametrize("name", STACKS)
def test_every_parameter_is_found_in_the_file(name: DesignName) -> None:
    calibration = design(name)
    stack = Stack([sensor.build() for sensor in calibration.sensors])
    entries = parameter_entries(calibration)
    assert len(entries) == stack.parameters
    for value, sigma, entry in zip(stack.parameter_values, stack.parameter_sigmas, entries, strict=True):
        if entry is None:
            assert (value, sigma) == (0.0, 0.0)
        else:
            assert (entry.quantity.array[entry.index], entry.quantity.sigmas[entry.index]) == (value, sigma)
    named = {entry.name for entry in entries if entry is not None}
    assert "sensors[0].probes[2].tip[1]" in named
    assert "sensors[0].target_plane.tilt[0]" in named
    assert not any(".noise" in name or ".range" in name for name in named)


def test_entries_that_a_session_replaces_are_found_there(rig_calibrations: dict[str, Path]) -> None:
    calibration = load_calibration(rig_calibrations["section84"])
    keys = {entry.key for entry in parameter_entries(calibration, "ymo") if entry is not None}
    assert "sessions.ymo.zero_shifts" in keys
    assert "sensors[0].probes[0].zero_shift" not in keys
    with pytest.raises(CalibrationError, match="session 'none' is unknown"):
        parameter_entries(calibration, "none")


def test_directions_keep_their_length_and_their_derivatives_are_right(rng: np.random.Generator) -> None:
    free = FreeParameters(design("triad_diodes"))
    moved = free.start + 5.0 * free.sigmas * rng.normal(size=len(free))
    stack = Stack([sensor.build() for sensor in design("triad_diodes").sensors])
    values = free.parameter_vector(moved)
    for sensor in stack.with_parameter_values(values).sensors:
        for name in ("axes", "x_axes", "y_axes", "source_directions"):
            if name in sensor._slices:
                np.testing.assert_allclose(np.linalg.norm(sensor._array(name), axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(free.parameter_vector(free.start), stack.parameter_values, atol=1e-15)
    step = 1e-4 * free.sigmas
    by_steps = [
        (free.parameter_vector(moved + shift) - free.parameter_vector(moved - shift)) / (2.0 * step[i])
        for i, shift in enumerate(np.diag(step))
    ]
    np.testing.assert_allclose(free.derivatives(moved), np.array(by_steps).T, atol=1e-6)
    assert any(name == "sensors[0].probes[0].axis rotation 1" for name in free.names)


def test_only_what_is_asked_for_and_uncertain_may_change() -> None:
    calibration = design("triad_diodes")
    some = FreeParameters(calibration, "", ("sensors[0].probes[*].tip", "sensors[0].target_plane.tilt"))
    assert {name.partition("[0].")[2].split("[")[0] for name in some.names} == {"probes", "target_plane.tilt"}
    assert np.all(some.sigmas > 0.0)
    with pytest.raises(FitError, match=r"^calibration 'triad_diodes': '\*\.nose' matches no quantity that has an unc"):
        FreeParameters(calibration, "", ("*.nose",))


def test_correlations_stay_below_one() -> None:
    fixed = FixedParameters(design("triad_diodes"), np.zeros(0, dtype=np.int64))
    cross = np.zeros((1, fixed.root.shape[1]))
    cross[0, 3] = 1.5
    joint = fixed.join(("sensors[0].probes[0].zero_shift",), np.eye(1), cross)
    assert np.min(np.linalg.eigvalsh(joint.matrix / np.outer(*[np.sqrt(np.diag(joint.matrix))] * 2))) > -1e-9
