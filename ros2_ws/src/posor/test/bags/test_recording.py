# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reference tracks and recordings: interpolation, selection of a reference, and invalid tracks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from posor.bags.recording import POINT, POSE, SCALAR, Recording, Track, unpack_poses
from posor.errors import ParameterError, ShapeError, TrackError
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
        Track(
            np.array(stamps, dtype=np.int64), np.array(values), np.zeros(np.shape(values)[1]), "bag, topic /reference"
        )
    assert str(caught.value) == f"bag, topic /reference: {sentence}"


VALUES = [[0.0, 1.0], [2.0, 3.0]]
MASKED = np.ma.masked_array(VALUES, mask=[[False, True], [False, False]])
INVALID: dict[str, tuple[object, object, object, type[Exception], str]] = {
    "stamps in seconds": (
        [1.0, 2.0],
        VALUES,
        [0.0] * 2,
        ParameterError,
        "stamps_ns is list of float64; expected whole",
    ),
    "stamps of two columns": ([[1], [2]], VALUES, [0.0] * 2, ShapeError, "stamps_ns has shape (2, 1); expected (n,)."),
    "values of texts": ([1, 2], [["a"], ["b"]], [0.0], ParameterError, "values is list of <U1; expected real numbers."),
    "values of other lengths": ([1, 2], [[0.0], [1.0, 2.0]], [0.0], ParameterError, "values is list of object; "),
    "too few values": ([1, 2, 3], VALUES, [0.0] * 2, ShapeError, "values has shape (2, 2); expected (3, k), or (3,) "),
    "a single value": ([1], 5.0, [0.0], ShapeError, "values has shape (); expected (1, k), or (1,) for one quantity."),
    "too few sigmas": ([1, 2], VALUES, 0.0, ShapeError, "sigmas has shape (1,); expected (2,), one for each quantity."),
    "negative sigma": ([1, 2], VALUES, [0.0, -1e-8], ParameterError, "sigmas are [0.0, -1e-08]; expected finite "),
    "unknown sigma": ([1, 2], VALUES, [0.0, np.nan], ParameterError, "sigmas are [0.0, nan]; expected finite standard"),
    "masked value": ([1, 2], MASKED, [0.0] * 2, ParameterError, "values has 1 masked entries; expected no masked en"),
    "masked sigma": ([1, 2], VALUES, MASKED[0], ParameterError, "sigmas has 1 masked entries; expected no masked en"),
    "masked stamp": (
        np.ma.masked_array([1, 2], mask=[True, False]),
        VALUES,
        [0.0] * 2,
        ParameterError,
        "stamps_ns has 1 mas",
    ),
}


@pytest.mark.parametrize("kind", INVALID)
def test_arrays_that_do_not_fit_a_track_are_refused(kind: str) -> None:
    stamps, values, sigmas, error, sentence = INVALID[kind]
    with pytest.raises(error) as caught:
        Track(stamps, values, sigmas, "laser")  # type: ignore[arg-type]
    assert str(caught.value).startswith(f"laser: {sentence}")


@pytest.mark.parametrize(
    ("values", "sigmas"), [([1.0, 2.0], 1e-8), ([[1.0], [2.0]], [1e-8]), (np.array([1, 2]), np.array([1e-8]))]
)
def test_array_likes_of_a_track_become_arrays(values: object, sigmas: object) -> None:
    reference = Track([100, 200], values, sigmas, "laser")  # type: ignore[arg-type]
    np.testing.assert_array_equal(reference.values, [[1.0], [2.0]])
    np.testing.assert_array_equal(reference.sigmas, [1e-8])
    assert [each.dtype for each in (reference.stamps_ns, reference.values)] == [np.dtype("i8"), np.dtype("f8")]
    assert reference.interpolate(np.array([150]), 1000)[0, 0] == 1.5


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
