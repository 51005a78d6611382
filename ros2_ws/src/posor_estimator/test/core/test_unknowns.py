"""The parameters of a POSOR as the bundle fit takes them: which number of the file each is, and which may change."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_estimator.accuracy.poses import STACKS
from posor_estimator.core.calibrate.unknowns import Unknowns
from posor_estimator.core.calibration.entries import entries_of
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.designs import design
from posor_estimator.core.stack import Stack
from posor_estimator.errors import CalibrationError, FitError

if TYPE_CHECKING:
    from pathlib import Path

    from posor_estimator.core.designs import DesignName


# Which number of the file each parameter is.


@pytest.mark.parametrize("name", STACKS)
def test_every_parameter_is_found_in_the_file(name: DesignName) -> None:
    calibration = design(name)
    stack = Stack([sensor.build() for sensor in calibration.sensors])
    entries = entries_of(calibration)
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


def test_what_a_session_replaces_is_found_there(rig_calibrations: dict[str, Path]) -> None:
    calibration = load_calibration(rig_calibrations["section84"])
    keys = {entry.key for entry in entries_of(calibration, "ymo") if entry is not None}
    assert "sessions.ymo.zero_shifts" in keys
    assert "sensors[0].probes[0].zero_shift" not in keys
    with pytest.raises(CalibrationError, match="session 'none' is unknown"):
        entries_of(calibration, "none")


# What may change.


def test_directions_keep_their_length_and_their_derivatives_are_right(rng: np.random.Generator) -> None:
    unknowns = Unknowns(design("triad_diodes"))
    moved = unknowns.start + 5.0 * unknowns.sigmas * rng.normal(size=len(unknowns))
    stack = Stack([sensor.build() for sensor in design("triad_diodes").sensors])
    values = unknowns.values(moved)
    for sensor in stack.with_parameter_values(values).sensors:
        for name in ("axes", "x_axes", "y_axes", "source_directions"):
            if name in sensor._slices:
                np.testing.assert_allclose(np.linalg.norm(sensor._array(name), axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(unknowns.values(unknowns.start), stack.parameter_values, atol=1e-15)
    step = 1e-4 * unknowns.sigmas
    by_steps = [
        (unknowns.values(moved + shift) - unknowns.values(moved - shift)) / (2.0 * step[i])
        for i, shift in enumerate(np.diag(step))
    ]
    np.testing.assert_allclose(unknowns.basis(moved), np.array(by_steps).T, atol=1e-6)
    assert any(name == "sensors[0].probes[0].axis turn 1" for name in unknowns.names)


def test_only_what_is_asked_for_and_uncertain_may_change() -> None:
    calibration = design("triad_diodes")
    some = Unknowns(calibration, "", ("sensors[0].probes[*].tip", "sensors[0].target_plane.tilt"))
    assert {name.partition("[0].")[2].split("[")[0] for name in some.names} == {"probes", "target_plane.tilt"}
    assert np.all(some.sigmas > 0.0)
    with pytest.raises(FitError, match=r"^calibration 'triad_diodes': '\*\.nose' fits no quantity that has an uncerta"):
        Unknowns(calibration, "", ("*.nose",))
