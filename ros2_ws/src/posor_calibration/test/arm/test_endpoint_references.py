# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""References of an endpoint: each mistake in units, columns and angles is named by what explains it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin
import pytest
from posor.errors import PosorError, TrackError
from posor.numerics.array_types import FloatArray
from posor.tables.table_readings import load_readings
from posor_calibration.arm.endpoint_references import (
    EndpointReferences,
    Reading,
    Uncertainty,
    check_references,
    references_of,
)
from scipy.spatial.transform import Rotation

POSES = 20
ORDER: Literal["xyz"] = "xyz"
TOOL = pin.SE3(pin.rpy.rpyToMatrix(0.2, -0.1, 0.3), np.array([0.02, -0.01, 0.05]))
T_REFERENCE_BASE = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 2.0), np.array([2.0, 1.0, -0.5]))
Change = Callable[[FloatArray], FloatArray]


def endpoints() -> list[pin.SE3]:
    random = np.random.default_rng(4)
    return [
        pin.SE3(Rotation.from_rotvec(random.uniform(-1.0, 1.0, 3)).as_matrix(), random.uniform(-0.8, 0.8, 3))
        for _ in range(POSES)
    ]


def references(places: Change = lambda x: x, turns: Change | None = None, order: str = "") -> EndpointReferences:
    """Return exact poses, after a change of the places (n, 3), and of angles (n, 3) or quaternions (n, 4)."""
    seen = [T_REFERENCE_BASE * endpoint * TOOL for endpoint in endpoints()]
    points = places(np.array([pose.translation for pose in seen]))
    rotations = Rotation.from_matrix([pose.rotation for pose in seen])
    angles = rotations.as_euler(ORDER)
    if turns is not None:
        angles = turns(angles) if order else angles
        rotations = Rotation.from_euler(order, angles) if order else Rotation.from_quat(turns(rotations.as_quat()))
    readings = [
        Reading(f"row {n}", n, "ball", "pose", np.append(point, turn), angle if order else None, np.ones(6))
        for n, (point, turn, angle) in enumerate(zip(points, rotations.as_quat(), angles, strict=True))
    ]
    numbers = np.arange(POSES)
    return EndpointReferences(numbers, numbers, tuple(readings), {"ball": order} if order else {})


@pytest.mark.parametrize("order", ["", ORDER])
def test_right_references_are_accepted_at_any_place_of_the_base(order: str) -> None:
    check_references(references(turns=lambda x: x, order=order), endpoints(), {"ball": TOOL}, "t.csv")


@pytest.mark.parametrize(
    ("wrong", "explanation"),
    [
        (references(lambda x: 1e3 * x), "perhaps it is in millimetres"),
        (references(lambda x: x / 0.0254), "perhaps it is in inches"),
        (references(lambda x: 1e-3 * x), "perhaps it was converted from millimetres"),
        (references(lambda x: x * [1.0, -1.0, 1.0]), "has one axis the other sign, or are two columns exchanged"),
        (references(lambda x: x[:, [1, 0, 2]]), "has one axis the other sign, or are two columns exchanged"),
        (references(turns=np.degrees, order=ORDER), "perhaps.*angles in degrees, read as radians"),
        (references(turns=np.radians, order=ORDER), "perhaps.*angles in radians, read as degrees"),
        (references(turns=lambda x: x, order="zyx"), "perhaps.*another order of the angles, xyz"),
        (references(turns=lambda x: x, order="XYZ"), "perhaps.*another order of the angles, xyz"),
        (
            references(turns=lambda x: x * [-1.0, -1.0, -1.0, 1.0]),
            "perhaps.*the orientation of the base in the reflector",
        ),
        (references(turns=lambda x: x[:, [3, 0, 1, 2]]), "perhaps.*w, x, y, z in the order of x, y, z, w"),
    ],
)
def test_a_mistake_is_named_by_what_explains_the_readings(wrong: EndpointReferences, explanation: str) -> None:
    with pytest.raises(TrackError, match=explanation):
        check_references(wrong, endpoints(), {"ball": TOOL}, "t.csv")


MAP = """\
format: posor_table_map
version: 1
name: tracker
time: {rate: {value: 1, unit: Hz}, start: "2026-01-01T00:00:00Z"}
references:
  ball:
    frame_id: tracker
    child_frame_id: ball
    position: [{column: X, unit: mm}, {column: Y, unit: mm}, {column: Z, unit: mm}]
    angles: [{column: A, unit: UNIT}, {column: B, unit: UNIT}, {column: C, unit: UNIT}]
    order: zyx
    missing: allowed
"""


def table(folder: Path, unit: str, rows: str) -> tuple[Path, Path]:
    paths = folder / "tracker.csv", folder / "map.yaml"
    paths[0].write_text(f"X,Y,Z,A,B,C\n{rows}", encoding="utf-8")
    paths[1].write_text(MAP.replace("UNIT", unit), encoding="utf-8")
    return paths


def test_angles_of_a_table_become_quaternions_and_rows_without_a_reading_are_left_out(tmp_path: Path) -> None:
    rows = "1000,0,0,90,0,0\n,,,,,\n0,2000,0,30,20,10\n"
    read = load_readings(*table(tmp_path, "deg", rows), needs_joints=False)
    found = references_of(read, {"ball": Uncertainty(1e-5, 1e-6, 1e-4)}, "tracker.csv")
    assert [reading.name for reading in found.readings] == ["row 1 of ball", "row 3 of ball"]
    assert found.rows.tolist() == [1, 3]
    np.testing.assert_allclose(np.diff(found.stamps_ns), 2_000_000_000)
    turns = Rotation.from_quat([reading.values[3:] for reading in found.readings])
    expected = Rotation.from_euler("zyx", [[90.0, 0.0, 0.0], [30.0, 20.0, 10.0]], degrees=True)
    np.testing.assert_allclose((turns.inv() * expected).magnitude(), 0.0, atol=1e-12)
    np.testing.assert_allclose(found.readings[1].sigmas, [1.2e-5] * 3 + [1e-4] * 3)


def test_references_of_two_trackers_are_refused(tmp_path: Path) -> None:
    paths = table(tmp_path, "deg", "1,0,0,90,0,0\n")
    other = (
        "  ring: {frame_id: other, position: [{column: X, unit: mm}, {column: Y, unit: mm}, {column: Z, unit: mm}]}\n"
    )
    paths[1].write_text(paths[1].read_text(encoding="utf-8") + other, encoding="utf-8")
    with pytest.raises(TrackError, match="references in the frames other, tracker; expected one frame_id"):
        references_of(load_readings(*paths, needs_joints=False), {}, "tracker.csv")


@pytest.mark.parametrize(
    ("unit", "rows", "uncertainty", "sentence"),
    [
        ("rad", "1,0,0,90,0,0\n", Uncertainty(1e-5, 0.0, 1e-4), r"column 'A': angle 90 rad.*angles in degrees\?"),
        (
            "deg",
            "1,0,0,90,0,0\n",
            Uncertainty(1e-5),
            r"has no uncertainty; expected --uncertainty ball=M,PER_METRE,RAD",
        ),
        ("deg", ",,,,,\n", Uncertainty(1e-5, 0.0, 1e-4), "holds no reading"),
    ],
)
def test_a_table_without_usable_references_is_refused(
    tmp_path: Path, unit: str, rows: str, uncertainty: Uncertainty, sentence: str
) -> None:
    paths = table(tmp_path, unit, rows)

    def read() -> EndpointReferences:
        return references_of(load_readings(*paths, needs_joints=False), {"ball": uncertainty}, "tracker.csv")

    with pytest.raises(PosorError, match=sentence):
        read()
