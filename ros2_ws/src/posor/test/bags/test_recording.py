# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reference tracks and recordings: interpolation, selection of a reference, and invalid tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from posor.bags.recording import POINT, POSE, SCALAR, Recording, Track, unpack_poses
from posor.errors import TrackError
from posor.estimation.forward import empty_scans
from posor.model.scan import SATURATED
from posor.numerics.stamps import NS
from scipy.spatial.transform import Rotation


def track(stamps: list[int], values: list[list[float]]) -> Track:
    return Track(np.array(stamps, dtype=np.int64), np.array(values), np.zeros(len(values[0])), "bag, topic /reference")


def test_values_between_stamps_are_interpolated_linearly() -> None:
    reference = track([100, 200, 400], [[1.0, 0.0], [2.0, -1.0], [6.0, 1.0]])
    found = reference.interpolate(np.array([100, 150, 200, 250, 400]), longest_gap_ns=1000)
    np.testing.assert_allclose(found, [[1.0, 0.0], [1.5, -0.5], [2.0, -1.0], [3.0, -0.5], [6.0, 1.0]])


def test_there_is_no_value_outside_the_track_or_in_a_long_gap() -> None:
    reference = track([100, 200, 400], [[1.0], [2.0], [6.0]])
    found = reference.interpolate(np.array([99, 401, 250, 200, 400]), longest_gap_ns=150)[:, 0]
    np.testing.assert_array_equal(found, [np.nan, np.nan, np.nan, 2.0, 6.0])


def test_stamps_of_today_keep_their_nanoseconds() -> None:
    now = 1_795_000_000 * NS
    reference = track([now, now + 10], [[0.0], [10.0]])
    np.testing.assert_allclose(reference.interpolate(now + np.arange(11), 100)[:, 0], np.arange(11.0))


def test_a_missing_quantity_is_not_interpolated() -> None:
    reference = track([100, 200, 300, 400], [[0.0, 1.0], [np.nan, 1.0], [0.0, 1.0], [0.0, 1.0]])
    found = reference.interpolate(np.array([150, 200, 350]), 1000)
    np.testing.assert_array_equal(found, [[np.nan, 1.0], [np.nan, 1.0], [0.0, 1.0]])


@pytest.mark.parametrize(
    ("stamps", "values", "sentence"),
    [
        ([200, 100], [[1.0], [2.0]], "stamp 100 ns follows 200 ns; expected strictly increasing stamps."),
        ([100, 100], [[1.0], [2.0]], "stamp 100 ns follows 100 ns; expected strictly increasing stamps."),
        ([100, 200], [[1.0], [np.inf]], "the value at 200 ns is not finite; expected finite values."),
        ([100, 200], [[0.0, 1.0], [np.nan] * 2], "the value at 200 ns is not finite; expected finite values."),
        ([], np.empty((0, 1)), "holds no values."),
    ],
)
def test_invalid_track_is_refused(stamps: list[int], values: list[list[float]], sentence: str) -> None:
    with pytest.raises(TrackError) as caught:
        Track(np.array(stamps, dtype=np.int64), np.array(values), np.zeros(1), "bag, topic /reference")
    assert str(caught.value) == f"bag, topic /reference: {sentence}"


def recording_of(**columns: int) -> Recording:
    stamps = np.array([1, 2], dtype=np.int64)
    tracks = {
        f"/{name}": Track(stamps, np.zeros((2, count)), np.zeros(count), f"bag, topic /{name}")
        for name, count in columns.items()
    }
    return Recording(empty_scans(stamps), tracks, "bag")


def test_reference_is_found_by_its_kind_or_its_topic() -> None:
    recording = recording_of(length=SCALAR, point=POINT, other=POINT)
    assert recording.find_track("", SCALAR) is recording.tracks["/length"]
    assert recording.find_track("/other", POINT) is recording.tracks["/other"]


POINT_TEXT, POSE_TEXT = "a point (geometry_msgs/PointStamped)", "a pose (geometry_msgs/TransformStamped or PoseStamped)"


@pytest.mark.parametrize(
    ("topic", "columns", "sentence"),
    [
        ("", POINT, f"2 reference topics hold {POINT_TEXT}; expected one, of /other, /point."),
        ("", POSE, f"no topic holds {POSE_TEXT}; expected one, of /length, /other, /point."),
        ("/none", SCALAR, "there is no reference /none; expected one of /length, /other, /point."),
        ("/point", SCALAR, f"topic /point holds {POINT_TEXT}; expected one number (std_msgs/Float64)."),
    ],
)
def test_missing_or_ambiguous_reference_is_refused(topic: str, columns: int, sentence: str) -> None:
    with pytest.raises(TrackError) as caught:
        recording_of(length=SCALAR, point=POINT, other=POINT).find_track(topic, columns)
    assert str(caught.value) == f"bag: {sentence}"


def test_saturated_scans_can_be_left_out() -> None:
    recording = recording_of(length=SCALAR)
    assert recording.without_status(SATURATED) is recording
    marked = replace(recording, statuses=np.array([SATURATED | 1, 4], dtype=np.int64))
    assert marked.has_status(SATURATED).tolist() == [True, False]
    assert marked.without_status(SATURATED).scans.stamps_ns.tolist() == [2]


def test_poses_use_the_direction_of_their_quaternions() -> None:
    turn = Rotation.from_rotvec([[0.1, -0.2, 0.3]])
    rotations, translations = unpack_poses(np.hstack([[[1.0, 2.0, 3.0]], 0.99 * turn.as_quat()]))
    np.testing.assert_allclose(rotations, turn.as_matrix(), atol=1e-15)
    assert translations.tolist() == [[1.0, 2.0, 3.0]]
