# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Cycles of ISO 9283 in motions made by hand: poses, distances, crossings of a plane, and what makes figures wrong."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from posor.bags.recording import Track
from posor.errors import TrackError
from posor.numerics.stamps import NS
from posor_design.iso9283_checks import count_elsewhere, interpolation_error
from posor_design.iso9283_cycles import Motion, Sameness, distance_pairs, motion_of, path_cycles, pose_cycles
from scipy.spatial.transform import Rotation

TURN, ASIDE = 1e-2, 1e-4  # turn along a path [rad], deviation across it [m]
STEPS = np.linspace(0.0, 1.0, 12)
SAME = Sameness(1e-3, 1e-3)
DWELL, MS = 4, 1_000_000  # scans of a dwell; time between scans [ns]


def motion_along_x(x: np.ndarray, offset: np.ndarray, angle: np.ndarray) -> Motion:
    """Return the motion of a reference along x [m] (n,), with the endpoint off (n, 3) and both turned about Z (n,)."""
    references = np.column_stack([x, 0.0 * x, 0.0 * x])
    turns = Rotation.from_rotvec(np.column_stack([0.0 * x, 0.0 * x, angle]))
    return Motion("reference", np.arange(len(x)) * MS, references + offset, references, turns, turns)


def visits(places: list[tuple[float, float]], drift: float = 0.0) -> tuple[Motion, list[tuple[int, int]]]:
    """Return dwells at places x [m] in orientations [rad], and their times; each with a drift more of the endpoint."""
    x, angle = np.repeat(np.array(places).T, DWELL, axis=1)
    offset = np.outer(drift * (np.arange(len(x)) // DWELL), [1.0, 0.0, 0.0])
    return motion_along_x(x, offset, angle), [
        (begin * MS, (begin + DWELL - 1) * MS) for begin in range(0, len(x), DWELL)
    ]


def test_a_deviation_is_that_of_the_endpoint_from_the_reference_in_the_same_plane() -> None:
    there = np.concatenate([np.zeros(4), STEPS, np.ones(4), STEPS[::-1], np.zeros(4)])
    x = np.concatenate([there, there])  # two cycles
    still = np.flatnonzero(np.concatenate([[True], np.diff(x) == 0.0]) & np.concatenate([np.diff(x) == 0.0, [True]]))
    groups = np.split(still, np.flatnonzero(np.diff(still) > 1) + 1)
    dwells = [(int(each[0]) * MS, int(each[-1]) * MS) for each in groups]
    turned = motion_along_x(x, np.array([0.0, ASIDE, 0.0]), TURN * x)
    motion = turned._replace(reference_rotations=Rotation.from_rotvec(np.zeros((len(x), 3))))
    _, numbers = pose_cycles(motion, dwells, SAME)
    forth, _ = path_cycles(motion, dwells, numbers, SAME.distance)
    assert forth.attained.shape[1] == 2
    assert forth.dwells == (1, 3)
    deviations = forth.attained - forth.commanded[:, None]
    np.testing.assert_allclose(deviations[..., 1], ASIDE, atol=1e-12)
    wanted = np.broadcast_to(TURN * forth.commanded[:, :1], deviations.shape[:2])
    np.testing.assert_allclose(deviations[..., 5], wanted, atol=1e-9)
    assert forth.figures()["AT_p"] == pytest.approx(ASIDE)


def test_two_orientations_at_one_place_are_two_poses_without_a_distance_or_a_path() -> None:
    motion, dwells = visits([(0.0, 0.0), (0.0, 0.3)] * 3)
    poses, numbers = pose_cycles(motion, dwells, SAME)
    assert [pose.dwells for pose in poses] == [(1, 3, 5), (2, 4, 6)]
    assert distance_pairs(poses, SAME.distance) == {}
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # such as a division by the length of a path that leads nowhere
        assert path_cycles(motion, dwells, numbers, SAME.distance) == []


def test_an_endpoint_that_settles_after_the_reference_is_in_its_pose() -> None:
    motion, dwells = visits([(0.0, 0.0), (0.1, 0.3)] * 2)
    settling = np.tile([10.0 * SAME.turn, 0.0, 0.0, 0.0], len(dwells))
    late = motion._replace(rotations=motion.rotations * Rotation.from_rotvec(np.outer(settling, [0.0, 0.0, 1.0])))
    poses, _ = pose_cycles(late, dwells, SAME)
    assert [pose.dwells for pose in poses] == [(1, 3), (2, 4)]
    np.testing.assert_allclose(poses[0].attained[:, 5], settling.mean(), rtol=1e-6)


def test_a_missing_dwell_does_not_shift_the_cycles_of_a_distance() -> None:
    drift = 1e-5  # from dwell to dwell: neighbouring dwells are always as far apart
    motion, dwells = visits([(0.0, 0.0), (0.1, 0.0)] * 4, drift)
    for left_out in (1, 2):
        kept = [dwell for number, dwell in enumerate(dwells) if number != left_out]
        poses, _ = pose_cycles(motion, kept, SAME)
        figures = distance_pairs(poses, SAME.distance)["P1", "P2"]
        assert figures["AD"] == pytest.approx(drift, rel=1e-9)
        assert figures["RD"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("place", "angle"), [(np.linspace(0.0, 5e-3, DWELL), 0.0), (0.0, np.linspace(0.0, 0.1, DWELL))]
)
def test_a_dwell_in_motion_is_refused(place: np.ndarray | float, angle: np.ndarray | float) -> None:
    x = np.concatenate([np.zeros(DWELL), place + np.zeros(DWELL)])
    turns = np.concatenate([np.zeros(DWELL), angle + np.zeros(DWELL)])
    with pytest.raises(TrackError, match="in dwell 2"):
        pose_cycles(motion_along_x(x, np.zeros(3), turns), [(0, 3 * MS), (4 * MS, 7 * MS)], SAME)


def test_a_point_as_reference_leaves_the_orientation_to_the_endpoint() -> None:
    motion, dwells = visits([(0.0, 0.0), (0.0, 0.3)] * 2)
    poses, _ = pose_cycles(motion._replace(reference_rotations=None), dwells, SAME)
    assert [pose.dwells for pose in poses] == [(1, 3), (2, 4)]
    assert np.isnan(poses[0].attained[:, 3:]).all()


def test_a_reference_of_another_time_is_refused() -> None:
    track = Track(np.array([10, 20]) * NS, np.zeros((2, 3)), np.zeros(3), "bag")
    with pytest.raises(TrackError, match="no value at the time of an endpoint"):
        motion_of(np.array([NS]), np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]), track, NS)


def test_an_endpoint_at_another_pose_of_the_reference_is_counted() -> None:
    motion, dwells = visits([(0.0, 0.0), (0.1, 0.0), (0.2, 0.0)] * 2)
    late = motion._replace(positions=np.roll(motion.positions, DWELL, axis=0))
    for each, count in ((motion, 0), (late, 6)):
        poses, _ = pose_cycles(each, dwells, SAME)
        assert count_elsewhere(poses, SAME.distance) == count


def test_a_line_between_rare_readings_of_a_curve_is_as_far_from_it_as_stated() -> None:
    radius, every = 0.5, 100  # [m]; scans between two readings
    angles = np.concatenate([np.zeros(1000), np.linspace(0.0, 1.0, 1001)])
    circle = radius * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    stamps = np.arange(len(angles)) * MS
    poses = np.hstack([circle, np.tile([0.0, 0.0, 0.0, 1.0], (len(circle), 1))])
    for step, wanted in ((1, 0.0), (every, radius * (1.0 - np.cos(every / 2000.0)))):  # the sagitta
        track = Track(stamps[::step], circle[::step], np.zeros(3), "bag")
        motion = motion_of(stamps, poses, track, 200 * MS)
        away = np.linalg.norm(motion.positions - motion.references, axis=1).max()
        assert away == pytest.approx(wanted, abs=1e-12)
        assert interpolation_error(motion, track, [(0, 900 * MS)]) == pytest.approx(wanted, rel=0.01, abs=1e-12)


def test_a_path_with_corners_at_readings_is_the_line_between_them() -> None:
    readings = np.array([[0.0, 0.0], [0.05, 0.0], [0.1, 0.0], [0.1, 0.05], [0.1, 0.1], [0.15, 0.1], [0.2, 0.1]])
    every = 10  # scans between two readings
    track = Track(np.arange(len(readings)) * every * MS, np.pad(readings, ((0, 0), (0, 1))), np.zeros(3), "bag")
    stamps = np.arange(every * (len(readings) - 1) + 1) * MS
    poses = np.hstack([track.interpolate(stamps, NS), np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1))])
    assert interpolation_error(motion_of(stamps, poses, track, NS), track, []) == pytest.approx(0.0, abs=1e-12)
