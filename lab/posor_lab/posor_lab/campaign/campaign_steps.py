# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The steps of a campaign: for each procedure the motion, the reference instrument and the options.

Each step is an afternoon's work on an existing rig: a stage with an interferometer, an autocollimator, an adjustable
supply, a cross table with a light, a measuring machine. The uncertainty of a reference is stated and drawn: one error
for each dwell, or for each reading in motion. Quantities that are stated but not measured (heights of tilted targets,
height and angles of a slide) have smaller errors than stated.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.calibration.designs import STANDOFF, THETA_OF_TWO_SOURCES
from posor.estimation.posor import Posor

from posor_lab.campaign.calibration_rig import (
    natives_of_poses,
    pose_reference_track,
    record_scans,
    reference_track,
    rotations_of_natives,
    simulate_scans,
    simulate_single_source_scans,
    simulate_spot_scans,
)
from posor_lab.harness.random_poses import draw_poses, readable
from posor_lab.harness.simulated_recordings import dwell_path

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from posor.bags.recording import Recording
    from posor.numerics.array_types import BoolArray, FloatArray

    from posor_lab.campaign.ground_truth import GroundTruth, PosorName

TRAVEL = (0.17e-3, 1.34e-3)  # gaps between which the probes are linearised [m]
INTERFEROMETER = 50e-9  # standard uncertainty of a dwell [m]
AUTOCOLLIMATOR = 1.5e-6  # standard uncertainty of a reading [rad]
CROSS_TABLE = 0.5e-6  # standard uncertainty of a dwell along each axis [m]
INDEX_TABLE = 2e-6  # standard uncertainty of a reading [rad]
MACHINE = (0.3e-6, 3e-6)  # standard uncertainty of a pose of the measuring machine [m], [rad]
WOBBLE = 3e-6  # wobble of the axis about which the target is turned [rad]
LEVEL = (-8e-4, 1.1e-3)  # alpha and beta at which the target plane of the gap probes is level, by design [rad]
LEAN = 5e-3
GRID = 5.2e-3  # half-width of the grid of dwells on each diode [m]
POSES = 120
USABLE_VOLTS = 4.2  # largest voltage of a gap probe at random poses; the ends of the travel are at some 4.8 V


@dataclass(frozen=True)
class CampaignStep:
    """One step."""

    name: str  # name of its bag and of its output files
    procedure: str  # name of the procedure
    record: Callable[[GroundTruth], Recording]  # returns its recording
    options: Mapping[str, Any] = field(default_factory=dict)  # options of the procedure
    instrument: str = ""  # instrument of the reference; empty: no reference
    uncertainty: tuple[float, ...] = ()  # of the reference: one number, or translation and rotation of a pose
    unit: str = "m"  # unit of a reference that is a single number


def campaign_steps(name: PosorName) -> tuple[CampaignStep, ...]:
    """Return the steps of a campaign, in order; the zeros of the gap probes drift before ``8_drift``."""
    step, table = CampaignStep, (CROSS_TABLE,)
    sensor_steps: tuple[CampaignStep, ...]
    if name == "triad_diodes":
        sensor_steps = (
            step("4_map_1", "diode_map", partial(_diode_map, 0), {"diode": "diode_1"}, "cross table", table),
            step("4_map_2", "diode_map", partial(_diode_map, 1), {"diode": "diode_2"}, "cross table", table),
            step("5_axes", "diode_axes", _diode_axes, {}, "cross table", table),
            step("6_rays", "light_sources", _light_sources, {}, "cross table", (CROSS_TABLE, 1e-4)),
        )
    else:
        options = {"theta": "/reference"}
        sensor_steps = (step("4_ring", "ring_profile", _ring_profile, options, "index table", (INDEX_TABLE,), "rad"),)
    return (
        step("1_gaps", "gap_linearisation", _gap_linearisation, {"order": 4}, "interferometer", (INTERFEROMETER,)),
        step("2_supply", "supply_sensitivity", _supply_sensitivity),
        step("3_spacing", "probe_spacing", _probe_spacing, {}, "autocollimator", (1e-3, AUTOCOLLIMATOR)),
        *sensor_steps,
        step("7_plane", "target_plane", _target_plane, {"wobble_sigma": WOBBLE}),
        step("8_drift", "zero_drift", _zero_drift, {}, "autocollimator", (1e-6, AUTOCOLLIMATOR)),
        step("9_bundle", "bundle", _bundle, {"least_dwell": 0.1, "loss": "linear"}, "measuring machine", MACHINE),
    )


def _gap_linearisation(truth: GroundTruth) -> Recording:
    """Lift the target with its surface level; the reference is an interferometer."""
    random = truth.random("lift")
    gaps = np.linspace(*TRAVEL, 25)
    path = dwell_path(np.column_stack([gaps, gaps + INTERFEROMETER * random.normal(size=len(gaps))]), 20)
    natives = np.zeros((len(path), 6))
    natives[:, 2] = path[:, 0]
    natives[:, 3:5] = LEVEL
    scans = simulate_scans(truth.real, truth.first_day, natives, random)
    return record_scans(scans, reference_track(path[:, 1:], np.array([INTERFEROMETER])))


def _supply_sensitivity(truth: GroundTruth) -> Recording:
    """Change the supply from level to level; the target is at rest."""
    random = truth.random("supply")
    levels = dwell_path(np.linspace(14.4, 15.6, 9)[:, None], 40)
    natives = np.tile([0.0, 0.0, STANDOFF, 0.0, 0.0, 0.0], (len(levels), 1))
    return record_scans(simulate_scans(truth.real, truth.first_day, natives, random, levels[:, 0]), None)


def _probe_spacing(truth: GroundTruth) -> Recording:
    """Tilt the target; the reference is an autocollimator, the height is not measured."""
    random = truth.random("spacing")
    sides, zeros = np.linspace(-LEAN, LEAN, 7), np.zeros(7)
    leans = np.concatenate([np.column_stack([sides, zeros]), np.column_stack([zeros, sides])])
    shown = leans + AUTOCOLLIMATOR * random.normal(size=leans.shape)
    heights = STANDOFF + 20e-6 * random.normal(size=(len(leans), 1))
    path = dwell_path(np.hstack([leans, heights, shown]), 20)
    natives, measured = np.zeros((2, len(path), 6))
    natives[:, 2:5] = path[:, [2, 0, 1]]
    measured[:, 2], measured[:, 3:5] = STANDOFF, path[:, 3:]
    scans = simulate_scans(truth.real, truth.first_day, natives, random)
    return record_scans(scans, pose_reference_track(measured, 1e-3, AUTOCOLLIMATOR))


def _meander(half_width: float, count: int) -> FloatArray:
    """Return the points (count^2, 2) of a square grid, neighbours one after the other."""
    at = np.linspace(-half_width, half_width, count)
    return np.array([(x, y) for n, x in enumerate(at) for y in (at if n % 2 == 0 else at[::-1])])


def _diode_map(diode: int, truth: GroundTruth) -> Recording:
    """Move a light over one diode by a cross table, from dwell to dwell of a grid."""
    random = truth.random(f"map {diode}")
    grid = _meander(GRID, 11)
    path = dwell_path(np.hstack([grid + CROSS_TABLE * random.normal(size=grid.shape), grid]), 12, 2)
    measured = np.column_stack([path[:, 2:], np.zeros(len(path))])
    scans = simulate_spot_scans(truth.real, truth.first_day, diode, path[:, :2], random)
    return record_scans(scans, reference_track(measured, np.full(3, CROSS_TABLE)))


def _diode_axes(truth: GroundTruth) -> Recording:
    """Move the target by a cross table that is set up by hand, so that one of its lights crosses each diode."""
    random = truth.random("axes")
    grid = np.column_stack([_meander(4e-3, 6), np.zeros(36)])
    dwells = np.concatenate([grid, grid - [0.0, 0.0762, 0.0]])
    true = dwells + CROSS_TABLE * random.normal(size=dwells.shape)
    heading, offset = 2e-3 * random.normal(), 2e-4 * random.normal(size=2)
    turn = rotations_of_natives(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, heading]]))[0]
    path = dwell_path(np.hstack([true @ turn.T + [*offset, STANDOFF], dwells]), 12, 2)
    scans = simulate_single_source_scans(truth.real, truth.first_day, path[:, :3], 0, random)
    return record_scans(scans, reference_track(path[:, 3:], np.full(3, CROSS_TABLE)))


def _light_sources(truth: GroundTruth) -> Recording:
    """Move the target away from the diodes on a slide that is not square; turn it by half a turn and repeat."""
    random = truth.random("rays")
    heights = np.linspace(0.0, 12e-3, 7)
    # After half a turn the lights of the diodes change places; the target is shifted so that they meet them again.
    seats = [(0.0, 0.0), (np.pi, -0.0508)]
    measured = np.array([[x, 0.0, height, 0.0, 0.0, theta] for theta, x in seats for height in heights])
    lean = 1.5e-3 * random.normal(size=2)
    true = measured.copy()
    true[:, :2] += np.repeat(100e-6 * random.normal(size=(2, 2)), len(heights), axis=0) + measured[:, 2:3] * lean
    true[:, :2] += CROSS_TABLE * random.normal(size=(len(measured), 2))
    path = dwell_path(np.hstack([true, measured]), 15, 2)
    scans = simulate_scans(truth.real, truth.first_day, path[:, :6], random)
    scans = scans.with_fields({"gap_voltages": np.empty((len(scans), 0))})  # the target is beyond the gap probes
    return record_scans(scans, pose_reference_track(path[:, 6:], CROSS_TABLE, 1e-4))


def _ring_profile(truth: GroundTruth) -> Recording:
    """Turn the target twice on a bearing with runout; the reference is an index table."""
    random = truth.random("ring")
    thetas = np.linspace(0.0, 4.0 * np.pi, 480)
    natives = np.zeros((len(thetas), 6))
    harmonics = np.column_stack([np.cos(thetas), np.sin(thetas), np.cos(2.0 * thetas), np.sin(2.0 * thetas)])
    natives[:, :2] = harmonics @ (2e-6 * random.normal(size=(4, 2)))
    natives[:, 2] = STANDOFF
    natives[:, 3:5] = harmonics @ (5e-6 * random.normal(size=(4, 2)))
    natives[:, 5] = thetas
    measured = thetas + INDEX_TABLE * random.normal(size=len(thetas))
    scans = simulate_scans(truth.real, truth.first_day, natives, random)
    return record_scans(scans, reference_track(measured[:, None], np.array([INDEX_TABLE])))


def _target_plane(truth: GroundTruth) -> Recording:
    """Turn the target about an axis that is inclined and keeps its direction except for its wobble."""
    random = truth.random("turn")
    if truth.name == "triad_diodes":
        thetas = 0.9 * THETA_OF_TWO_SOURCES * np.sin(np.linspace(0.0, 2.0 * np.pi, 200))
    else:
        thetas = np.linspace(0.0, 2.0 * np.pi, 300)
    natives = np.zeros((len(thetas), 6))
    natives[:, 2] = STANDOFF
    natives[:, 3:5] = 1e-3 * random.normal(size=2) + WOBBLE * random.normal(size=(len(thetas), 2))
    natives[:, 5] = thetas
    return record_scans(simulate_scans(truth.real, truth.first_day, natives, random), None)


def _zero_drift(truth: GroundTruth) -> Recording:
    """Tilt the target along a figure of eight on a later day; the reference is an autocollimator."""
    random = truth.random("drift")
    phase = np.linspace(0.0, 2.0 * np.pi, 200)
    natives = np.zeros((len(phase), 6))
    natives[:, 2] = STANDOFF
    natives[:, 3], natives[:, 4] = LEAN * np.sin(phase), LEAN * np.sin(2.0 * phase + 0.4)
    measured = natives.copy()
    measured[:, 3:] += AUTOCOLLIMATOR * random.normal(size=(len(phase), 3))
    measured[:, :3] += 1e-6 * random.normal(size=(len(phase), 3))
    return record_scans(
        simulate_scans(truth.real, truth.later, natives, random), pose_reference_track(measured, 1e-6, AUTOCOLLIMATOR)
    )


def _bundle(truth: GroundTruth) -> Recording:
    """Set poses over the whole range of the sensors by a measuring machine."""
    random = truth.random("bundle")
    poses = draw_native_poses(truth, POSES, random)
    measured = poses.copy()
    measured[:, :3] += MACHINE[0] * random.normal(size=(POSES, 3))
    measured[:, 3:] += MACHINE[1] * random.normal(size=(POSES, 3))
    path = dwell_path(np.hstack([poses, measured]), 10, 2)
    scans = simulate_scans(truth.real, truth.later, path[:, :6], random)
    return record_scans(scans, pose_reference_track(path[:, 6:], *MACHINE))


def draw_native_poses(truth: GroundTruth, count: int, random: np.random.Generator) -> FloatArray:
    """Return native coordinates (n, 6) of random poses at which every sensor of the true POSOR can read."""
    poses = np.empty((0, 6))
    as_built = Posor(truth.as_built).stack
    stamps = np.arange(count, dtype=np.int64)
    while len(poses) < count:
        rotations, translations = draw_poses(truth.name, count, random)
        usable: BoolArray = np.ones(count, dtype=bool)
        for stack in (truth.later, as_built):
            usable &= readable(truth.real.scans_at(stack, rotations, translations, stamps))
        volts = truth.real.scans_at(truth.first_day, rotations, translations, stamps).gap_voltages
        usable &= np.all(np.abs(volts) < USABLE_VOLTS, axis=1)
        poses = np.concatenate([poses, natives_of_poses(rotations[usable], translations[usable])])
    return poses[:count]
