from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from posor_estimator.core.calibrate.joining import StopOptions, stops, stops_of, while_known
from posor_estimator.core.calibrate.recording import POINT, POSE, SATURATED, SCALAR, Recording, poses_of
from posor_estimator.core.calibrate.track import Dwell, Track
from posor_estimator.core.forward import empty_scans
from posor_estimator.errors import TrackError
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import FloatArray

SECOND = 1_000_000_000


def scans_of(volts: FloatArray, stamps: list[int], lit: list[list[int]] | None = None) -> Scans:
    scans = empty_scans(np.array(stamps, dtype=np.int64)).with_fields({"gap_voltages": volts})
    return scans if lit is None else scans.with_fields({"lit_sources": np.array(lit, dtype=np.int64)})


def dwell(begin: int, end: int, value: float = 0.0, spread: float = 0.0, samples: int = 4) -> Dwell:
    return Dwell(begin, end, np.array([value]), np.array([spread]), samples)


def track(sigma: float = 0.0) -> Track:
    return Track(np.array([1, 2], dtype=np.int64), np.zeros((2, 1)), np.array([sigma]), "bag, topic /reference")


def test_means_are_of_the_scans_within_each_dwell() -> None:
    scans = scans_of(np.array([[9.0], [1.0], [3.0], [9.0], [5.0], [9.0]]), [10, 20, 30, 40, 50, 60])
    found = stops(scans, track(), [dwell(20, 30), dwell(45, 55), dwell(56, 59)])
    assert found.scans.gap_voltages[:, 0].tolist() == [2.0, 5.0]
    assert found.scans.stamps_ns.tolist() == [25, 50]
    assert found.counts.tolist() == [2, 1]
    assert len(found) == 2


def test_uncertainty_of_means_is_pooled_over_the_dwells(rng: np.random.Generator) -> None:
    volts = rng.normal(size=(60, 2)) * [1e-3, 5e-3] + np.repeat([[1.0, 2.0], [3.0, -1.0], [0.0, 0.0]], 20, axis=0)
    found = stops(scans_of(volts, list(range(1, 61))), track(), [dwell(1, 20), dwell(21, 40), dwell(41, 60)])
    parts = volts.reshape(3, 20, 2)
    pooled = np.sqrt(np.mean(parts.var(axis=1, ddof=1), axis=0))
    np.testing.assert_allclose(found.spreads["gap_voltages"], pooled)
    np.testing.assert_allclose(found.sigmas("gap_voltages"), np.tile(pooled / np.sqrt(20.0), (3, 1)))


def test_reference_is_as_uncertain_as_its_instrument_and_its_scatter() -> None:
    scans = scans_of(np.zeros((4, 1)), [10, 20, 30, 40])
    found = stops(scans, track(sigma=3e-6), [dwell(10, 40, value=0.5, spread=8e-6, samples=4)])
    np.testing.assert_allclose(found.reference, [[0.5]])
    np.testing.assert_allclose(found.reference_sigmas, [[5e-6]])


def test_dwells_without_scans_are_refused_when_there_are_no_others() -> None:
    with pytest.raises(TrackError) as caught:
        stops(scans_of(np.zeros((2, 1)), [10, 20]), track(), [dwell(30, 40)])
    assert str(caught.value) == (
        "bag, topic /reference: none of its 1 dwells holds a scan; expected scans of the same time span."
    )


def test_lit_source_that_changes_within_a_dwell_is_refused() -> None:
    scans = scans_of(np.zeros((2, 1)), [10, 20], lit=[[0, 1], [0, 2]])
    with pytest.raises(TrackError, match="the lit source changes within the dwell from 10 ns to 20 ns; expected one"):
        stops(scans, track(), [dwell(10, 20)])


def test_scans_at_unknown_times_are_left_out() -> None:
    reference = Track(np.array([100, 200], dtype=np.int64), np.array([[0.0], [1.0]]), np.zeros(1), "bag")
    scans, values = while_known(scans_of(np.zeros((3, 1)), [50, 150, 250]), reference, 1000)
    assert scans.stamps_ns.tolist() == [150]
    assert values.tolist() == [[0.5]]
    with pytest.raises(TrackError, match="says nothing at the times of the 1 scans; expected values at most 1e-06 s"):
        while_known(scans_of(np.zeros((1, 1)), [50]), reference, 1000)


def recording(track: Track, scans: Scans) -> Recording:
    return Recording(scans, {"/reference": track}, "bag")


def test_each_scan_is_a_stop_where_no_stop_is_asked_for() -> None:
    reference = Track(np.array([100, 200], dtype=np.int64), np.array([[0.0], [1.0]]), np.array([0.1]), "bag")
    found = stops_of(
        recording(reference, scans_of(np.array([[7.0], [8.0]]), [100, 200])), reference, StopOptions(least=0.0)
    )
    assert found.reference.tolist() == [[0.0], [1.0]]
    assert found.reference_sigmas.tolist() == [[0.1], [0.1]]
    assert np.isnan(found.sigmas("gap_voltages")).all()


def test_reference_that_never_stands_still_is_refused() -> None:
    moving = Track(np.arange(1, 101) * SECOND, np.arange(100.0)[:, None], np.zeros(1), "bag, topic /reference")
    with pytest.raises(TrackError) as caught:
        stops_of(recording(moving, scans_of(np.zeros((1, 1)), [SECOND])), moving, StopOptions(still=0.1))
    assert str(caught.value).startswith(
        "bag, topic /reference: never stands still within 0.1 for 0.2 s; expected stops"
    )


def several(**columns: int) -> Recording:
    stamps = np.array([1, 2], dtype=np.int64)
    tracks = {
        f"/{name}": Track(stamps, np.zeros((2, count)), np.zeros(count), f"bag, topic /{name}")
        for name, count in columns.items()
    }
    return Recording(scans_of(np.zeros((2, 1)), [1, 2]), tracks, "bag")


def test_reference_is_found_by_its_kind_or_by_its_name() -> None:
    taken = several(length=SCALAR, point=POINT, other=POINT)
    assert taken.track("", SCALAR) is taken.tracks["/length"]
    assert taken.track("/other", POINT) is taken.tracks["/other"]


@pytest.mark.parametrize(
    ("topic", "columns", "sentence"),
    [
        (
            "",
            POINT,
            "bag: 2 reference topics hold a point (geometry_msgs/PointStamped); expected one, of /other, /point.",
        ),
        (
            "",
            POSE,
            "bag: no topic holds a pose (geometry_msgs/TransformStamped); expected one, of /length, /other, /point.",
        ),
        ("/none", SCALAR, "bag: there is no reference /none; expected one of /length, /other, /point."),
        (
            "/point",
            SCALAR,
            "bag: topic /point holds a point (geometry_msgs/PointStamped); expected one number (std_msgs/Float64).",
        ),
    ],
)
def test_reference_that_is_not_there_is_refused(topic: str, columns: int, sentence: str) -> None:
    with pytest.raises(TrackError) as caught:
        several(length=SCALAR, point=POINT, other=POINT).track(topic, columns)
    assert str(caught.value) == sentence


def test_saturated_scans_can_be_left_out() -> None:
    taken = several(length=SCALAR)
    assert taken.without(SATURATED) is taken
    marked = replace(taken, statuses=np.array([SATURATED | 1, 4], dtype=np.int64))
    assert marked.having(SATURATED).tolist() == [True, False]
    assert marked.without(SATURATED).scans.stamps_ns.tolist() == [2]


def test_poses_are_taken_by_the_direction_of_their_quaternions() -> None:
    turn = Rotation.from_rotvec([[0.1, -0.2, 0.3]])
    rotations, translations = poses_of(np.hstack([[[1.0, 2.0, 3.0]], 0.99 * turn.as_quat()]))
    np.testing.assert_allclose(rotations, turn.as_matrix(), atol=1e-15)
    assert translations.tolist() == [[1.0, 2.0, 3.0]]
