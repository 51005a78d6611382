# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Data of a bundle fit from a recording: scans with approximate poses, and the pose reference if there is one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.bags.recording import POSE, unpack_poses
from posor.errors import FitError
from posor.model.fault import USABLE_STATES, State
from posor.model.native_coordinates import native_from_rotation
from posor.numerics.stamps import NS
from posor.numerics.vector import thetas_of
from posor.sensors.base import READING_KINDS
from pydantic import Field

from posor_calibration.bundle_problem import BundleData, PoseReference
from posor_calibration.data_checks import check_axis, check_channels_vary, check_unit
from posor_calibration.dwells import RestOptions, Settle, Still, average_dwells, scans_with_reference
from posor_calibration.procedure import LongestGapOption
from posor_calibration.recorded_poses import count_from_first_mark, counted_estimates, posor_without_rejection

if TYPE_CHECKING:
    from posor.bags.recording import Recording, Track
    from posor.calibration.calibration_file import Calibration
    from posor.estimation.posor import Posor
    from posor.numerics.array_types import FloatArray

AXES = ("x", "y", "z", "alpha", "beta")
CLEAR_TRAVEL = 20.0
"""Travel along an axis, over the uncertainty of the calibration, above which it is compared with the reference's."""
MIN_COMPARED = 4
MIN_POSES = 8


class BundleDataOptions(RestOptions):
    """Options of the bundle fit that select its data."""

    reference: str = Field(
        default="", description="topic of the pose reference; empty: the only one, or none if there is none"
    )
    mounting_m: float = Field(
        default=0.0,
        ge=0.0,
        description="standard uncertainty of the positions of the reference's frames on the plates [m]; 0: exact",
    )
    mounting_rad: float = Field(default=0.0, ge=0.0, description="the same for their orientations [rad]")
    least_dwell: float = Field(
        default=0.0, ge=0.0, description="average dwells of the reference at least this long [s]; 0: use single scans"
    )
    still: Still = 2e-6
    settle: Settle = 0.0
    longest_gap: LongestGapOption = 0.5
    at_most: int = Field(default=500, ge=MIN_POSES, description="more poses than this are thinned out evenly")


def make_bundle_data(recording: Recording, calibration: Calibration, options: BundleDataOptions) -> BundleData:
    """Return the data of a bundle fit.

    Substituted and saturated scans are already left out of the recording, the session is applied to the calibration.
    Raises FitError: no scan is left; TrackError: the reference is unusable, or does not move as this POSOR.
    """
    check_channels_vary(recording.scans, READING_KINDS, recording.source)
    posor = posor_without_rejection(calibration)
    if not options.reference and all(track.values.shape[1] != POSE for track in recording.tracks.values()):
        scans = count_from_first_mark(posor, recording.scans, recording.source)
        estimates = counted_estimates(posor, scans, recording.source)
        found = np.flatnonzero(np.isin(estimates.states, USABLE_STATES))
        poses = [pin.SE3(estimates.rotations[i], estimates.translations[i]) for i in found]
        left_out = len(recording.scans) - len(found)
        data = BundleData(recording.scans.select(found), np.ones(len(found)), poses, None, left_out)
        return _thin_out(data, options.at_most, recording.source)
    track = recording.find_track(options.reference, POSE)
    if options.least_dwell > 0.0:
        means = average_dwells(recording.scans, track, options.dwells(track), source=recording.source)
        scans, counts, left_out = means.scans, means.counts.astype(float), 0
        values, sigmas, warnings = means.reference, means.reference_sigmas, means.warnings
    else:
        scans, values = scans_with_reference(recording.scans, track, int(options.longest_gap * NS))
        differs = np.flatnonzero(np.append(True, np.any(np.diff(values, axis=0) != 0.0, axis=1)))
        scans, values = scans.select(differs), values[differs]  # a stage at rest repeats one value with one error
        counts, left_out = np.ones(len(scans)), len(recording.scans) - len(scans)
        sigmas, warnings = np.tile(track.sigmas, (len(scans), 1)), ()
    poses = [pin.SE3(r, t) for r, t in zip(*unpack_poses(values), strict=True)]
    mounting = np.tile([options.mounting_m] * 3 + [options.mounting_rad] * 3, 2)
    reference = PoseReference(poses, _tangent_sigmas(poses, sigmas), mounting)
    data = BundleData(scans, counts, poses, reference, left_out, warnings)
    valid = np.flatnonzero(posor.stack.linearise(data.scans).valid)
    data = _thin_out(data.select(valid), options.at_most, recording.source)
    _check_motion(posor, data, track)
    return data


def _thin_out(data: BundleData, at_most: int, source: str) -> BundleData:
    """Return at most ``at_most`` scans; raise FitError if there are none."""
    if not len(data):
        raise FitError(
            "no scan is left to fit: all are out of the calibrated range, give no pose, or have no counted theta",
            where=source,
            expected="scans of the POSOR that the calibration file describes",
        )
    if len(data) <= at_most:
        return data
    return data.select(np.round(np.linspace(0, len(data) - 1, at_most)).astype(np.int64))


def _tangent_sigmas(poses: list[pin.SE3], sigmas: FloatArray) -> FloatArray:
    """Return standard uncertainties along and about the target's axes (n, 6) for pose tracks (n, 7)."""
    along = np.array([np.square(pose.rotation.T) @ np.square(s[:3]) for pose, s in zip(poses, sigmas, strict=True)])
    # A small rotation is twice the change of the quaternion's vector part.
    about = 2.0 * np.sqrt(np.mean(np.square(sigmas[:, 3:]), axis=1))
    return np.column_stack([np.sqrt(along), np.tile(about[:, None], 3)])


def _check_motion(posor: Posor, data: BundleData, track: Track) -> None:
    """Raise TrackError if the reference has a wrong unit or swapped axes, by the poses of the present calibration."""
    thetas = thetas_of(np.array([pose.rotation for pose in data.poses]))
    estimates = posor.estimate_each(data.scans, thetas)
    valid = estimates.states != int(State.LOST)
    if np.count_nonzero(valid) < MIN_COMPARED:
        return
    total = estimates.covariances_systematic[valid] + estimates.covariances_random[valid]
    sigmas = np.sqrt(np.median(np.diagonal(total, axis1=1, axis2=2), axis=0))
    found = [pin.SE3(r, t) for r, t in zip(estimates.rotations[valid], estimates.translations[valid], strict=True)]
    expected = [data.poses[i] for i in np.flatnonzero(valid)]
    # Without theta, from which the search of the pose begins.
    measured, reference = (
        np.array([[*pose.translation, *native_from_rotation(pose.rotation)[:2]] for pose in poses])
        for poses in (found, expected)
    )
    for names, unit in ((AXES[:3], "m"), (AXES[3:], "rad")):
        columns = [AXES.index(name) for name in names]
        for axis, name in zip(columns, names, strict=True):
            if np.ptp(measured[:, axis]) > CLEAR_TRAVEL * sigmas[axis]:
                check_axis(measured[:, axis], reference[:, columns], axis - columns[0], names, track.source)
                check_unit(measured[:, axis], reference[:, axis], f"{track.source}, {name}", unit)
