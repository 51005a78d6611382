# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The poses that a statement covers: given angles, a grid of the workspace, a path, or a recorded bag."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from posor.bags.offline_pipeline import Arm
from posor.errors import BagError, ChainError, DataFileError, ParameterError
from posor.tables.named_rows import read_named_rows
from posor.tables.number_text import parse_number

from posor_design.dwell_scatter import dwell_scatter

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from posor.chain.arm_file import ArmFile
    from posor.numerics.array_types import FloatArray

    from posor_design.arm_uncertainty import ArmUncertainty

MOST_POSES = 20_000  # of a grid or a path
BAG_POSES = 100  # of a bag without dwell
REACH_STEPS = 360  # angles of a turn at which the reach of a joint is tried
TURN = 2.0 * math.pi
NEAR = 1e-3  # an arm whose joints are within this of the given angles may stand there [rad]
STILL = 1e-4  # it stands there while its joints stay within this of their median [rad]
LEAST_SCANS = 10  # of a dwell


@dataclass(frozen=True)
class StatementPoses:
    """Poses of an arm, and what is known of the measurement there."""

    angles: FloatArray  # of the joints between base and endpoint [rad], (n, j)
    names: Sequence[str]  # what each pose is, such as ``line 3 of path.csv``
    notes: Sequence[str] = ()  # sentences on poses and scans that are left out
    # Observed covariance of the result of each joint, (6, 6), and its degrees of freedom; empty: noise as stated
    observed: Mapping[str, tuple[FloatArray, float]] = field(default_factory=dict)
    stamp_shifts: FloatArray | None = None  # largest errors of the endpoint by errors of the stamps, (n, 6)
    lines: Sequence[int] = ()  # of the table that states the poses; empty: no table


def check_angles(angles: Sequence[float], joints: Sequence[str], where: str) -> None:
    """Raise ParameterError: the number of angles is wrong, or an angle is not in radians."""
    if len(angles) != len(joints):
        expected = f"{len(joints)}: {','.join(joints)}"
        raise ParameterError(f"{len(angles)} angles", where=where, expected=expected)
    for joint, angle in zip(joints, angles, strict=True):
        if abs(angle) > TURN:
            what = f"{joint} {angle:g} rad is more than one turn"
            expected = f"radians ({angle:g} degrees are {math.radians(angle):.4f})"
            raise ParameterError(what, where=where, expected=expected)


def given_pose(model: ArmUncertainty, angles: Sequence[float]) -> StatementPoses:
    """Return one pose. Raises ParameterError: see ``check_angles``."""
    check_angles(angles, model.joints, "statement, --angles")
    return StatementPoses(np.array([angles], dtype=float), ["given"])


def path_poses(model: ArmUncertainty, path: Path) -> StatementPoses:
    """Return the poses of a table (CSV): a column of angles [rad] for each joint, named by it.

    Raises DataFileError: the file cannot be read, lacks a joint, or has an invalid angle.
    """
    rows = read_named_rows(path, model.joints)
    if len(rows) > MOST_POSES:
        raise DataFileError(f"{len(rows)} poses", where=str(path), expected=f"at most {MOST_POSES}")
    angles = np.empty((len(rows), len(model.joints)))
    for n, (line, cells) in enumerate(rows):
        where = f"{path}, line {line}"
        for j, joint in enumerate(model.joints):
            try:
                angles[n, j] = parse_number(cells[joint])
            except ValueError:
                angles[n, j] = math.nan
            if not math.isfinite(angles[n, j]):
                what, expected = f"angle of {joint} is '{cells[joint]}'", f"{len(model.joints)} angles in rad"
                raise DataFileError(what, where=where, expected=expected)
        check_angles(angles[n].tolist(), model.joints, where)
    lines = [row.line for row in rows]
    return StatementPoses(angles, [f"line {line} of {path.name}" for line in lines], lines=lines)


def grid_poses(model: ArmUncertainty, count: int) -> StatementPoses:
    """Return a grid over the workspace: ``count`` angles of each joint over the range in which its POSOR has a pose.

    Raises ParameterError: there are too many poses. Raises ChainError: a POSOR has no pose at any angle.
    """
    if count ** len(model.joints) > MOST_POSES:
        most = math.floor(MOST_POSES ** (1.0 / len(model.joints)))
        what = f"{count} angles of {len(model.joints)} joints are {count ** len(model.joints)} poses"
        raise ParameterError(what, where="statement, --grid", expected=f"1 to {most}")
    axes = [_grid_axis(model, j, count) for j in range(len(model.joints))]
    angles = np.stack([each.ravel() for each in np.meshgrid(*axes, indexing="ij")], axis=1)
    within = model.reachable(angles)
    left_out = int(np.count_nonzero(~within))
    notes = (
        [f"{left_out} of {len(angles)} poses of the grid are left out: a POSOR has no pose there."] if left_out else []
    )
    return StatementPoses(angles[within], [f"pose {n + 1} of the grid" for n in np.flatnonzero(within)], notes)


def _grid_axis(model: ArmUncertainty, joint: int, count: int) -> FloatArray:
    tried = np.zeros((REACH_STEPS, len(model.joints)))
    tried[:, joint] = np.linspace(-math.pi, math.pi, REACH_STEPS, endpoint=False)
    valid = tried[model.reachable(tried), joint]
    if not valid.size:
        raise ChainError("has no valid pose at any angle", where=f"joint '{model.joints[joint]}'")
    whole = valid.size == REACH_STEPS
    return np.linspace(valid[0], math.pi if whole else valid[-1], count, endpoint=not whole)


def bag_poses(
    model: ArmUncertainty, arm: ArmFile, bag: Path, angles: Sequence[float] | None, scans: int
) -> StatementPoses:
    """Return the poses of a recorded bag.

    With ``angles`` the pose is that of the scans during which the arm stood there; the scatter of the means of
    ``scans`` of them is the noise. Without, the poses are spread evenly over the bag.

    Raises BagError: no scan has a pose, or the arm does not stand at the angles. Raises PosorError: the bag or a file
    cannot be used.
    """
    if angles is not None:
        check_angles(angles, model.joints, "statement, --angles")
    estimates = Arm(**vars(arm)).estimate(bag)
    notes = [f"{each}." for each in estimates.notes]
    end, order = estimates.endpoint_of_one_run(str(bag)), [estimates.chain.index(joint) for joint in model.joints]
    recorded = end.angles[:, order]
    if angles is None:
        selected = np.unique(np.linspace(0, len(end) - 1, BAG_POSES).round().astype(int))
        names = [f"{stamp} ns of {bag.name}" for stamp in end.stamps_ns[selected]]
        shifts = end.stamp_shifts[selected]
        return StatementPoses(recorded[selected], names, notes, stamp_shifts=shifts if shifts.any() else None)
    away = np.abs(recorded - np.asarray(angles)).max(axis=1)
    there = away <= NEAR
    if there.any():
        there &= np.abs(recorded - np.median(recorded[there], axis=0)).max(axis=1) <= STILL
    if np.count_nonzero(there) < LEAST_SCANS:
        nearest = ", ".join(f"{angle:.4f}" for angle in recorded[int(np.argmin(away))])
        what = f"the arm stands at --angles in {np.count_nonzero(there)} scans; the nearest has {nearest} rad"
        raise BagError(what, where=str(bag), expected=f"at least {LEAST_SCANS} scans, within {NEAR:g} rad")
    stamps = end.stamps_ns[there]
    observed = {}
    for joint in model.joints:
        own = estimates.joints[joint]
        during = np.isin(own.stamps_ns, stamps)
        scatter = dwell_scatter(own.poses[during], own.stamps_ns[during], scans, str(bag))
        observed[joint] = scatter.covariance, scatter.freedoms
        if scatter.slow.any():
            size = f"{1e6 * scatter.slow[:3].max():.2g} µm and {1e6 * scatter.slow[3:].max():.2g} µrad"
            notes.append(f"{joint} moved slowly or its noise lasts for many scans: {size}, which are not in U.")
    largest = end.stamp_shifts[there].max(axis=0, keepdims=True)
    return StatementPoses(
        recorded[there].mean(axis=0, keepdims=True),
        [f"{len(stamps)} scans of {bag.name} from {stamps[0]} to {stamps[-1]} ns"],
        notes,
        observed,
        largest if largest.any() else None,
    )
