# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Checks of motions: each joint against its encoder and its nominal motion; the endpoint against a reference.

The poses are estimated from the begin of each joint's sweep, where it is at its home mark, to the end of the recording.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.chain.commissioning_record import NATIVE, CheckRecord
from posor.estimation.corrected_scans import corrected_scans
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES, Fault
from posor.numerics.vector import wrapped_angles

from posor_calibration.commissioning.plug_checks import LEAST_SCANS, SIGMAS
from posor_calibration.data_checks import POSE_AXES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.calibration.calibration_file import Calibration
    from posor.chain.kinematic_chain import Chain
    from posor.estimation.estimate import Estimates
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

    from posor_calibration.commissioning.commissioning_recording import CommissioningRecording, RecordedStep
    from posor_calibration.commissioning.plan import CommissioningSettings

FALSE_ALARM = 1e-4
"""Probability that the test of the residuals rejects a sound scan; one such scan may cost the count of a bumpy ring."""
LEAST_USABLE = 0.95  # share of the scans of a sweep that have a pose
LEAST_RANGE = 0.9  # share of the stated range that a sweep covers
SLOPE = 0.01  # largest relative difference between the motions of joint and encoder
LONGEST_GAP_NS = 200_000_000  # between two messages of an encoder or of the reference
SPACING_NS = 5_000_000  # scans that follow faster are left out
LEAST_POSTURES = 4


@dataclass(frozen=True)
class JointMotion:
    """Poses of a joint since the begin of its sweep."""

    estimates: Estimates
    stamps_ns: IntArray  # of the scans [ns], (n,)
    usable: BoolArray  # whether each may be used, (n,)
    sweep: BoolArray  # whether each belongs to the sweep, (n,)

    def limits(self) -> dict[str, tuple[float, float]]:
        """Return the least and the greatest native coordinates, see ``NATIVE``; empty without a pose."""
        native = self.estimates.natives[self.usable]
        spans = zip(native.min(axis=0).tolist(), native.max(axis=0).tolist(), strict=True) if len(native) else ()
        return dict(zip(NATIVE, spans, strict=False))


def estimate_motion(recording: CommissioningRecording, calibration: Calibration, sweep: RecordedStep) -> JointMotion:
    """Return the poses of a joint since the begin of its sweep."""
    scans = corrected_scans(recording.scans[sweep.step.joint], calibration)
    stamps = scans.stamps_ns
    since = np.flatnonzero(stamps >= sweep.begin_ns)
    if since.size > 1:
        every = max(1, math.ceil(SPACING_NS / float(np.median(np.diff(stamps[since])))))
        since = since[::every]
    estimates = Posor(calibration, false_alarm=FALSE_ALARM).estimate_all(scans.select(since))
    usable = np.isin(estimates.states, [int(state) for state in USABLE_STATES])
    return JointMotion(estimates, stamps[since], usable, stamps[since] <= sweep.end_ns)


def check_residuals(name: str, motion: JointMotion) -> CheckRecord:
    """Return whether the readings of a sweep agree with one another."""
    count = int(motion.sweep.sum())
    if count < LEAST_SCANS:
        return CheckRecord(check=name, found=f"{count} scans", verdict="failed", kind="missing")
    share = float(motion.usable[motion.sweep].mean())
    found = f"{100.0 * share:.1f} % of {count} scans have a pose"
    if share >= LEAST_USABLE:
        return CheckRecord(check=name, found=found, verdict="passed")
    faults = Counter(int(each) for each in motion.estimates.faults[motion.sweep & ~motion.usable])
    worst = faults.most_common(1)[0][0]
    why = str(Fault(worst).name) if worst else "theta was not counted: begin the sweep at the home mark"
    return CheckRecord(check=name, found=f"{found}; others: {why}", verdict="failed", kind="residual")


def measured_angles(chain: Chain, joint: str, motion: JointMotion) -> FloatArray:
    """Return the angles about the nominal axis [rad], (n,), continuous; NaN without a pose."""
    origin = chain.nominal_joint(joint, 0.0).rotation
    turned = origin.T @ motion.estimates.rotations
    angles = np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
    angles[motion.usable] = np.unwrap(angles[motion.usable])
    angles[~motion.usable] = np.nan
    return np.asarray(angles)


def check_encoder(
    name: str, angles: FloatArray, encoder: FloatArray | None, settings: CommissioningSettings
) -> CheckRecord:
    """Return whether a joint turns as its encoder says; without one, whether it turns through the stated range.

    ``angles``, ``encoder``: in the scans of the sweep [rad], (n,); NaN: not known.
    """
    seen = angles[np.isfinite(angles)]
    span = float(np.ptp(seen)) if seen.size else 0.0
    if span < LEAST_RANGE * settings.sweep:
        found = f"the joint turned through {math.degrees(span):.2f} deg of {math.degrees(settings.sweep):g} deg"
        return CheckRecord(check=name, found=found, verdict="failed", kind="range")
    blind = "without an encoder: a wrong sign or scale of theta"
    if encoder is None:
        found = f"no encoder; the joint turned through {math.degrees(span):.2f} deg"
        return CheckRecord(check=name, found=found, verdict="not_checked", blind=blind)
    both = np.isfinite(angles) & np.isfinite(encoder)
    if both.sum() < LEAST_SCANS:
        return CheckRecord(check=name, found="no encoder at the times of the scans", verdict="failed", kind="missing")
    slope = float(np.polyfit(encoder[both], angles[both], 1)[0])
    offset = float(np.median(wrapped_angles(angles[both] - encoder[both])))
    found = f"the joint turns {slope:.5f} times its encoder, zero {1e3 * offset:.3f} mrad beside"
    blind = f"a zero of theta wrong by less than {1e3 * settings.encoder_zero:g} mrad"
    wrong = {"sign": slope < 0.0, "scale": abs(slope - 1.0) > SLOPE, "zero": abs(offset) > settings.encoder_zero}
    kind = next((kind for kind, holds in wrong.items() if holds), "")
    return CheckRecord(check=name, found=found, verdict="failed" if kind else "passed", kind=kind, blind=blind)


def check_nominal_motion(
    name: str, chain: Chain, joint: str, motion: JointMotion, angles: FloatArray, settings: CommissioningSettings
) -> CheckRecord:
    """Return whether a joint moves about the axis of the URDF. ``angles``: about it, by encoder or measured [rad]."""
    which = np.flatnonzero(motion.sweep & motion.usable & np.isfinite(angles))
    if which.size < LEAST_SCANS:
        return CheckRecord(check=name, found=f"{which.size} poses", verdict="failed", kind="missing")
    estimates = motion.estimates
    found = np.empty((len(which), 6))
    for row, n in zip(found, which.tolist(), strict=True):
        nominal = chain.nominal_joint(joint, float(angles[n]))
        row[:] = pin.log6(nominal.actInv(pin.SE3(estimates.rotations[n], estimates.translations[n]))).vector
    scatter = np.array([settings.position] * 3 + [settings.tilt] * 2 + [settings.encoder])
    covariances = estimates.covariances()[which]
    own = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2).mean(axis=0))
    own[:2] = own[:2].max()  # the axes of a joint are turned against those of its parent
    own[3:5] = own[3:5].max()
    limits = SIGMAS * np.hypot(scatter, own)
    random = np.sqrt(np.diagonal(estimates.covariances_random[which], axis1=1, axis2=2).mean(axis=0))
    changes = np.array([settings.runout] * 3 + [settings.wobble] * 2 + [settings.encoder])
    change_limits = 2.0 * SIGMAS * np.hypot(changes, random)
    worst, spans = np.abs(np.median(found, axis=0)), np.ptp(found, axis=0)
    beyond = [
        f"{text} by {1e6 * value:.0f} {unit}, at most {1e6 * limit:.0f} {unit}"
        for values, bounds, what in ((worst, limits, "off"), (spans, change_limits, "changes"))
        for text, value, limit, unit in zip(
            (f"{what} {axis}" for axis in POSE_AXES), values, bounds, ["um"] * 3 + ["urad"] * 3, strict=True
        )
        if value > limit
    ]
    blind = (
        f"errors that move the pose by less than {1e6 * limits[0]:.0f} um and {1e6 * limits[3]:.0f} urad, such as a "
        "growth of all gaps or the sign of a supply sensitivity"
    )
    if beyond:
        text = f"beside the nominal motion: {'; '.join(beyond)}"
        return CheckRecord(check=name, found=text, verdict="failed", kind="motion", blind=blind)
    text = (
        f"within {1e6 * worst[:3].max():.1f} um and {1e6 * worst[3:].max():.1f} urad of the nominal motion, changes "
        f"{1e6 * spans[:3].max():.1f} um and {1e6 * spans[3:].max():.1f} urad"
    )
    return CheckRecord(check=name, found=text, verdict="passed", blind=blind)


def check_postures(
    recording: CommissioningRecording,
    chain: Chain,
    motions: Mapping[str, JointMotion],
    postures: list[RecordedStep],
    settings: CommissioningSettings,
) -> CheckRecord:
    """Return whether the endpoint is where a reference measures it, in several postures.

    A reference whose frame is the base frame of the arm is compared directly; else the frame is fitted.
    """
    name = "endpoint: postures"
    if not settings.postures:
        blind = "lengths of the beams, direction of gravity, sag"
        return CheckRecord(check=name, found="no reference of the endpoint", verdict="not_checked", blind=blind)
    rows = [_posture(recording, motions, each) for each in postures]
    whole = [row for row in rows if row is not None]
    if len(whole) < max(LEAST_POSTURES, len(rows)):
        found = f"{len(whole)} of {len(rows)} postures have a pose of every joint and a reference; all must, at least 4"
        return CheckRecord(check=name, found=found, verdict="failed", kind="missing")
    poses, random, systematic, points = (np.array(part) for part in zip(*whole, strict=True))
    ends = chain.estimate_all(poses, random, systematic)
    covariances = ends.covariances_random + ends.covariances_systematic
    sigmas = np.hypot(settings.reference, np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)[:, :3]))
    is_base = recording.reference_frame == chain.base_frame
    errors = ends.poses[:, :3] - points if is_base else _fitted_errors(ends.poses[:, :3], points)
    worst = float(np.max(np.abs(errors) / sigmas))
    found = (
        f"endpoint beside the reference by up to {1e6 * np.abs(errors).max():.1f} um, {worst:.1f} standard deviations"
    )
    blind = f"errors of the endpoint below {1e6 * SIGMAS * float(sigmas.max()):.0f} um"
    blind += "" if is_base else "; what moves the arm as a whole, such as its first beam, and most of gravity"
    if worst > SIGMAS:
        return CheckRecord(check=name, found=found, verdict="failed", kind="reference", blind=blind)
    return CheckRecord(check=name, found=found, verdict="passed", blind=blind)


def _posture(
    recording: CommissioningRecording, motions: Mapping[str, JointMotion], step: RecordedStep
) -> tuple[FloatArray, ...] | None:
    """Return poses (j, 7), covariances of all joints, and the mean of the reference; None: one is missing."""
    track = recording.reference
    if track is None:
        return None
    poses, random, systematic = [], [], []
    for motion in motions.values():
        stamps = motion.stamps_ns
        which = np.flatnonzero((stamps >= step.begin_ns) & (stamps <= step.end_ns) & motion.usable)
        if which.size < LEAST_SCANS:
            return None
        estimates, middle = motion.estimates, int(which[which.size // 2])
        rotation = pin.Quaternion(estimates.rotations[middle]).coeffs()
        poses.append(np.concatenate([estimates.translations[which].mean(axis=0), rotation]))
        random.append(estimates.covariances_random[middle])
        systematic.append(estimates.covariances_systematic[middle])
    during = (track.stamps_ns >= step.begin_ns) & (track.stamps_ns <= step.end_ns)
    if not during.any():
        return None
    return np.array(poses), np.array(random), np.array(systematic), track.values[during].mean(axis=0)


def _fitted_errors(points: FloatArray, reference: FloatArray) -> FloatArray:
    """Return points minus the reference in the frame that fits best (Kabsch)."""
    centred, other = points - points.mean(axis=0), reference - reference.mean(axis=0)
    left, _, right = np.linalg.svd(other.T @ centred)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray(centred - other @ left @ flip @ right)
