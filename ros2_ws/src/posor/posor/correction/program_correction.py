# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Corrects a recorded program by the endpoints that were measured while a robot ran it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize_scalar

from posor.errors import DataFileError

if TYPE_CHECKING:
    from posor.correction.joint_correction import CorrectionLimits
    from posor.correction.joint_path import JointPath
    from posor.correction.nominal_robot import NominalRobot
    from posor.numerics.array_types import FloatArray

STEP_S = 0.01  # of the search for the time at which a program began
SLACK_S = 0.1  # by which scans may be missing at either end
LARGEST_DEVIATION = 0.1  # between the same, of one joint at one time, with the lag of its servo [rad]
LARGEST_MISFIT = 0.02  # rms between measured angles and those of the program that ran [rad]


@dataclass(frozen=True)
class MeasuredRun:
    """Endpoints measured while a robot ran a program, m scans."""

    times_s: FloatArray  # increasing [s], (m,)
    angles: FloatArray  # where the controller had the joints [rad], (m, j)
    poses: FloatArray  # endpoint in the base: x, y, z [m], unit quaternion x, y, z, w, (m, 7)
    source: str = "the run"

    def joint_errors(self, robot: NominalRobot) -> FloatArray:
        """Return the joint errors of each scan, (m, j) [rad]."""
        rows = zip(self.angles, self.poses, strict=True)
        return np.array([robot.joint_errors(angles, pin.XYZQUATToSE3(pose)) for angles, pose in rows])


def begin_of_program(path: JointPath, times_s: FloatArray, angles: FloatArray) -> float:
    """Return when a program began, on the clock of ``times_s`` (m,) [s], by measured joint angles (m, j) [rad].

    Raises DataFileError: the whole program is not among the angles.
    """
    first_s, last_s = times_s[0] - path.times_s[0] - SLACK_S, times_s[-1] - path.times_s[-1] + SLACK_S
    if last_s < first_s:  # a program in milliseconds would need more memory than there is
        what = f"the measured angles last {np.ptp(times_s):g} s, the program {np.ptp(path.times_s):g} s"
        raise DataFileError(what, where=path.source, expected="the recording of a whole run, and times in seconds")
    own_s = np.union1d(np.arange(path.times_s[0], path.times_s[-1] + STEP_S, STEP_S), path.times_s)
    wanted = path.sampler()(own_s)

    def deviations(begin_s: float) -> FloatArray:
        return np.column_stack([np.interp(begin_s + own_s, times_s, column) for column in angles.T]) - wanted

    def misfit(begin_s: float) -> float:
        return float(np.sqrt(np.mean(np.square(deviations(begin_s)))))

    begins_s = np.arange(first_s, last_s + STEP_S, STEP_S)
    misfits = [misfit(begin_s) for begin_s in begins_s]
    if min(misfits) > LARGEST_MISFIT:
        what = (
            f"the joints do not run the program {path.source}: the nearest part differs by {min(misfits):.3g} rad rms"
        )
        expected = f"at most {LARGEST_MISFIT:g} rad rms, and the program that ran"
        raise DataFileError(what, where="the measured angles", expected=expected)
    middle_s = begins_s[int(np.argmin(misfits))]
    bounds = middle_s - STEP_S, middle_s + STEP_S
    begin_s = float(minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": 1e-6}).x)
    largest = np.abs(deviations(begin_s))
    n, joint = np.unravel_index(int(np.argmax(largest)), largest.shape)
    if largest[n, joint] > LARGEST_DEVIATION:
        what = f"{path.joints[joint]} is {largest[n, joint]:.3g} rad from the program {path.source} at {own_s[n]:.6g} s"
        expected = f"at most {LARGEST_DEVIATION:g} rad, and the program that ran"
        raise DataFileError(what, where="the measured angles", expected=expected)
    return begin_s


def correct_path(
    path: JointPath,
    run: MeasuredRun,
    robot: NominalRobot,
    limits: CorrectionLimits,
    smoothing_s: float = 0.01,
    end_s: float = math.inf,
) -> JointPath:
    """Return a program whose endpoint is where the nominal robot has it, for a robot that repeats its errors.

    Offsets are minus the joint errors, smoothed by a Gaussian of ``smoothing_s`` [s] without delay. Times of the run
    are those of the program, which ends at ``end_s`` [s]: rows after it have the offsets of the end. Correct the same
    program again with a run of the corrected one: the errors of gears with backlash depend on the path itself. Raises
    DataFileError: a row has no endpoint within ``limits.max_age``, or an offset or its rate exceeds its limit.
    """
    if len(run.times_s) < 2:  # noqa: PLR2004  offsets have rates
        what = f"{len(run.times_s)} usable endpoints while the program ran"
        raise DataFileError(what, where=run.source, expected="at least 2")
    times_s = np.minimum(path.times_s, end_s)
    after = np.clip(np.searchsorted(run.times_s, times_s), 1, len(run.times_s) - 1)
    near = np.maximum(np.abs(run.times_s[after] - times_s), np.abs(times_s - run.times_s[after - 1]))
    if (far := np.flatnonzero(near > limits.max_age)).size:
        what = f"no usable endpoint within {limits.max_age:g} s of {times_s[far[0]]:.6g} s of the program"
        raise DataFileError(what, where=run.source, expected="endpoints from its begin to its end")
    errors = run.joint_errors(robot)
    step_s = float(np.median(np.diff(run.times_s)))
    grid_s = np.arange(run.times_s[0], run.times_s[-1] + step_s, step_s)
    even = np.column_stack([np.interp(grid_s, run.times_s, column) for column in errors.T])
    smooth = gaussian_filter1d(even, smoothing_s / step_s, axis=0, mode="nearest") if smoothing_s else even
    offsets = -np.column_stack([np.interp(times_s, grid_s, column) for column in smooth.T])
    rates = np.diff(offsets, axis=0) / np.diff(path.times_s)[:, None]
    for values, limit, unit in ((offsets, limits.max_offset, "rad"), (rates, limits.max_rate, "rad/s")):
        if values.size and np.abs(values).max() > limit:
            row, joint = np.unravel_index(int(np.argmax(np.abs(values))), values.shape)
            what = f"joint {path.joints[joint]} needs {values[row, joint]:.3g} {unit} at {path.times_s[row]:.6g} s"
            raise DataFileError(what, where=path.source, expected=f"at most {limit:g} {unit}")
    return path.moved(offsets)
