# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Backlash, error motions and bending of the simulated arm against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from posor_drivers.simulator.imperfections import RandomStream
from posor_drivers.simulator.mechanics import (
    LinkCompliance,
    apply_backlash,
    bearing_error_motions,
    bend_links,
    quantise_encoder,
)
from posor_drivers.simulator.pose_array import PoseArray
from posor_drivers.simulator.scenario import Bearing, Structure
from scipy.spatial.transform import Rotation

GRAVITY = np.array([0.0, 0.0, -9.80665])
LENGTH = 0.7
MODULUS, SHEAR, DENSITY, END_MASS, PAYLOAD = 7e10, 2.6e10, 2700.0, 4.0, 3.0
OUTER, INNER = 0.12, 0.11
SECOND_MOMENT = np.pi / 64.0 * (OUTER**4 - INNER**4)
STIFFNESS = MODULUS * SECOND_MOMENT
TORSION = SHEAR * 2.0 * SECOND_MOMENT
WEIGHT = DENSITY * np.pi / 4.0 * (OUTER**2 - INNER**2) * 9.80665
G = 9.80665


def structure() -> Structure:
    numbers = {
        "outer_diameter": (OUTER, "m"),
        "inner_diameter": (INNER, "m"),
        "modulus": (MODULUS, "Pa"),
        "shear_modulus": (SHEAR, "Pa"),
        "density": (DENSITY, "kg/m^3"),
        "end_mass": (END_MASS, "kg"),
    }
    return Structure.model_validate({name: {"value": value, "unit": unit} for name, (value, unit) in numbers.items()})


def test_joint_follows_the_motor_half_the_backlash_behind() -> None:
    motor = np.sin(np.linspace(0.0, 2.0 * np.pi, 1000, endpoint=False))
    joint = apply_backlash(motor, 0.02)
    rising, falling = joint[200], joint[500]
    assert rising == pytest.approx(motor[200] - 0.01, abs=1e-15)
    assert falling == pytest.approx(motor[500] + 0.01, abs=1e-15)
    assert np.max(np.abs(joint - motor)) == pytest.approx(0.01, abs=1e-15)
    # At the turning point it stands still until the motor has crossed the backlash.
    standing = np.flatnonzero(joint == joint[250])
    assert len(standing) > 30
    assert motor[standing].max() - motor[standing].min() == pytest.approx(0.02, abs=2e-3)


def test_backlash_is_periodic_and_independent_of_its_start() -> None:
    motor = np.sin(np.linspace(0.0, 2.0 * np.pi, 1000, endpoint=False))
    later = apply_backlash(np.roll(motor, -300), 0.02)
    assert np.array_equal(np.roll(apply_backlash(motor, 0.02), -300), later)


def test_motion_within_the_backlash_moves_nothing() -> None:
    motor = 0.009 * np.sin(np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False))
    assert np.ptp(apply_backlash(motor, 0.02)) == 0.0
    assert np.array_equal(apply_backlash(motor, 0.0), motor)


def test_encoder_reads_the_nearest_step() -> None:
    read = quantise_encoder(np.array([0.0, 0.0014, -0.0014, 0.0016]), 1e-3)
    assert np.allclose(read, [0.0, 0.001, -0.001, 0.002], rtol=0.0, atol=1e-18)


def test_error_motions_have_their_amplitudes_and_orders() -> None:
    bearing = Bearing.model_validate(
        {
            "orders": [1, 3],
            "radial": {"value": [5e-5, 1e-5], "unit": "m"},
            "axial": {"value": [0.0, 2e-6], "unit": "m"},
            "tilt": {"value": [1e-4, 0.0], "unit": "rad"},
        }
    )
    angles = 2.0 * np.pi * np.arange(360) / 360
    motions = bearing_error_motions(bearing, angles, RandomStream(1, "bearing").generator())
    across = np.fft.fft(motions.translations[:, 0] + 1j * motions.translations[:, 1]) / 360
    assert np.abs(across[[1, 3]]) == pytest.approx([5e-5, 1e-5], rel=1e-9)
    assert np.abs(across[[-1, -3, 0, 2]]) == pytest.approx([0.0] * 4, abs=1e-15)
    along = np.fft.rfft(motions.translations[:, 2]) / 180
    assert np.abs(along[[1, 3]]) == pytest.approx([0.0, 2e-6], abs=1e-15)
    leans = Rotation.from_matrix(motions.rotations).as_rotvec()
    assert np.linalg.norm(leans, axis=1) == pytest.approx(np.full(360, 1e-4), rel=1e-9)
    assert np.ptp(leans[:, 2]) == 0.0


def one_link(start: Rotation, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return bend and turn, in the base, of a single link with mass at its end and payload."""
    poses = PoseArray(start.as_matrix()[None], np.zeros((1, 3)))
    length = float(np.linalg.norm(end))
    (bend,) = bend_links([poses], [end], [LinkCompliance.from_structure(structure(), length)], PAYLOAD, GRAVITY)
    return poses.rotate(bend.translations)[0], poses.rotate(bend.rotations)[0]


def test_level_link_bends_as_the_closed_form_of_a_cantilever() -> None:
    moved, turned = one_link(Rotation.identity(), np.array([LENGTH, 0.0, 0.0]))
    tip = (END_MASS + PAYLOAD) * G
    down = WEIGHT * LENGTH**4 / (8.0 * STIFFNESS) + tip * LENGTH**3 / (3.0 * STIFFNESS)
    slope = WEIGHT * LENGTH**3 / (6.0 * STIFFNESS) + tip * LENGTH**2 / (2.0 * STIFFNESS)
    assert moved == pytest.approx([0.0, 0.0, -down], rel=1e-9, abs=1e-18)
    assert turned == pytest.approx([0.0, slope, 0.0], rel=1e-9, abs=1e-18)


def test_bend_does_not_depend_on_the_axes_of_the_link() -> None:
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7])
    expected = one_link(Rotation.identity(), np.array([LENGTH, 0.0, 0.0]))
    found = one_link(turn, turn.inv().apply([LENGTH, 0.0, 0.0]))
    assert np.allclose(found, expected, rtol=1e-9, atol=1e-18)


def test_upright_link_does_not_bend_and_a_slanted_one_less() -> None:
    assert np.allclose(one_link(Rotation.identity(), np.array([0.0, 0.0, LENGTH])), 0.0, atol=1e-18)
    level, _ = one_link(Rotation.identity(), np.array([LENGTH, 0.0, 0.0]))
    slanted, _ = one_link(Rotation.identity(), LENGTH * np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5)]))
    assert np.linalg.norm(slanted) == pytest.approx(np.sqrt(0.5) * np.linalg.norm(level), rel=1e-9)
    assert slanted @ [1.0, 0.0, 1.0] == pytest.approx(0.0, abs=1e-18)


HERE = PoseArray(np.eye(3)[None], np.zeros((1, 3)))


@pytest.mark.parametrize("second", [[0.0, 0.4, 0.0], [0.4, 0.0, 0.0]])
def test_second_link_bends_and_twists_the_first(second: list[float]) -> None:
    """Off its end along Y, its weight twists the first link; in line, its moment bends it."""
    ends = [np.array([LENGTH, 0.0, 0.0]), np.array(second)]
    links = [LinkCompliance.from_structure(structure(), length) for length in (LENGTH, 0.4)]
    bend, _ = bend_links([HERE, HERE], ends, links, PAYLOAD, GRAVITY)
    lever = 0.4 * (END_MASS + PAYLOAD) * G + 0.2 * WEIGHT * 0.4
    twist, moment = (-lever, 0.0) if second[1] else (0.0, lever)
    force = (2.0 * END_MASS + PAYLOAD) * G + WEIGHT * 0.4
    slope = (WEIGHT * LENGTH**3 / 6.0 + force * LENGTH**2 / 2.0 + moment * LENGTH) / STIFFNESS
    down = (WEIGHT * LENGTH**4 / 8.0 + force * LENGTH**3 / 3.0 + moment * LENGTH**2 / 2.0) / STIFFNESS
    assert bend.rotations[0] == pytest.approx([twist * LENGTH / TORSION, slope, 0.0], rel=1e-9, abs=1e-18)
    assert bend.translations[0] == pytest.approx([0.0, 0.0, -down], rel=1e-9, abs=1e-18)


def test_link_without_length_or_structure_does_not_bend() -> None:
    none, rigid = bend_links(
        [HERE, HERE],
        [np.zeros(3), np.array([LENGTH, 0.0, 0.0])],
        [LinkCompliance.from_structure(structure(), 0.0), LinkCompliance.from_structure(None, LENGTH)],
        PAYLOAD,
        GRAVITY,
    )
    for bend in (none, rigid):
        assert not bend.translations.any()
        assert not bend.rotations.any()
