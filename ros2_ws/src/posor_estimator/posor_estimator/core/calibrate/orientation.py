"""What a reference says of a target's orientation at the time of each scan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.calibrate.recording import POINT, POSE, poses_of
from posor_estimator.core.native import native_from_rotation
from posor_estimator.errors import FitError, TrackError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.types import FloatArray, IntArray

ANGLES = ("alpha", "beta", "theta")


@dataclass(frozen=True)
class Orientation:
    """Alpha, beta, theta by a reference.

    Attributes:
        angles: [rad], shape (n, 3), of axes parallel to those of R; NaN where the reference says nothing.
        sigmas: Standard uncertainty of each angle [rad], shape (3,).

    """

    angles: FloatArray
    sigmas: FloatArray


def angles_of_displacements(displacements: FloatArray, lever: float) -> FloatArray:
    """Return alpha, beta, theta [rad] that displacements (n, 3) [m] at the end of a lever along X amount to, (n, 3).

    X points along the lever, Y to its side, Z upwards; alpha, the twist about the lever, does not show and is zero.
    Source: thesis appendix 8A.
    """
    angles = np.zeros_like(displacements)
    angles[:, 1:] = -np.arctan(displacements[:, 1:] / lever)
    return angles


def orientation_at(
    recording: Recording, stamps_ns: IntArray, topic: str, *, lever: float, twist_sigma: float, longest_gap_s: float
) -> Orientation:
    """Return the reference's orientation at given times.

    Args:
        recording: Holds the reference: a point at the end of a lever, or a pose.
        stamps_ns: Times [ns], shape (n,).
        topic: The reference's; empty: the only one there is.
        lever: Distance of a point from the pivot [m]; zero where the reference is a pose.
        twist_sigma: Standard uncertainty of alpha [rad], which a point does not show: how still the stage keeps it.
        longest_gap_s: References further apart than this are not joined by a line [s].

    Raises:
        TrackError: There is no such reference.
        FitError: A point has no lever, or its lever cannot be: the angles would be wide.

    """
    if lever > 0.0:
        track = recording.track(topic, POINT)
        angles = angles_of_displacements(track.at(stamps_ns, round(longest_gap_s * 1e9)), lever)
        if np.nanmax(np.abs(angles), initial=0.0) > 0.5:  # noqa: PLR2004  rad
            what = f"angles up to {np.nanmax(np.abs(angles)):.3g} rad come of a lever of {lever:g} m"
            raise FitError(what, where=track.source, expected="points in metres near the end of the lever")
        return Orientation(angles, np.array([twist_sigma, *(track.sigmas[1:] / lever)]))
    try:
        track = recording.track(topic, POSE)
    except TrackError as error:
        expected = "a lever, if the reference is a point"
        raise TrackError(error.what, where=error.where, expected=f"{error.expected}; or {expected}") from error
    values = track.at(stamps_ns, round(longest_gap_s * 1e9))
    known = np.isfinite(values).all(axis=1)
    angles = np.full((len(values), 3), np.nan)
    if known.any():
        angles[known] = [native_from_rotation(rotation) for rotation in poses_of(values[known])[0]]
        angles[known, 2] = np.unwrap(angles[known, 2])
    # A small turn changes the components of the quaternion by half its angle, whichever these are.
    return Orientation(angles, np.full(3, 2.0 * np.sqrt(np.mean(np.square(track.sigmas[3:])))))
