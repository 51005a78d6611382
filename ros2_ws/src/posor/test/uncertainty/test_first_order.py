# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The first-order budget against the estimator itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from posor.calibration.calibration_file import calibration_from, load_calibration
from posor.calibration.designs import DesignName, design
from posor.calibration.quantity import Quantity
from posor.errors import FitError, ParameterError, ScanError
from posor.estimation.posor import Posor
from posor.model.fault import Fault
from posor.model.native_coordinates import native_from_rotation, native_jacobian
from posor.model.scan import Scans
from posor.numerics.array_types import FloatArray
from posor.uncertainty.budget_poses import middle_pose, pose_from_native, scan_at
from posor.uncertainty.budget_quantities import Outputs, PlatePoint, physical_quantities
from posor.uncertainty.first_order import ContributionKind, error_budget, sensitivities
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.random_poses import STACKS

Differentiate = Callable[[Callable[[FloatArray], float], int], FloatArray]

NATIVE = (2e-5, -1e-5, 0.75e-3, 1e-3, -2e-3, 0.03)
POINTS = (PlatePoint(0.0, 0.0), PlatePoint(-0.0254, 0.0381))
ANGLES = [3, 4, 5]
SHIFT = 1e-7  # of a parameter or a reading: far above rounding, and what it leaves of second order is 1e-5 of it


def judged(posor: Posor, scans: Scans, theta: float) -> FloatArray:
    """What the estimator makes of one scan."""
    found = posor.estimate_each(scans, np.array([theta]))
    return Outputs(posor.stack, POINTS).values(found.rotations[0], found.translations[0])


@pytest.mark.parametrize("stack", STACKS)
def test_derivatives_of_the_outputs(stack: DesignName, central_difference: Differentiate) -> None:
    posor = Posor(design(stack))
    pose = pose_from_native(NATIVE)
    outputs = Outputs(posor.stack, POINTS)
    values = posor.stack.parameter_values
    plane = [i for i, name in enumerate(posor.stack.parameter_names) if ".plane_" in name]

    def moved(motion: FloatArray, at: int) -> float:
        return float(outputs.values(pin.exp3(motion[3:]) @ pose.rotation, pose.translation + motion[:3])[at])

    def otherwise(shift: FloatArray, at: int) -> float:
        changed = values.copy()
        changed[plane] += shift
        other = Outputs(posor.stack.with_parameter_values(changed), POINTS)
        return float(other.values(pose.rotation, pose.translation)[at])

    by_motion = outputs.by_motion(pose.rotation, pose.translation)
    by_parameters = outputs.by_parameters(pose.rotation, pose.translation)
    for at in range(len(outputs.named)):
        found = central_difference(lambda motion, at=at: moved(motion, at), 6)  # type: ignore[misc]
        np.testing.assert_allclose(by_motion[at], found, rtol=0.0, atol=1e-9)
        found = central_difference(lambda shift, at=at: otherwise(shift, at), len(plane))  # type: ignore[misc]
        np.testing.assert_allclose(by_parameters[at, plane], found, rtol=0.0, atol=1e-9)
    others = np.delete(by_parameters, plane, axis=1)
    assert not others.any()


@pytest.mark.long
@pytest.mark.parametrize("stack", STACKS)
def test_sensitivities_agree_with_changed_parameters(stack: DesignName) -> None:
    posor = Posor(design(stack), false_alarm=1e-300)
    pose = pose_from_native(NATIVE)
    scan = scan_at(posor, pose)
    found = sensitivities(posor, scan, pose, POINTS)
    scans = Scans.of([scan])
    values = posor.stack.parameter_values
    with_effect = np.flatnonzero(np.abs(found.by_parameter).max(axis=0) > 1e-12)
    assert with_effect.size > 20
    for at in with_effect:
        shift = np.zeros(values.size)
        shift[at] = SHIFT
        ends = [judged(posor.with_parameter_values(values + sign * shift), scans, NATIVE[5]) for sign in (1.0, -1.0)]
        by_solving = (ends[0] - ends[1]) / (2.0 * SHIFT)
        scale = np.maximum(np.abs(found.by_parameter[:, at]).max(), 1.0)
        np.testing.assert_allclose(found.by_parameter[:, at], by_solving, rtol=1e-3, atol=2e-3 * scale)


@pytest.mark.parametrize("stack", STACKS)
def test_the_budget_agrees_with_the_covariance_of_the_estimator(stack: DesignName) -> None:
    posor = Posor(design(stack))
    pose = pose_from_native(NATIVE)
    scan = scan_at(posor, pose)
    budget = error_budget(posor, scan, pose)
    found = posor.estimate_each(Scans.of([scan]), np.array([NATIVE[5]]))
    by_motion = np.zeros((6, 6))
    by_motion[:3, :3], by_motion[3:, 3:] = np.eye(3), native_jacobian(pose.rotation)
    stated = by_motion @ (found.covariances_random[0] + found.covariances_systematic[0]) @ by_motion.T
    np.testing.assert_allclose(budget.covariance, stated, rtol=1e-6, atol=1e-9 * np.abs(stated).max())
    random = by_motion @ found.covariances_random[0] @ by_motion.T
    np.testing.assert_allclose(budget.root_sum_square(ContributionKind.RANDOM), np.sqrt(np.diagonal(random)), rtol=1e-6)
    np.testing.assert_allclose(budget.root_sum_square(), budget.sigmas, rtol=1e-9)
    np.testing.assert_allclose(budget.shares().sum(axis=0), 1.0, rtol=1e-9)
    np.testing.assert_allclose(budget.values[ANGLES], native_from_rotation(pose.rotation))


def test_every_parameter_belongs_to_one_named_quantity() -> None:
    for stack in STACKS:
        posor = Posor(design(stack))
        quantities = physical_quantities(posor)
        every = sorted(at for quantity in quantities for at in quantity.parameters)
        assert every == list(range(posor.stack.parameters)), stack
        names = [quantity.name for quantity in quantities]
        assert len(set(names)) == len(names)
        assert {"gap_1: tip", "gap_3: supply voltage", "target plane: tilt"} <= set(names)
        # Whatever the words: no array is left to its name in the program.
        assert not [name for name in names if "[" in name], stack
    posor = Posor(design("triad_diodes"))
    tip = next(quantity for quantity in physical_quantities(posor) if quantity.name == "gap_2: tip")
    assert [posor.stack.parameter_names[at] for at in tip.parameters] == [f"GapProbes.tips[1,{i}]" for i in range(3)]


def test_contributions_are_ranked_by_their_largest_share() -> None:
    posor = Posor(design("triad_diodes"))
    pose = middle_pose(posor)
    budget = error_budget(posor, scan_at(posor, pose), pose)
    largest = budget.shares().max(axis=1)
    assert np.all(np.diff(largest) <= 0.0)
    assert budget.contributions[0].name in {"gap_2: tip", "gap_3: tip", "target plane: tilt"}
    assert budget.without_uncertainty == ("target plane: point",)


def test_halving_the_first_contribution_removes_three_quarters_of_its_variance() -> None:
    content = design("triad_diodes").model_dump(mode="json")
    before = _budget_of(content)
    assert "target plane: tilt" in [part.name for part in before.contributions[:3]]
    content["sensors"][0]["target_plane"]["tilt"]["sigma"] = 10e-6
    after = _budget_of(content)
    tilt = next(part for part in before.contributions if part.name == "target plane: tilt")
    gone = np.square(before.sigmas) - np.square(after.sigmas)
    np.testing.assert_allclose(gone[ANGLES], 0.75 * np.square(tilt.effects[ANGLES]), rtol=1e-6)


def _budget_of(content: object):  # type: ignore[no-untyped-def]  # noqa: ANN202  what error_budget returns
    posor = Posor(calibration_from(content))  # type: ignore[arg-type]
    pose = pose_from_native(NATIVE)
    return error_budget(posor, scan_at(posor, pose), pose)


def test_a_light_source_that_is_not_lit_does_not_contribute() -> None:
    posor = Posor(design("triad_light_ring"))
    pose = middle_pose(posor)
    scan = scan_at(posor, pose)
    budget = error_budget(posor, scan, pose)
    lit = {f"source_{source + 1}" for source in scan.lit_sources}
    named = {part.name.split(":")[0] for part in budget.contributions if part.name.startswith("source_")}
    assert named == lit


@pytest.mark.parametrize(
    ("native", "what"),
    [
        ((0.0, 0.0, 0.1), "gap probe 1 is out of its calibrated range at this pose"),
        ((0.05, 0.0, 0.75e-3), "diode 1 is out of its calibrated range"),
    ],
)
def test_a_pose_out_of_range_is_refused(native: tuple[float, float, float], what: str) -> None:
    pose = pose_from_native((*native, 0.0, 0.0, 0.0))
    assert what in refusal(ParameterError, scan_at, Posor(design("triad_diodes")), pose).what


def test_undetermined_degrees_of_freedom_are_refused() -> None:
    content = design("triad_diodes").model_dump(mode="json")
    content["sensors"] = content["sensors"][:1]
    posor = Posor(calibration_from(content))
    pose = pose_from_native(NATIVE)
    error = refusal(FitError, error_budget, posor, scan_at(posor, pose), pose)
    assert "the readings do not determine all six freedoms at this pose" in str(error)


def test_a_scan_that_cannot_be_linearised_is_refused() -> None:
    posor = Posor(design("triad_diodes"))
    pose = pose_from_native(NATIVE)
    scan = Scans.of([scan_at(posor, pose)]).editable()
    scan.gap_voltages[0, 1] = np.nan
    assert refusal(ScanError, error_budget, posor, scan[0], pose).fault == Fault.BAD_READING


@pytest.mark.parametrize("name", ["printed", "section84"])
@pytest.mark.parametrize("session", ["", "ymo", "zmo"])
def test_the_middle_pose_of_the_1985_rig_is_in_range(
    name: str, session: str, rig_calibrations: dict[str, Path]
) -> None:
    posor = Posor(load_calibration(rig_calibrations[name]).for_session(session))
    scan = scan_at(posor, middle_pose(posor))
    middles = [probe.range.array.mean() - probe.zero_shift.number for probe in posor.calibration.sensors[0].probes]  # type: ignore[attr-defined]
    np.testing.assert_allclose(scan.gap_voltages, middles, atol=0.25)


def test_a_reference_of_each_probe_acts_on_a_scan_as_on_the_derivatives() -> None:
    """A fit of all parameters gives each probe its own reference of the supply."""
    calibration = design("triad_diodes")
    references = {"GapProbes.supply[0,1]": 15.02, "GapProbes.supply[1,1]": 14.99, "GapProbes.supply[2,1]": 15.0}
    gap: Any = calibration.sensors[0]
    probes = [
        probe.model_copy(
            update={
                "supply": probe.supply.model_copy(update={"reference": Quantity(value=level, sigma=0.01, unit="V")})
            }
        )
        for probe, level in zip(gap.probes, references.values(), strict=True)
    ]
    posor = Posor(
        calibration.model_copy(
            update={"sensors": [gap.model_copy(update={"probes": probes}), *calibration.sensors[1:]]}
        )
    )
    pose = middle_pose(posor)
    scan = scan_at(posor, pose)
    derivatives = posor.stack.residual_jacobian(scan, pose.rotation, pose.translation)
    for name in references:
        i = posor.stack.parameter_names.index(name)
        changes = np.zeros(len(posor.stack.parameter_values))
        changes[i] = 0.01
        values = [
            posor.stack.with_parameter_values(posor.stack.parameter_values + sign * changes)
            .linearise(Scans.of([scan]))
            .values[0]
            for sign in (1.0, -1.0)
        ]
        found = (values[0] - values[1]) / 0.02
        assert np.abs(derivatives[:, i]).max() > 0.0
        np.testing.assert_allclose(np.abs(found), np.abs(derivatives[:, i]), rtol=1e-6, atol=1e-12)
