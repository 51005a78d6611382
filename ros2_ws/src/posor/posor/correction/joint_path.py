# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Programs of a robot as joint angles over time: CSV with units, or YAML of a ``trajectory_msgs/JointTrajectory``."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import yaml
from pydantic import Field, ValidationError
from scipy.interpolate import CubicHermiteSpline

from posor.calibration.file_model import FrozenModel, all_problems
from posor.calibration.yaml_document import FileLocations, parse_yaml, read_text
from posor.errors import CalibrationError, DataFileError, sum_up
from posor.numerics.stamps import NS
from posor.tables.table_file import open_table
from posor.tables.table_map import FileLayout
from posor.tables.table_units import unit_in_name

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor.numerics.array_types import FloatArray

PERIOD_TOLERANCE = 1e-6  # by which a path may be longer than a whole number of periods, in periods
TIME = "time"  # first word of the column of times
YAML_SUFFIXES, CSV_SUFFIX = (".yaml", ".yml"), ".csv"


@dataclass(frozen=True)
class JointPath:
    """Joint angles at n times."""

    joints: tuple[str, ...]  # (j,)
    times_s: FloatArray  # increasing [s], (n,)
    angles: FloatArray  # [rad], (n, j)
    velocities: FloatArray | None = None  # [rad/s], (n, j); None: not stated, straight lines between the rows
    source: str = "the path"

    def __post_init__(self) -> None:
        """Check the rows. Raises DataFileError: times do not increase, or a number is not finite."""
        if not self.angles.size:
            raise DataFileError("holds no joint or no row", where=self.source, expected="times and joint angles")
        columns = [self.times_s, *self.angles.T, *([] if self.velocities is None else self.velocities.T)]
        names = ["the time", *(f"{what} of {name}" for what in ("the angle", "the velocity") for name in self.joints)]
        for name, column in zip(names, columns, strict=False):
            if (wrong := np.flatnonzero(~np.isfinite(column))).size:
                where = f"{self.source}, row {wrong[0] + 1}"
                raise DataFileError(f"{name} is {column[wrong[0]]}", where=where, expected="a finite number")
        if (back := np.flatnonzero(np.diff(self.times_s) <= 0.0)).size:
            before, after = self.times_s[back[0] : back[0] + 2]
            what = f"time {after:g} s follows {before:g} s"
            raise DataFileError(what, where=f"{self.source}, row {back[0] + 2}", expected="increasing times")

    @property
    def duration_s(self) -> float:
        """Time of the last row [s]."""
        return float(self.times_s[-1])

    def of_joints(self, joints: Sequence[str]) -> JointPath:
        """Return the path with the joints in another order. Raises DataFileError: other joints."""
        if sorted(joints) != sorted(self.joints):
            what = f"has the joints {', '.join(self.joints)}"
            raise DataFileError(what, where=self.source, expected=", ".join(joints))
        order = [self.joints.index(name) for name in joints]
        velocities = None if self.velocities is None else self.velocities[:, order]
        return replace(self, joints=tuple(joints), angles=self.angles[:, order], velocities=velocities)

    def sampler(self) -> Callable[[Any], FloatArray]:
        """Return a function of times [s], (m,) or one: angles (m, j) or (j,); those of the ends before and after."""
        if len(self.times_s) == 1:
            return lambda times_s: np.tile(self.angles[0], (*np.shape(times_s), 1))
        slopes = np.diff(self.angles, axis=0) / np.diff(self.times_s)[:, None]
        spline = None if self.velocities is None else CubicHermiteSpline(self.times_s, self.angles, self.velocities)

        def sample(times_s: Any) -> FloatArray:
            within = np.clip(times_s, self.times_s[0], self.times_s[-1])
            if spline is not None:
                return np.asarray(spline(within))
            row = np.clip(np.searchsorted(self.times_s, within, side="right") - 1, 0, len(slopes) - 1)
            return np.asarray(self.angles[row] + (within - self.times_s[row])[..., None] * slopes[row])

        return sample

    def at_period(self, period_s: float) -> JointPath:
        """Return the path with rows at a period [s] from its first row on; those of its end are held up to the last."""
        count = math.ceil((self.times_s[-1] - self.times_s[0]) / period_s - PERIOD_TOLERANCE)
        times_s = self.times_s[0] + period_s * np.arange(max(1, count) + 1)
        return replace(self, times_s=times_s, angles=self.sampler()(times_s), velocities=None)

    def moved(self, offsets: FloatArray) -> JointPath:
        """Return the path with offsets at its rows (n, j) [rad], and the velocities that belong to it."""
        velocities = self.velocities
        if velocities is not None:
            velocities = velocities + np.gradient(offsets, self.times_s, axis=0)
        return replace(self, angles=self.angles + offsets, velocities=velocities)

    def text(self, *, as_yaml: bool) -> str:
        """Return the text of a file: CSV in seconds and radians, or YAML of a JointTrajectory."""
        if not as_yaml:
            rows = np.column_stack([self.times_s, self.angles]).tolist()
            header = ",".join([f"{TIME} [s]", *(f"{name} [rad]" for name in self.joints)])
            return "\n".join([header, *(",".join(map(repr, row)) for row in rows), ""])
        points = []
        for n, time_ns in enumerate(np.round(self.times_s * NS).astype(np.int64).tolist()):
            point: dict[str, Any] = {"positions": self.angles[n].tolist()}
            if self.velocities is not None:
                point["velocities"] = self.velocities[n].tolist()
            points.append({**point, "time_from_start": dict(zip(("sec", "nanosec"), divmod(time_ns, NS), strict=True))})
        return yaml.safe_dump(
            {"joint_names": list(self.joints), "points": points}, default_flow_style=None, sort_keys=False
        )


class _Duration(FrozenModel):
    sec: Annotated[int, Field(strict=True, ge=0)] = 0
    nanosec: Annotated[int, Field(strict=True, ge=0, lt=NS)] = 0


_Number = Annotated[float, Field(strict=True)]  # neither true nor a text


class _Point(FrozenModel):
    positions: tuple[_Number, ...]
    velocities: tuple[_Number, ...] = ()
    accelerations: Annotated[tuple[float, ...], Field(max_length=0)] = ()  # would contradict the corrected positions
    effort: Annotated[tuple[float, ...], Field(max_length=0)] = ()
    time_from_start: _Duration = _Duration()


class _Trajectory(FrozenModel):
    header: Any = None
    joint_names: Annotated[tuple[str, ...], Field(min_length=1)]
    points: Annotated[tuple[_Point, ...], Field(min_length=1)]


def read_path(path: Path) -> JointPath:
    """Read a program.

    CSV: the columns ``time [s]`` and ``<joint> [rad]``, in any unit of time and angle. YAML: a JointTrajectory with
    positions, and velocities or not. Raises PosorError: the file cannot be read, or is another one.
    """
    return _read_yaml(path) if path.suffix.lower() in YAML_SUFFIXES else _read_csv(path)


def _read_csv(path: Path) -> JointPath:
    table = open_table(path, FileLayout())
    columns = range(len(table.columns))
    cells = table.read(columns, ())
    if cells.incomplete:
        place, what, expected = cells.incomplete[0]
        raise DataFileError(what, where=table.place(place), expected=expected)
    joints, values = [], []
    for n, column in enumerate(table.columns):
        unit, name = unit_in_name(column.name), column.name.split("[")[0].split("(")[0].strip()
        si, example = ("rad", f"'{name} [rad]'") if n else ("s", f"'{TIME} [s]'")
        if unit is None or unit.si != si or not (n or name == TIME):
            raise DataFileError(f"column {n + 1} is '{column.name}'", where=str(path), expected=f"such as {example}")
        if (missing := np.flatnonzero(np.isnan(cells.numbers[n]))).size:
            where = table.place(int(cells.places[missing[0]]), n)
            raise DataFileError("is no number", where=where, expected="a number in each cell")
        joints.append(name)
        values.append(cells.numbers[n] * float(unit.factor))
    return JointPath(tuple(joints[1:]), values[0], np.transpose(values[1:]), None, str(path))


def _read_yaml(path: Path) -> JointPath:
    root, content = parse_yaml(read_text(path, "joint trajectory"), str(path))
    locations = FileLocations(str(path), root)
    try:
        trajectory = _Trajectory.model_validate(content)
    except ValidationError as error:
        problems = all_problems(error, content, _Trajectory.model_validate)
        errors = [
            CalibrationError(each.what, where=locations.describe(*each.location), expected=each.expected)
            for each in problems
        ]
        raise sum_up(errors) from error
    count, has_velocities = len(trajectory.joint_names), bool(trajectory.points[0].velocities)
    for n, point in enumerate(trajectory.points):
        if len(point.positions) != count or len(point.velocities) != count * has_velocities:
            what = f"{len(point.positions)} positions and {len(point.velocities)} velocities"
            expected = f"{count} and {count * has_velocities}, as joint_names and the first point"
            raise DataFileError(what, where=locations.describe("points", n), expected=expected)
    return JointPath(
        trajectory.joint_names,
        np.array([each.time_from_start.sec + each.time_from_start.nanosec / NS for each in trajectory.points]),
        np.array([each.positions for each in trajectory.points]),
        np.array([each.velocities for each in trajectory.points]) if has_velocities else None,
        str(path),
    )
