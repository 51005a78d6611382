"""What a bundle fit works on: scans with their poses, as a recording and its pose reference give them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_estimator.core.calibrate.bundle_problem import PoseReference
from posor_estimator.core.calibrate.channels import KINDS, check_channels
from posor_estimator.core.calibrate.checks import check_axis, check_unit
from posor_estimator.core.calibrate.joining import stops, while_known
from posor_estimator.core.calibrate.recording import POSE
from posor_estimator.core.calibrate.track import dwells
from posor_estimator.core.fault import State
from posor_estimator.core.native import native_from_rotation
from posor_estimator.core.posor import Posor
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibrate.track import Track
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import FloatArray, IntArray

NS = 1e9
AXES = ("x", "y", "z", "alpha", "beta")
TRAVEL = 20.0
"""A motion along an axis is compared with the reference where it is so many times what the calibration leaves open."""


@dataclass(frozen=True)
class BundleData:
    """Scans and poses.

    Attributes:
        scans: The scans, or the mean scan of each stop, (n,).
        counts: Of how many readings each is the mean, (n,).
        poses: Roughly, (n,).
        reference: What the reference says of the poses; None: there is none.
        left_out: How many scans gave no pose, or had no reference.
        warnings: Sentences on readings that were left out of stops.

    """

    scans: Scans
    counts: FloatArray
    poses: list[pin.SE3]
    reference: PoseReference | None
    left_out: int
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of scans."""
        return len(self.counts)

    def chosen(self, which: IntArray) -> BundleData:
        """Return some of the scans, by index, (k,)."""
        reference = self.reference
        if reference is not None:
            kept = [reference.poses[i] for i in which]
            reference = PoseReference(kept, reference.sigmas[which], reference.mounting_sigmas)
        left_out = self.left_out + len(self) - len(which)
        poses = [self.poses[i] for i in which]
        return BundleData(self.scans.chosen(which), self.counts[which], poses, reference, left_out, self.warnings)


@dataclass(frozen=True)
class Joining:
    """How scans and reference are joined.

    Attributes:
        least_stop_s: Stops of the reference at least this long are used, each as one mean scan [s]; 0: every scan, with
            the reference interpolated.
        still: Largest deviation of the reference within a stop [m], and of its quaternion.
        settle_s: Left out at the beginning of each stop [s].
        longest_gap_s: References further apart are not joined by a line [s].
        at_most: Scans beyond this number are thinned out evenly.
        mounting_sigmas: See ``PoseReference``.

    """

    least_stop_s: float
    still: float
    settle_s: float
    longest_gap_s: float
    at_most: int
    mounting_sigmas: FloatArray


def bundle_data(recording: Recording, calibration: Calibration, topic: str | None, how: Joining) -> BundleData:
    """Return the data of a bundle fit.

    Args:
        recording: The recording, without scans whose readings were filled in or saturated.
        calibration: As calibrated so far, its session applied.
        topic: Of the pose reference; empty: the only one; None: the fit does without.
        how: How scans and reference are joined.

    Raises:
        FitError: No scan is left, or the reference does not look like the motion of this POSOR.
        TrackError: The reference does not serve.

    """
    check_channels(recording.scans, KINDS, recording.source)
    # No scan is too contradictory, and no motion too fast, to be fitted: the fit itself has to judge that.
    posor = Posor(calibration.model_copy(update={"motion": None}), false_alarm=0.0)
    if topic is None:
        estimates = posor.locate_all(recording.scans)
        found = np.flatnonzero(np.isin(estimates.states, [int(State.OK), int(State.DEGRADED)]))
        poses = [pin.SE3(estimates.rotations[i], estimates.translations[i]) for i in found]
        counts = np.ones(len(found))
        left_out = len(recording.scans) - len(found)
        return _thinned(BundleData(recording.scans.chosen(found), counts, poses, None, left_out), how, recording.source)
    track = recording.track(topic, POSE)
    if how.least_stop_s > 0.0:
        found_stops = dwells(track, how.still, int(how.least_stop_s * NS), settle_ns=int(how.settle_s * NS))
        joined = stops(recording.scans, track, found_stops, what=recording.source)
        scans, counts = joined.scans, joined.counts.astype(float)
        values, sigmas, warnings = joined.reference, joined.reference_sigmas, joined.warnings
    else:
        scans, values = while_known(recording.scans, track, int(how.longest_gap_s * NS))
        counts, sigmas, warnings = np.ones(len(scans)), np.tile(track.sigmas, (len(scans), 1)), ()
    poses = [pin.SE3(_rotation(value[3:]), value[:3]) for value in values]
    reference = PoseReference(poses, _tangent_sigmas(poses, sigmas), how.mounting_sigmas)
    left_out = 0 if how.least_stop_s > 0.0 else len(recording.scans) - len(scans)
    data = BundleData(scans, counts, poses, reference, left_out, warnings)
    codes = posor.stack.linearise(data.scans)[0]
    data = _thinned(data.chosen(np.flatnonzero(~codes.any(axis=1))), how, recording.source)
    _check_motion(posor, data, track)
    return data


def _thinned(data: BundleData, how: Joining, source: str) -> BundleData:
    if not len(data):
        raise FitError(
            "no scan is left to fit: all are out of the calibrated range or give no pose",
            where=source,
            expected="scans of the POSOR that the calibration file describes",
        )
    if len(data) <= how.at_most:
        return data
    return data.chosen(np.round(np.linspace(0, len(data) - 1, how.at_most)).astype(np.int64))


def _rotation(quaternion: FloatArray) -> pin.Quaternion:
    turned = pin.Quaternion(np.ascontiguousarray(quaternion))
    turned.normalize()
    return turned.toRotationMatrix()


def _tangent_sigmas(poses: list[pin.SE3], sigmas: FloatArray) -> FloatArray:
    """Return standard uncertainties along and about the target's axes, (n, 6), of those of the references, (n, 7).

    Along, they turn with the target. About, a small turn is twice the change of a quaternion's vector part.
    """
    turned = np.array([np.square(pose.rotation.T) @ np.square(s[:3]) for pose, s in zip(poses, sigmas, strict=True)])
    about = 2.0 * np.sqrt(np.mean(np.square(sigmas[:, 3:]), axis=1))
    return np.column_stack([np.sqrt(turned), np.tile(about[:, None], 3)])


def _check_motion(posor: Posor, data: BundleData, track: Track) -> None:
    """Refuse a reference in the wrong unit, or with swapped axes, by the poses that the present calibration gives."""
    thetas = np.array([np.arctan2(-pose.rotation[0, 1], pose.rotation[1, 1]) for pose in data.poses])
    estimates = posor.locate_each(data.scans, thetas)
    told = estimates.states != int(State.LOST)
    least = 4
    if np.count_nonzero(told) < least:
        return
    unsure = np.sqrt(np.median(np.diagonal(estimates.covariances_systematic[told], axis1=1, axis2=2), axis=0))
    found = [pin.SE3(r, t) for r, t in zip(estimates.rotations[told], estimates.translations[told], strict=True)]
    said = [pose for pose, is_told in zip(data.poses, told, strict=True) if is_told]
    measured, reference = (np.array([_shifts_and_leans(pose) for pose in poses]) for poses in (found, said))
    for names, unit in ((AXES[:3], "m"), (AXES[3:], "rad")):
        columns = [AXES.index(name) for name in names]
        for axis, name in zip(columns, names, strict=True):
            if np.ptp(measured[:, axis]) > TRAVEL * unsure[axis]:
                check_axis(measured[:, axis], reference[:, columns], axis - columns[0], names, track.source)
                check_unit(measured[:, axis], reference[:, axis], f"{track.source}, {name}", unit)


def _shifts_and_leans(pose: pin.SE3) -> list[float]:
    """Return x, y, z [m], alpha and beta [rad]; theta is what the search of the pose begins from."""
    return [*pose.translation.tolist(), *native_from_rotation(pose.rotation)[:2]]
