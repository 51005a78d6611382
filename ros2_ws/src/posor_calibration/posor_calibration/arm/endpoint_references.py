# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""References of the endpoint: points or poses of reflectors, and distances from a fixed ball to a ball on the tool.

A row of a table is one reading of one reflector. A distance of zero is a ball on the tool in one fixed seat (closure on
one sphere). Wrong units, columns and orders of angles show in what no placing of the references can change: distances
between points, and turns from row to row.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from posor.bags.recording import POINT, POSE
from posor.errors import TrackError
from scipy.spatial.transform import Rotation

from posor_calibration.data_checks import WRONG_UNITS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import pinocchio as pin
    from posor.numerics.array_types import FloatArray, IntArray
    from posor.tables.table_readings import ReferenceReadings, TableReadings

Kind = Literal["point", "pose", "distance"]
CLEAR_DISTANCE, CLEAR_ANGLE = 0.05, 0.05  # distances [m] and angles [rad] between rows that are compared
LARGEST_RATIO = 3.0  # of distances between points by the references and by the arm
UNIT_TOLERANCE = 0.3  # relative distance from the factor of a wrong unit
LARGEST_ANGLE_ERROR = 0.02  # median difference of turns from row to row [rad]
BETTER = 0.1  # share of the difference that remains if a supposed mistake explains it
LEAST_ROWS = 3
UNIT_QUATERNION = 1e-3  # largest difference of a length from one
MIRRORED = 0.02  # misfit of placed points, relative to their spread, that a mirror must explain
ORDERS = (*map("".join, permutations("xyz")), "xyx", "xzx", "yxy", "yzy", "zxz", "zyz")


class Uncertainty(NamedTuple):
    """Standard uncertainties of an instrument along each axis: constant [m], per metre of distance, of angles [rad]."""

    constant: float
    per_metre: float = 0.0
    angle: float = 0.0


class Reading(NamedTuple):
    """A reading of a reflector."""

    name: str  # such as "row 12 of smr1"
    pose: int  # number of the arm's pose
    reflector: str
    kind: Kind
    values: FloatArray  # point (3,), pose (7,) or distance (1,), in the frame of the references
    angles: FloatArray | None  # of a pose whose table has angles, (3,) [rad]
    sigmas: FloatArray  # (3,), (6,) or (1,); of a distance of zero (3,)


@dataclass(frozen=True)
class EndpointReferences:
    """All readings of a table."""

    stamps_ns: IntArray  # of the rows, (n,)
    rows: IntArray  # number of each row in the table, from 1, (n,)
    readings: tuple[Reading, ...]
    angle_orders: Mapping[str, str]  # of reflectors whose table has angles

    def of(self, reflector: str) -> list[Reading]:
        """Return the readings of one reflector."""
        return [reading for reading in self.readings if reading.reflector == reflector]

    @property
    def reflectors(self) -> dict[str, Kind]:
        """The kind of each reflector."""
        return {reading.reflector: reading.kind for reading in self.readings}


def references_of(table: TableReadings, uncertainties: Mapping[str, Uncertainty], where: str) -> EndpointReferences:
    """Return the readings of a table.

    ``uncertainties``: by the name of the reference in the map; of distances those of the map hold. Raises TrackError:
    a reference has no uncertainty or is no length, frames differ, or there is no reading.
    """
    frames = sorted({track.entry.frame_id for track in table.references.values()})
    if len(frames) > 1:
        raise TrackError(f"has references in the frames {', '.join(frames)}", where=where, expected="one frame_id")
    readings: list[Reading] = []
    for name, track in table.references.items():
        readings += _readings(name, track, uncertainties.get(name), where)
    if not readings:
        raise TrackError("holds no reading", where=where, expected="a point, pose or distance in each row")
    used = sorted({reading.pose for reading in readings})
    number = {pose: n for n, pose in enumerate(used)}
    kept = tuple(reading._replace(pose=number[reading.pose]) for reading in readings)
    orders = {name: track.entry.order for name, track in table.references.items() if track.entry.order}
    return EndpointReferences(table.stamps_ns[used], np.array(used) + 1, kept, orders)


def _readings(name: str, track: ReferenceReadings, uncertainty: Uncertainty | None, where: str) -> Iterator[Reading]:
    kind: Kind = {1: "distance", POINT: "point", POSE: "pose"}[track.values.shape[1]]  # type: ignore[assignment]
    place = f"{where}, reference '{name}'"
    stated = track.entry.standard_uncertainty
    if stated is not None and stated.unit != "m":
        raise TrackError(f"reads {stated.unit}", where=place, expected="a distance in m, a point or a pose")
    if stated is not None:
        uncertainty = uncertainty or Uncertainty(stated.number)
    if uncertainty is None or not uncertainty.constant > 0.0 or (kind == "pose" and not uncertainty.angle > 0.0):
        expected = f"--uncertainty {name}=M,PER_METRE" + (",RAD" if kind == "pose" else "")
        raise TrackError("has no uncertainty", where=place, expected=expected)
    for row, values in enumerate(track.values):
        if np.isnan(values).any():
            continue
        if kind == "distance" and values[0] < 0.0:
            raise TrackError(f"distance {values[0]:g} m", where=f"{place}, row {row + 1}", expected="0 or more")
        if kind == "pose" and not abs(np.linalg.norm(values[POINT:]) - 1.0) <= UNIT_QUATERNION:
            what = f"quaternion of length {np.linalg.norm(values[POINT:]):g}"
            raise TrackError(what, where=f"{place}, row {row + 1}", expected="1")
        length = uncertainty.constant + uncertainty.per_metre * float(np.linalg.norm(values[:POINT]))
        sigmas = np.full(POINT if kind != "distance" or values[0] == 0.0 else 1, length)
        if kind == "pose":
            sigmas = np.append(sigmas, np.full(3, uncertainty.angle))
        angles = None if track.angles is None else track.angles[row]
        yield Reading(f"row {row + 1} of {name}", row, name, kind, values, angles, sigmas)


def check_references(
    references: EndpointReferences, endpoints: Sequence[pin.SE3], tools: Mapping[str, pin.SE3], where: str
) -> None:
    """Refuse units, columns and angles that the arm contradicts.

    ``endpoints``: of the poses, by the arm before the calibration; ``tools``: the reflectors in the endpoint. Raises
    TrackError: names the mistake that explains the readings, if one does.
    """
    for name, kind in references.reflectors.items():
        own, place = references.of(name), f"{where}, reference '{name}'"
        arm = [endpoints[reading.pose] * tools[name] for reading in own]
        if kind == "distance" or len(own) < LEAST_ROWS:
            continue
        values = np.array([reading.values for reading in own])
        points = np.array([pose.translation for pose in arm])
        _check_lengths(values[:, :POINT], points, place)
        if kind == "pose":
            order = references.angle_orders.get(name, "")
            angles = np.array([reading.angles for reading in own]) if order else None
            _check_angles(Rotation.from_quat(values[:, POINT:]), arm, angles, order, place)
        _check_hand(values[:, :POINT], points, place)


def _check_lengths(points: FloatArray, arm: FloatArray, where: str) -> None:
    seen, expected = (np.linalg.norm(each[:, None] - each[None], axis=2) for each in (points, arm))
    clear = expected > CLEAR_DISTANCE
    if not clear.any():
        return
    ratio = float(np.median(seen[clear] / expected[clear]))
    causes = [text for factor, text in WRONG_UNITS.items() if abs(ratio / factor - 1.0) < UNIT_TOLERANCE]
    if causes or not 1.0 / LARGEST_RATIO < ratio < LARGEST_RATIO:
        what = f"distances between rows are {ratio:.4g} times those of the arm"
        raise TrackError(what, where=where, expected="about 1" + (f": perhaps {causes[0]}" if causes else ""))


def _check_hand(points: FloatArray, arm: FloatArray, where: str) -> None:
    """Refuse points that only a mirror brings onto those of the arm."""
    a, b = points - points.mean(axis=0), arm - arm.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    plain = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    misfits = [np.median(np.linalg.norm(a - b @ turn.T, axis=1)) for turn in (plain, left @ right)]
    if misfits[0] > MIRRORED * np.median(np.linalg.norm(b, axis=1)) and misfits[1] < BETTER * misfits[0]:
        expected = "a right-handed frame: has one axis the other sign, or are two columns exchanged?"
        raise TrackError("points are those of the arm in a mirror", where=where, expected=expected)


def _check_angles(given: Rotation, arm: Sequence[pin.SE3], angles: FloatArray | None, order: str, where: str) -> None:
    """Refuse orientations whose turns from row to row are not those of the arm; ``angles``: of the table."""
    drawn = Rotation.from_matrix([pose.rotation for pose in arm])
    error = _turn_error(given, drawn)
    if error <= LARGEST_ANGLE_ERROR:
        return
    limit = max(BETTER * error, 0.5 * LARGEST_ANGLE_ERROR)
    causes = [name for name, turned in _mistakes(given, angles, order) if _turn_error(turned, drawn) < limit]
    what = f"turns from row to row differ from those of the arm by {np.degrees(error):.3g} degrees"
    expected = f"at most {np.degrees(LARGEST_ANGLE_ERROR):.3g}" + (f": perhaps {' or '.join(causes)}" if causes else "")
    raise TrackError(what, where=where, expected=expected)


def _turn_error(given: Rotation, drawn: Rotation) -> float:
    """Return the median difference of the turns from row to row [rad], but for one turn of all of them, the tool's."""
    turns, expected = ((each[:-1].inv() * each[1:]).as_rotvec() for each in (given, drawn))
    clear = np.linalg.norm(expected, axis=1) > CLEAR_ANGLE
    if clear.sum() < LEAST_ROWS:
        return 0.0
    tool = Rotation.align_vectors(turns[clear], expected[clear])[0]
    return float(np.median(np.linalg.norm(turns[clear] - tool.apply(expected[clear]), axis=1)))


def _mistakes(given: Rotation, angles: FloatArray | None, order: str) -> Iterator[tuple[str, Rotation]]:
    """Yield what each mistake in the map or the table would have turned into these orientations."""
    yield "the orientation of the base in the reflector: inverse rotations", given.inv()
    if angles is None:
        x, y, z, w = given.as_quat().T
        yield "w, x, y, z in the order of x, y, z, w", Rotation.from_quat(np.column_stack([y, z, w, x]))
        yield "x, y, z, w in the order of w, x, y, z", Rotation.from_quat(np.column_stack([w, x, y, z]))
        return
    yield "angles in degrees, read as radians", Rotation.from_euler(order, np.radians(angles))
    yield "angles in radians, read as degrees", Rotation.from_euler(order, np.degrees(angles))
    for name in (*ORDERS, *(each.upper() for each in ORDERS)):
        if name != order:
            yield f"another order of the angles, {name}", Rotation.from_euler(name, angles)
