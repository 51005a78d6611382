# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading rows: the geometry of one scalar reading of any kind, and one way to evaluate them all.

A row is a record of dtype ROW. Its ``parameters`` are the numbers that may carry uncertainty; the named geometry fields
of each kind of reading are views of the same memory. ``prepare_row`` computes once what does not depend
on the pose. Adjacent x and y rows of the same light spot are evaluated once, as a pair.

Poses are records of dtype POSE: ``T_R_T`` with ``p_R = rotation @ p_T + translation`` [m]. Pose derivatives are with
respect to the local tangent of pinocchio: ``T_R_T * exp6((v, w))``, v [m] and w [rad] in the axes of T.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from posor.model.gap import MAX_HARMONICS, gap, gap_parameters, prepare_gap, ring_gap, ring_parameters
from posor.model.light_spot import find_spot, prepare_spot, spot_parameters, spot_tangent
from posor.numerics.compiled import in_place, record_view

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from posor.numerics.array_types import FloatArray, IntArray

GAP = 0
SPOT_X = 1
SPOT_Y = 2
RING = 3
AFFINE = 4  # a reading known by its value and derivative at one pose, see ``predict_readings``
SPOT_PAIR = 5  # this row and the next are x and y of one spot; set by ``pair_spots``, PAIRED is the next row
PAIRED = 6

PARAMETERS = 8 + 3 * MAX_HARMONICS
SPOT_PARAMETERS = 16

_GEOMETRY: dict[str, tuple[Any, int]] = {
    # Name: type, offset of the first number among the parameters.
    "parameters": (("f8", (PARAMETERS,)), 0),
    # Gap and ring probes.
    "tip": (("f8", (3,)), 0),  # in R [m]
    "axis": (("f8", (3,)), 3),  # in R
    # Gap probes.
    "plane_point": (("f8", (3,)), 6),  # in T [m]
    "tilt": (("f8", (2,)), 9),  # of the plane about X and Y of T [rad]
    "turn": ("f8", 11),  # of the tilt about Z of T [rad]
    # Ring probes.
    "mean_radius": ("f8", 6),  # [m]
    "harmonics": ("f8", 7),
    "orders": (("f8", (MAX_HARMONICS,)), 8),
    "cosines": (("f8", (MAX_HARMONICS,)), 8 + MAX_HARMONICS),  # [m]
    "sines": (("f8", (MAX_HARMONICS,)), 8 + 2 * MAX_HARMONICS),  # [m]
    # Light spots.
    "diode_origin": (("f8", (3,)), 0),  # in R [m]
    "x_axis": (("f8", (3,)), 3),  # of the diode in R
    "y_axis": (("f8", (3,)), 6),
    "source_origin": (("f8", (3,)), 9),  # in T [m]
    "ray_direction": (("f8", (3,)), 12),  # in T
    "ray_turn": ("f8", 15),  # of the direction about Z of T [rad]
    # Affine rows.
    "value": ("f8", 0),
    "derivative": (("f8", (6,)), 1),  # with respect to the local tangent
}
_PREPARED: dict[str, tuple[Any, int]] = {
    "normal": (("f8", (3,)), PARAMETERS),  # gap probes: of the plane in T
    "normal_by_tilt_x": (("f8", (3,)), PARAMETERS + 3),
    "normal_by_tilt_y": (("f8", (3,)), PARAMETERS + 6),
    "turned_ray": (("f8", (3,)), PARAMETERS),  # light spots: ray direction in T
    "axes_product": (("f8", (3,)), PARAMETERS + 3),  # light spots: x axis times y axis of the diode in R
    "gap": ("f8", PARAMETERS),  # ring probes: at the pose evaluated last [m]; NaN: none in this scan
    "surface_normal": (("f8", (3,)), PARAMETERS + 1),  # ring probes: gradient of the surface there, in T
    "multiple_cosines": (("f8", (MAX_HARMONICS,)), PARAMETERS + 4),  # ring probes: of each order times the azimuth
    "multiple_sines": (("f8", (MAX_HARMONICS,)), PARAMETERS + 4 + MAX_HARMONICS),
    "kind": ("i8", PARAMETERS + 4 + 2 * MAX_HARMONICS),
}


def _record(fields: dict[str, tuple[Any, int]]) -> np.dtype[np.void]:
    return np.dtype(
        {
            "names": list(fields),
            "formats": [form for form, _ in fields.values()],
            "offsets": [8 * offset for _, offset in fields.values()],
        }
    )


def _as_integer(form: Any) -> Any:
    return ("i8", form[1]) if isinstance(form, tuple) else "i8"


ROW_DERIVATIVES = _record(_GEOMETRY)
"""Derivatives of a reading with respect to the parameters of its row, under the same names."""
ROW_PARAMETER_IDS = _record({name: (_as_integer(form), at) for name, (form, at) in _GEOMETRY.items()})
"""Numbers of the parameters of a row in a parameter vector, under the same names."""
ROW = _record(_GEOMETRY | _PREPARED)  # one reading row
POSE = np.dtype([("rotation", "f8", (3, 3)), ("translation", "f8", (3,))], align=True)
"""A pose ``T_R_T``: R_R_T and the origin of T in R [m]."""


@in_place
def prepare_row(row: Any) -> None:
    """Write the fields of a row that do not depend on the pose."""
    if row.kind == GAP:
        prepare_gap(row)
    elif row.kind in (SPOT_X, SPOT_Y, SPOT_PAIR, PAIRED):
        prepare_spot(row)
    elif row.kind == RING:
        row.gap = np.nan


@in_place
def begin_scan(row: Any) -> None:
    """Discard the intersection of the previous scan, so that the result does not depend on earlier scans."""
    if row.kind == RING:
        row.gap = np.nan


@in_place
def prepare_rows(rows: NDArray[np.void]) -> None:
    """Prepare all rows, shape (m,)."""
    for r in range(rows.shape[0]):
        prepare_row(rows[r])


@in_place
def turn_row(row: Any, turn: float) -> None:
    """Turn what a row has fixed in the target by an angle [rad] about Z of T; ring and affine rows do not turn."""
    if row.kind == GAP:
        row.turn = turn
    elif row.kind in (SPOT_X, SPOT_Y, SPOT_PAIR, PAIRED):
        row.ray_turn = turn
    prepare_row(row)


@in_place
def turn_rows(rows: NDArray[np.void], turn: float) -> None:
    """Turn all rows, shape (m,); see ``turn_row``."""
    for r in range(rows.shape[0]):
        turn_row(rows[r], turn)


@in_place
def pair_spots(rows: NDArray[np.void], count: int) -> None:
    """Mark which of the first ``count`` rows are x and y of one spot, so that the spot is found once."""
    for r in range(count - 1):
        if rows[r].kind == SPOT_X and rows[r + 1].kind == SPOT_Y:
            same = True
            for k in range(SPOT_PARAMETERS):
                same = same and rows[r].parameters[k] == rows[r + 1].parameters[k]
            if same:
                rows[r].kind = SPOT_PAIR
                rows[r + 1].kind = PAIRED


@in_place
def predict_readings(
    rows: NDArray[np.void], count: int, pose: Any, step_sum: FloatArray, predicted: FloatArray, jacobian: FloatArray
) -> None:
    """Write what the first ``count`` rows read at a pose, (m,) [m], and the tangent derivatives, (m, 6).

    ``rows``: reading rows, shape (m,), dtype ROW. ``count``: how many rows to evaluate. ``pose``: record of dtype POSE.
    ``step_sum``: sum of the tangent steps since the pose at which affine rows were expanded, shape (6,): they read
    ``value + derivative . step_sum``. ``predicted``: readings to write. ``jacobian``: derivatives to write.
    """
    for r in range(count):
        row = rows[r]
        kind = row.kind
        if kind == GAP:
            predicted[r] = gap(row, pose, jacobian, r)
        elif kind in (SPOT_PAIR, SPOT_X, SPOT_Y):
            spot = find_spot(row, pose)
            if kind != SPOT_Y:
                predicted[r] = spot.x
                spot_tangent(row, pose, spot.along_ray, spot.inverse_x, jacobian, r)
            if kind != SPOT_X:
                to = r + 1 if kind == SPOT_PAIR else r
                predicted[to] = spot.y
                spot_tangent(row, pose, spot.along_ray, spot.inverse_y, jacobian, to)
        elif kind == RING:
            predicted[r] = ring_gap(row, pose, jacobian, r)
        elif kind == AFFINE:
            reading = row.value
            for i in range(6):
                jacobian[r, i] = row.derivative[i]
                reading += row.derivative[i] * step_sum[i]
            predicted[r] = reading


@in_place
def differentiate_by_parameters(rows: NDArray[np.void], count: int, pose: Any, derivatives: NDArray[np.void]) -> None:
    """Write the derivatives of the first ``count`` rows with respect to their own parameters, shape (m,).

    Parameters that a kind of row does not have are left unchanged.
    """
    for r in range(count):
        row = rows[r]
        kind = row.kind
        if kind == GAP:
            gap_parameters(row, pose, derivatives[r])
        elif kind in (SPOT_PAIR, SPOT_X, SPOT_Y):
            spot = find_spot(row, pose)
            if kind != SPOT_Y:
                spot_parameters(row, pose, spot, spot.inverse_x, derivatives[r])
            if kind != SPOT_X:
                spot_parameters(row, pose, spot, spot.inverse_y, derivatives[r + 1 if kind == SPOT_PAIR else r])
        elif kind == RING:
            ring_parameters(row, pose, derivatives[r])


@in_place
def _evaluate(
    rows: NDArray[np.void], pose: NDArray[np.void], step_sum: FloatArray, predicted: FloatArray, jacobian: FloatArray
) -> None:
    prepare_rows(rows)
    predict_readings(rows, rows.shape[0], pose[0], step_sum, predicted, jacobian)


@in_place
def _differentiate(rows: NDArray[np.void], pose: NDArray[np.void], derivatives: NDArray[np.void]) -> None:
    differentiate_by_parameters(rows, rows.shape[0], pose[0], derivatives)


@in_place
def _evaluate_poses(
    reading_rows: NDArray[np.void],
    selected: IntArray,
    poses: NDArray[np.void],
    step_sum: FloatArray,
    jacobian: FloatArray,
    out: FloatArray,
) -> None:
    prepare_rows(reading_rows)
    for n in range(selected.shape[0]):
        for r in range(selected.shape[1]):
            k = selected[n, r]
            predict_readings(reading_rows[k : k + 1], 1, poses[n], step_sum, out[n, r : r + 1], jacobian)


def make_poses(rotations: FloatArray, translations: FloatArray) -> NDArray[np.void]:
    """Return poses (n,) of dtype POSE from rotations (n, 3, 3) and translations (n, 3) [m]."""
    poses = np.empty(len(rotations), dtype=POSE)
    poses["rotation"], poses["translation"] = rotations, translations
    return poses


def evaluate_rows(
    rows: NDArray[np.void], rotation: FloatArray, translation: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what rows (m,) read at ``T_R_T`` [m], (m,), and the derivatives by the local tangent, (m, 6)."""
    predicted, jacobian = np.empty(len(rows)), np.empty((len(rows), 6))
    poses = make_poses(rotation[None], translation[None])
    _evaluate(record_view(rows), record_view(poses), np.zeros(6), predicted, jacobian)
    return predicted, jacobian


def differentiate_rows(rows: NDArray[np.void], rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Return the derivatives of rows (m,) at ``T_R_T`` with respect to their own parameters, (m, PARAMETERS)."""
    derivatives = np.zeros(len(rows), dtype=ROW_DERIVATIVES)
    poses = make_poses(rotation[None], translation[None])
    _evaluate(record_view(rows), record_view(poses), np.zeros(6), np.empty(len(rows)), np.empty((len(rows), 6)))
    _differentiate(record_view(rows), record_view(poses), record_view(derivatives))
    out: FloatArray = derivatives["parameters"]
    return out


def evaluate_poses(
    reading_rows: NDArray[np.void], selected: IntArray, rotations: FloatArray, translations: FloatArray
) -> FloatArray:
    """Return what the selected rows (n, m) read at n poses, (n, m) [m]; no affine rows."""
    out = np.empty(selected.shape)
    poses = make_poses(rotations, translations)
    _evaluate_poses(
        record_view(reading_rows.copy()),
        np.ascontiguousarray(selected),
        record_view(poses),
        np.zeros(6),
        np.empty((1, 6)),
        out,
    )
    return out
