# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of the estimator's model against the independent truth, and against ray-traced cases.

A calibration of a design is made generic: every uncertain value is off by several of its standard uncertainties, so
that no parameter is zero, and some values are written in mm, um and deg. Both models read its text. Scans without noise
come from the independent truth; supply and temperature are measured and differ from their references.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin
import yaml
from posor.calibration.calibration_file import parse_calibration
from posor.calibration.designs import THETA_OF_TWO_SOURCES, DesignName, design
from posor.chain.arm_file import load_arm_file
from posor.errors import PosorError
from posor.estimation.forward import empty_scans
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES
from posor.model.native_coordinates import rotation_from_native
from posor.numerics.vector import thetas_of
from scipy.spatial.transform import Rotation

from posor_lab.accuracy.golden_command import StackName, case_errors, read_cases
from posor_lab.harness.random_poses import errors_in_parent
from posor_lab.independent.true_arm import TrueArm
from posor_lab.independent.true_joint import TrueJoint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from posor.chain.kinematic_chain import Chain
    from posor.estimation.estimate import Estimates
    from posor.numerics.array_types import FloatArray

    from posor_lab.independent.true_arm import TrueLink

STACKS: tuple[DesignName, ...] = (
    "triad_diodes",
    "triad_light_ring",
    "triad_bumpy_ring",
    "quad_diodes",
    "quad_light_ring",
    "quad_bumpy_ring",
)
ARMS = ("five_axis", "six_axis", "test_rig")
GOLDEN_CASES = Path(__file__).resolve().parents[4] / "ros2_ws/src/posor/test/data/posor_cases.jsonl"
GOLDEN_STACKS: tuple[StackName, ...] = ("triad_diodes", "triad_bumpy_ring")

SEED, POSES = 1985, 5
SPREAD = 10.0
"""Standard uncertainties by which the values of a generic calibration are off."""
POINT = [1e-4, -2e-4, 3e-5]
"""Of the generic target plane [m], which designs take for exact."""
LEAN, RUNOUT = 2e-3, 1e-4  # largest lean [rad] and runout [m] of the poses
GAPS = (0.5e-3, 0.9e-3)  # [m]
SUPPLIES, TEMPERATURES = (14.7, 15.3), (285.0, 301.0)
POSE_LIMIT = 0.1
"""Largest deviation of a pose, in standard uncertainties that the estimator states."""
RESIDUAL_LIMIT = 0.1
"""Largest chi-square of the redundant readings of a scan without noise."""
ENDPOINT_LIMIT = 0.1
"""Largest deviation of an endpoint, in the standard uncertainties of its beams."""
COVARIANCE_STACKS: tuple[DesignName, ...] = ("quad_diodes", "quad_bumpy_ring")
ERROR_SHARE = 0.1
"""Size of the errors in standard uncertainties: the slope of a ring's bumps changes within one of them."""
COVARIANCE_LIMIT = 0.01
"""Largest deviation of a covariance, as a share of the product of two standard deviations."""
JOINT_ERROR = 2e-7  # size of the errors of joints in the covariance of an endpoint [m], [rad]
GOLDEN_LIMIT = 1e-9  # largest deviation from ray-traced poses and readings [m], [rad]
_CONVERTED = {"tip": ("mm", 1e3), "origin": ("mm", 1e3), "tilt": ("deg", 180.0 / math.pi), "mean_radius": ("um", 1e6)}
"""Units of some quantities in a generic file, and how many of them one SI unit is."""
_DIRECTIONS = ("axis", "x_axis", "y_axis", "direction")


class CheckResult(NamedTuple):
    """Outcome of a check."""

    figure: float  # infinite where an error stopped the check
    limit: float
    error: str = ""

    @property
    def holds(self) -> bool:
        """Whether the model agrees."""
        return self.figure <= self.limit


def generic_file(name: DesignName) -> str:
    """Return the text of a generic calibration file of a design."""
    content = design(name).model_dump(mode="json", exclude_none=True)
    random = np.random.default_rng([SEED, *name.encode()])
    for sensor in content["sensors"]:
        _make_generic(sensor, random)
        if "target_plane" in sensor:
            sensor["target_plane"]["point"]["value"] = POINT
    return yaml.safe_dump(content, sort_keys=False)


def _make_generic(entry: Any, random: np.random.Generator, key: str = "") -> None:
    """Shift the values of all quantities, and write some of them in other units."""
    if isinstance(entry, list):
        for each in entry:
            _make_generic(each, random, key)
    elif isinstance(entry, dict) and "unit" in entry:
        values = np.array(entry["value"])
        values = values + SPREAD * np.array(entry["sigma"]) * random.uniform(-1.0, 1.0, values.shape)
        if key in _DIRECTIONS:
            values /= np.linalg.norm(values)
        unit, factor = _CONVERTED.get(key, (entry["unit"], 1.0))
        entry.update(value=(factor * values).tolist(), sigma=(factor * np.array(entry["sigma"])).tolist(), unit=unit)
    elif isinstance(entry, dict):
        for name, each in entry.items():
            _make_generic(each, random, name)


def draw_poses(name: DesignName, count: int, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return poses of the target plate in the range of use of a design, (n, 3, 3), (n, 3) [m]."""
    most = 0.5 * THETA_OF_TWO_SOURCES if name.endswith("_diodes") else math.pi
    natives = np.column_stack([random.uniform(-LEAN, LEAN, (count, 2)), random.uniform(-most, most, count)])
    rotations = np.array([rotation_from_native(*native) for native in natives])
    return rotations, np.column_stack([random.uniform(-RUNOUT, RUNOUT, (count, 2)), random.uniform(*GAPS, count)])


class _Case:
    """Poses of a design with its generic calibration, and the estimates of scans of the independent truth."""

    def __init__(self, name: DesignName, count: int) -> None:
        random = np.random.default_rng([SEED, *name.encode()])
        text = generic_file(name)
        self._truth = TrueJoint(yaml.safe_load(text))
        self.posor = Posor(parse_calibration(text, name), false_alarm=0.0)
        self.rotations, self.translations = draw_poses(name, count, random)
        self._supplies, self._temperatures = (random.uniform(*each, count) for each in (SUPPLIES, TEMPERATURES))

    def estimates(self, errors: Mapping[str, float] | None = None) -> Estimates:
        """Return the estimates without noise of a POSOR that differs from its file by errors, see ``with_errors``."""
        stated = {"supply_voltages": self._supplies, "temperatures": self._temperatures}
        real = self._truth.with_errors(errors or {})
        readings = real.readings(self.rotations, self.translations, self._supplies, self._temperatures)
        scans = empty_scans(np.arange(1, len(self.rotations) + 1)).with_fields(stated | readings)
        return self.posor.estimate_each(scans, thetas_of(self.rotations))


def compare_stack(name: DesignName, count: int) -> dict[str, CheckResult]:
    """Return the checks of a design: poses and residuals of the estimator with scans of the independent truth."""
    case = _Case(name, count)
    found, rotations, translations = case.estimates(), case.rotations, case.translations
    if not np.isin(found.states, USABLE_STATES).all():
        nothing = CheckResult(math.inf, 0.0, "no pose")
        return {f"pose {name}": nothing, f"residual {name}": nothing}
    errors = errors_in_parent(found.rotations, found.translations, rotations, translations)
    sigmas = np.sqrt(np.diagonal(found.covariances_random + found.covariances_systematic, axis1=1, axis2=2))
    return {
        f"pose {name}": CheckResult(float(np.max(np.abs(errors / sigmas))), POSE_LIMIT),
        f"residual {name}": CheckResult(float(np.max(found.residuals)), RESIDUAL_LIMIT),
    }


def compare_covariance(name: DesignName) -> dict[str, CheckResult]:
    """Return the check of the systematic covariance at one pose: against an error of one parameter after another.

    The figure is the largest deviation of an entry, in the standard deviations of row and column.
    """
    case, stack = _Case(name, 1), Posor(design(name)).stack
    right, covariance = case.estimates(), np.zeros((6, 6))
    place = right.rotations, right.translations
    for parameter, sigma in zip(stack.parameter_names, stack.parameter_sigmas.tolist(), strict=True):
        if sigma > 0.0:
            wrong = case.estimates({parameter: ERROR_SHARE * sigma})
            error = errors_in_parent(wrong.rotations, wrong.translations, *place)[0] / ERROR_SHARE
            covariance += np.outer(error, error)
    sigmas = np.sqrt(np.diagonal(covariance))
    deviation = (right.covariances_systematic[0] - covariance) / np.outer(sigmas, sigmas)
    return {f"covariance {name}": CheckResult(float(np.max(np.abs(deviation))), COVARIANCE_LIMIT)}


def compare_arm(name: str, count: int) -> dict[str, CheckResult]:
    """Return the checks of an arm: its endpoint with exact poses of its joints, and the covariance of the endpoint."""
    arm = load_arm_file(name)
    truth, chain, random = TrueArm(arm.path), arm.chain(), np.random.default_rng([SEED, *name.encode()])
    poses = [[_near(origin, random) for origin in truth.origins] for _ in range(count)]
    rotations = np.array([[pose.rotation for pose in row] for row in poses])
    translations = np.array([[pose.translation for pose in row] for row in poses])
    measured = np.array([[pin.SE3ToXYZQUAT(pose) for pose in row] for row in poses])
    joints = JOINT_ERROR * random.normal(size=(2, len(truth.joints), 6, 6))
    covariances = np.broadcast_to((joints @ np.swapaxes(joints, 2, 3))[:, None], (2, count, *joints.shape[1:]))
    found = chain.estimate_all(measured, *np.ascontiguousarray(covariances))
    turns, shifts = Rotation.from_quat(found.poses[:, 3:]).as_matrix(), found.poses[:, :3]
    errors = errors_in_parent(turns, shifts, *truth.endpoints(rotations, translations))
    place = rotations[:1], translations[:1]
    by_joints, by_beams = (effects.T @ effects for effects in _endpoint_effects(truth, chain, place, joints))
    expected, beams = by_joints + by_beams, np.sqrt(np.diagonal(by_beams))
    sigmas = np.sqrt(np.diagonal(expected))
    deviation = (found.covariances()[0] - expected) / np.outer(sigmas, sigmas)
    return {
        f"endpoint {name}": CheckResult(float(np.max(np.abs(errors / beams))), ENDPOINT_LIMIT),
        f"endpoint covariance {name}": CheckResult(float(np.max(np.abs(deviation))), COVARIANCE_LIMIT),
    }


def _endpoint_effects(
    truth: TrueArm, chain: Chain, place: tuple[FloatArray, FloatArray], joints: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the errors of the endpoint at a pose by one error after another: of joints, and of beams, (k, 6) each.

    ``joints`` (2, j, 6, 6): errors of each joint, in columns. Errors of beams are one standard uncertainty.
    """
    right = truth.endpoints(*place)
    by_joints, by_beams = [], []
    for part, j, column in np.ndindex(joints.shape[:3]):
        shift = joints[part, j, :, column]
        rotations, translations = place[0].copy(), place[1].copy()
        rotations[0, j] = pin.exp3(shift[3:]) @ rotations[0, j]
        translations[0, j] += shift[:3]
        by_joints.append(errors_in_parent(*truth.endpoints(rotations, translations), *right)[0])
    for i, link in enumerate(chain.links):
        if link.beam is not None:
            for wrong in _wrong_links(truth.links[i], np.sqrt(np.diagonal(link.beam.covariance)), link.beam.sag_sigma):
                other = copy(truth)
                other.links = (*truth.links[:i], wrong, *truth.links[i + 1 :])
                by_beams.append(errors_in_parent(*other.endpoints(*place), *right)[0])
    return np.array(by_joints), np.array(by_beams)


def _wrong_links(link: TrueLink, sigmas: FloatArray, sag_sigma: float) -> Iterator[TrueLink]:
    """Yield a link with an error of each coordinate of its end, and one with an error of its sag."""
    for shift in np.diag(sigmas):
        end = pin.SE3(pin.exp3(shift[3:]) @ link.end.rotation, link.end.translation + shift[:3])
        yield replace(link, end=end)
    scale = 1.0 + sag_sigma
    yield replace(link, start_gain=scale * link.start_gain, end_gain=scale * link.end_gain)


def _near(origin: pin.SE3, random: np.random.Generator) -> pin.SE3:
    """Return a pose of a joint: any angle up to 1.5 rad, small lean and runout."""
    turn = pin.utils.rotate("z", random.uniform(-1.5, 1.5)) @ pin.exp3(1e-4 * random.normal(size=3))
    return origin * pin.SE3(turn, 2e-5 * random.normal(size=3))


def compare_golden(stack: StackName, count: int) -> dict[str, CheckResult]:
    """Return the check of ray-traced cases."""
    errors = [case_errors(case) for case in islice(read_cases(GOLDEN_CASES, stack), count)]
    return {f"golden {stack}": CheckResult(float(np.max(errors)), GOLDEN_LIMIT)}


def run_checks(*, covariances: bool) -> dict[str, CheckResult]:
    """Return the checks; an error of the product fails the check in which it occurs.

    ``covariances``: whether to include those of covariances, which take ten times as long as the others.
    """
    checks: dict[str, Callable[[], dict[str, CheckResult]]] = {
        **{f"pose {name}": partial(compare_stack, name, POSES) for name in STACKS},
        **{f"endpoint {name}": partial(compare_arm, name, POSES) for name in ARMS},
        **{f"golden {name}": partial(compare_golden, name, POSES) for name in GOLDEN_STACKS},
        **{f"covariance {name}": partial(compare_covariance, name) for name in COVARIANCE_STACKS if covariances},
    }
    results: dict[str, CheckResult] = {}
    for name, check in checks.items():
        try:
            results |= check()
        except PosorError as error:
            results[name] = CheckResult(math.inf, 0.0, str(error))
    return results
