"""The steps of a campaign: for each procedure what is moved, what measures it, and how the procedure is asked.

Each step is an afternoon's work on a bench that exists: a stage with an interferometer, an autocollimator, a supply
that can be turned, a cross table with a light, a measuring machine. The reference's uncertainty is stated, and drawn:
one error at each stop, or at each reading where the target is in motion. What is stated but not measured, heights of
leaning, heights and angles of a slide, is off by less than stated.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from posor_estimator.accuracy.poses import draw_poses, readable
from posor_estimator.core.designs import STANDOFF, THETA_OF_TWO_SOURCES
from posor_estimator.core.forward import scans_at
from posor_estimator.core.posor import Posor
from posor_estimator.testing.campaign import held

from posor_bringup.campaign.bench import (
    natives_of,
    pose_reference,
    recorded,
    reference,
    rotations_of,
    scans_of,
    scans_of_one_source,
    scans_of_spots,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.sensors.diodes import Diodes
    from posor_estimator.core.types import FloatArray

    from posor_bringup.campaign.plant import Plant, PosorName

TRAVEL = (0.17e-3, 1.34e-3)
"""Gaps between which the probes are linearised [m]."""
INTERFEROMETER = 50e-9
"""Standard uncertainty of a stop [m]."""
AUTOCOLLIMATOR = 1.5e-6
"""Of a reading [rad]."""
CROSS_TABLE = 0.5e-6
"""Of a stop along each axis [m]."""
MACHINE = (0.3e-6, 3e-6)
"""Of a pose that the measuring machine gives: along [m], about [rad]."""
WOBBLE = 3e-6
"""Of the axis about which the target is turned [rad]."""
LEVEL = (-8e-4, 1.1e-3)
"""Alpha and beta at which the plane that the gap probes look at is level, by the design [rad]."""
LEAN = 5e-3
GRID = 5.2e-3
"""Half the width of the grid of stops on each diode [m]."""
POSES = 120


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes:
        name: Of its bag and of what it leaves.
        procedure: Name of the procedure.
        record: Makes its recording.
        options: Of the procedure.
        instrument: What the reference is measured with; empty: there is none.
        uncertainty: Of the reference, as the command line takes it: one number, or along and about for a pose.
        unit: Of a reference that is a single number.

    """

    name: str
    procedure: str
    record: Callable[[Plant], Recording]
    options: Mapping[str, Any] = field(default_factory=dict)
    instrument: str = ""
    uncertainty: tuple[float, ...] = ()
    unit: str = "m"


def steps_of(name: PosorName) -> tuple[Step, ...]:
    """Return the steps of a campaign, in order; the gap probes drift before the first one whose name has ``drift``."""
    probes = (
        Step("1_gaps", "gap_linearisation", _lift, {"order": 4}, "interferometer", (INTERFEROMETER,)),
        Step("2_supply", "supply_sensitivity", _supply),
        Step("3_spacing", "probe_spacing", _spacing, {}, "autocollimator", (1e-3, AUTOCOLLIMATOR)),
    )
    across = (
        (
            *(
                Step(f"4_map_{k + 1}", "diode_map", _Map(k), {"diode": f"diode_{k + 1}"}, "cross table", (CROSS_TABLE,))
                for k in range(2)
            ),
            Step("5_axes", "diode_axes", _axes, {}, "cross table", (CROSS_TABLE,)),
            Step("6_rays", "light_sources", _rays, {}, "cross table", (CROSS_TABLE, 1e-4)),
        )
        if name == "triad_diodes"
        else (Step("4_ring", "ring_profile", _ring, {"theta": "/reference"}, "index table", (2e-6,), "rad"),)
    )
    return (
        *probes,
        *across,
        Step("7_plane", "target_plane", _turn, {"wobble_sigma": WOBBLE}),
        Step("8_drift", "zero_drift", _drift, {}, "autocollimator", (1e-6, AUTOCOLLIMATOR)),
        Step("9_bundle", "bundle", _bundle, {"least_stop": 0.1, "loss": "linear"}, "measuring machine", MACHINE),
    )


def _lift(plant: Plant) -> Recording:
    """The target, its surface set level, is lifted; an interferometer says how far."""
    random = plant.random("lift")
    gaps = np.linspace(*TRAVEL, 25)
    path = held(np.column_stack([gaps, gaps + INTERFEROMETER * random.normal(size=len(gaps))]), 20)
    natives = np.zeros((len(path), 6))
    natives[:, 2] = path[:, 0]
    natives[:, 3:5] = LEVEL
    return recorded(scans_of(plant.first_day, natives, random), reference(path[:, 1:], np.array([INTERFEROMETER])))


def _supply(plant: Plant) -> Recording:
    """The supply is turned from level to level; the target rests."""
    random = plant.random("supply")
    levels = held(np.linspace(14.4, 15.6, 9)[:, None], 40)
    natives = np.tile([0.0, 0.0, STANDOFF, 0.0, 0.0, 0.0], (len(levels), 1))
    return recorded(scans_of(plant.first_day, natives, random, levels[:, 0]), None)


def _spacing(plant: Plant) -> Recording:
    """The target is leant; an autocollimator says how far, its height is not measured."""
    random = plant.random("spacing")
    sides = np.linspace(-LEAN, LEAN, 7)
    none = np.zeros(7)
    leans = np.concatenate([np.column_stack([sides, none]), np.column_stack([none, sides])])
    shown = leans + AUTOCOLLIMATOR * random.normal(size=leans.shape)
    heights = STANDOFF + 20e-6 * random.normal(size=(len(leans), 1))
    path = held(np.hstack([leans, heights, shown]), 20)
    natives, told = np.zeros((2, len(path), 6))
    natives[:, 2:5] = path[:, [2, 0, 1]]
    told[:, 2], told[:, 3:5] = STANDOFF, path[:, 3:]
    return recorded(scans_of(plant.first_day, natives, random), pose_reference(told, 1e-3, AUTOCOLLIMATOR))


@dataclass(frozen=True)
class _Map:
    """A cross table carries a light over one diode, from stop to stop of a grid."""

    diode: int

    def __call__(self, plant: Plant) -> Recording:
        random = plant.random(f"map {self.diode}")
        at = np.linspace(-GRID, GRID, 11)
        grid = np.array([(x, y) for n, x in enumerate(at) for y in (at if n % 2 == 0 else at[::-1])])
        true = grid + CROSS_TABLE * random.normal(size=grid.shape)
        path = held(np.hstack([true, grid]), 12, 2)
        told = np.column_stack([path[:, 2:], np.zeros(len(path))])
        scans = scans_of_spots(_diodes(plant), self.diode, path[:, :2], random)
        return recorded(scans, reference(told, np.full(3, CROSS_TABLE)))


def _axes(plant: Plant) -> Recording:
    """A cross table, set up by hand, carries the target so that one of its lights crosses each diode."""
    random = plant.random("axes")
    at = np.linspace(-4e-3, 4e-3, 6)
    field = np.array([(x, y, 0.0) for n, x in enumerate(at) for y in (at if n % 2 == 0 else at[::-1])])
    stops = np.concatenate([field, field - [0.0, 0.0762, 0.0]])
    true = stops + CROSS_TABLE * random.normal(size=stops.shape)
    heading, set_up = 2e-3 * random.normal(), 2e-4 * random.normal(size=2)
    turn = rotations_of(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, heading]]))[0]
    path = held(np.hstack([true @ turn.T + [*set_up, STANDOFF], stops]), 12, 2)
    scans = scans_of_one_source(_diodes(plant), path[:, :3], 0, random)
    return recorded(scans, reference(path[:, 3:], np.full(3, CROSS_TABLE)))


def _rays(plant: Plant) -> Recording:
    """The target is carried away from the diodes on a slide that is not square, then turned round and again."""
    random = plant.random("rays")
    heights = np.linspace(0.0, 12e-3, 7)
    # Turned round, the lights of the two diodes change places; the target is moved over so that they meet them again.
    seats = [(0.0, 0.0), (np.pi, -0.0508)]
    told = np.array([[x, 0.0, height, 0.0, 0.0, theta] for theta, x in seats for height in heights])
    lean = 1.5e-3 * random.normal(size=2)
    true = told.copy()
    true[:, :2] += np.repeat(100e-6 * random.normal(size=(2, 2)), len(heights), axis=0) + told[:, 2:3] * lean
    true[:, :2] += CROSS_TABLE * random.normal(size=(len(told), 2))
    path = held(np.hstack([true, told]), 15, 2)
    scans = scans_of(plant.first_day, path[:, :6], random)
    scans = scans.with_fields({"gap_voltages": np.empty((len(scans), 0))})  # the target is out of the gap probes' reach
    return recorded(scans, pose_reference(path[:, 6:], CROSS_TABLE, 1e-4))


def _ring(plant: Plant) -> Recording:
    """The target turns round and round on a bearing that runs out; an index table says how far."""
    random = plant.random("ring")
    thetas = np.linspace(0.0, 4.0 * np.pi, 480)
    natives = np.zeros((len(thetas), 6))
    turn = np.column_stack([np.cos(thetas), np.sin(thetas), np.cos(2.0 * thetas), np.sin(2.0 * thetas)])
    natives[:, :2] = turn @ (2e-6 * random.normal(size=(4, 2)))
    natives[:, 2] = STANDOFF
    natives[:, 3:5] = turn @ (5e-6 * random.normal(size=(4, 2)))
    natives[:, 5] = thetas
    said = thetas + 2e-6 * random.normal(size=len(thetas))
    return recorded(scans_of(plant.first_day, natives, random), reference(said[:, None], np.array([2e-6])))


def _turn(plant: Plant) -> Recording:
    """The target turns about an axis that leans and keeps its direction but for its wobble."""
    random = plant.random("turn")
    if plant.name == "triad_diodes":
        thetas = 0.9 * THETA_OF_TWO_SOURCES * np.sin(np.linspace(0.0, 2.0 * np.pi, 200))
    else:
        thetas = np.linspace(0.0, 2.0 * np.pi, 300)
    natives = np.zeros((len(thetas), 6))
    natives[:, 2] = STANDOFF
    natives[:, 3:5] = 1e-3 * random.normal(size=2) + WOBBLE * random.normal(size=(len(thetas), 2))
    natives[:, 5] = thetas
    return recorded(scans_of(plant.first_day, natives, random), None)


def _drift(plant: Plant) -> Recording:
    """On a later day the target leans along a figure of eight; an autocollimator watches it."""
    random = plant.random("drift")
    phase = np.linspace(0.0, 2.0 * np.pi, 200)
    natives = np.zeros((len(phase), 6))
    natives[:, 2] = STANDOFF
    natives[:, 3], natives[:, 4] = LEAN * np.sin(phase), LEAN * np.sin(2.0 * phase + 0.4)
    told = natives.copy()
    told[:, 3:] += AUTOCOLLIMATOR * random.normal(size=(len(phase), 3))
    told[:, :3] += 1e-6 * random.normal(size=(len(phase), 3))
    return recorded(scans_of(plant.later, natives, random), pose_reference(told, 1e-6, AUTOCOLLIMATOR))


def _bundle(plant: Plant) -> Recording:
    """A measuring machine sets poses all over the range of the sensors, and says what they are."""
    random = plant.random("bundle")
    poses = poses_in_range(plant, POSES, random)
    told = poses.copy()
    told[:, :3] += MACHINE[0] * random.normal(size=(POSES, 3))
    told[:, 3:] += MACHINE[1] * random.normal(size=(POSES, 3))
    path = held(np.hstack([poses, told]), 10, 2)
    return recorded(scans_of(plant.later, path[:, :6], random), pose_reference(path[:, 6:], *MACHINE))


def poses_in_range(plant: Plant, count: int, random: np.random.Generator) -> FloatArray:
    """Return native coordinates (n, 6) of random poses at which every sensor of the true POSOR can read."""
    found = np.empty((0, 6))
    narrow = Posor(plant.known).stack
    while len(found) < count:
        rotations, translations = draw_poses(plant.name, count, random)
        stamps = np.arange(count, dtype=np.int64)
        good = np.ones(count, dtype=bool)
        for stack in (plant.later, narrow):
            good &= readable(scans_at(stack, rotations, translations, stamps))
        good &= _within_travel(plant, rotations, translations)
        found = np.concatenate([found, natives_of(rotations[good], translations[good])])
    return found[:count]


def _within_travel(plant: Plant, rotations: FloatArray, translations: FloatArray) -> FloatArray:
    """Return whether the gap probes see gaps at which they were linearised, with some to spare, (n,)."""
    volts = scans_at(plant.first_day, rotations, translations, np.arange(len(rotations), dtype=np.int64)).gap_voltages
    return np.asarray(np.all(np.abs(volts) < 4.2, axis=1))  # noqa: PLR2004  of some 4.8 V at the ends of the travel


def _diodes(plant: Plant) -> Diodes:
    sensor: Any = plant.first_day.sensors[1]
    return sensor  # type: ignore[no-any-return]
