# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Profile of a bumpy ring from full turns: self-calibration by several probes around the ring.

Each probe sees every bump, the others see the same bump at another time. In each scan three unknowns are free, the two
runouts and theta; the rest of the readings belongs to the profile. With four probes and full turns that gives
the even orders to some nanometres. Orders that all probes see like runout or rotation are not observable: the odd
orders, near the bumps too, look like runout, and the phase of the bumps is the zero of theta. A reference of theta
determines that phase, an axis that is known to run true determines the odd orders; order 1 is then the eccentricity
against that axis. Amplitudes that are not observable keep their former values and are reported.

The profile has a period of one turn, and the number of bumps is counted between home marks. Poses are eliminated scan
by scan, as in the bundle fit. Source: thesis 3.2.2; the reversal of several probes around one part is that of
multi-probe roundness measurement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.bags.recording import SCALAR
from posor.calibration.calibration_file import find_sensor
from posor.calibration.quantity import Quantity
from posor.errors import FitError, TrackError
from posor.estimation.sensor_stack import Stack
from posor.model.fault import State
from posor.model.scan import PROBES_ESTIMATED, SATURATED
from posor.sensors.bumpy_ring import BumpyRingCalibration
from pydantic import Field

from posor_calibration.bundle_problem import UNKNOWN_SIGMA, BundleData, BundleProblem, OutOfRangeError, PoseReference
from posor_calibration.calibration_parameters import FreeParameters
from posor_calibration.data_checks import check_channels_move, check_count
from posor_calibration.dwells import use_values_once
from posor_calibration.fit_report import check_spread, describe_residuals
from posor_calibration.least_squares import WEAK, Fit
from posor_calibration.procedure import (
    Figure,
    LongestGapOption,
    LossOption,
    Options,
    Outcome,
    Part,
    Procedure,
    SessionOption,
    Table,
)
from posor_calibration.recorded_poses import count_from_first_mark, counted_estimates, posor_without_rejection

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.estimation.estimate import Estimates
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray

NAME = "ring_profile"
SCANS_PER_BUMP = 4  # least number of scans for each bump
COHERENCE = 0.8
"""Least mean of exp(i bumps angle) over the angles by which the reference leads the ring; 1 for a constant lead."""
UM = 1e-6
PHASES = ("cos", "sin")


class RingProfileOptions(Options):
    """Options of ``ring_profile``."""

    orders: tuple[int, ...] = Field(default=(), description="orders to fit, 1 or more; empty: those of the calibration")
    theta: str = Field(default="", description="topic of a reference of theta [rad]; empty: none")
    runout_sigma: float | None = Field(
        default=None, gt=0.0, description="standard deviation of the axis' runout [m]; none: unknown"
    )
    expected_amplitude: float = Field(
        default=2e-6, gt=0.0, description="prior standard uncertainty of each amplitude [m]"
    )
    expected_radius: float = Field(
        default=5e-6, gt=0.0, description="prior standard uncertainty of the mean radius [m]"
    )
    session: SessionOption = ""
    at_most: int = Field(default=1000, ge=50, description="more scans than this are thinned out evenly")
    longest_gap: LongestGapOption = 0.5
    loss: LossOption = "linear"


@dataclass(frozen=True)
class _Turns:
    """Scans of full turns with approximate poses of the target."""

    scans: Scans  # (n,)
    poses: list[pin.SE3]  # T_R_T, (n,)
    thetas: FloatArray  # by the POSOR [rad], (n,); counted over turns without a reference
    reference: FloatArray | None  # theta by the reference, counted over turns [rad], (n,)

    @property
    def travel(self) -> float:
        """Travel of theta [rad]."""
        return float(np.ptp(self.thetas if self.reference is None else self.reference))


def find_ring_profile(recording: Recording, calibration: Calibration, options: RingProfileOptions) -> Outcome:
    """Find a ring's profile; raises as ``Procedure.identify``."""
    calibration = calibration.for_session(options.session)
    sensor, part = find_sensor(calibration, BumpyRingCalibration, NAME)
    orders = sorted({*part.ring.orders, *options.orders})
    sensors = [_widen_prior(part, orders, options) if other is part else other for other in calibration.sensors]
    wide = calibration.model_copy(update={"sensors": sensors})
    turns = _select_turns(recording.without_status(PROBES_ESTIMATED | SATURATED), wide, part, options)
    stack = Stack([other.build() for other in wide.sensors])
    key = f"sensors[{sensor}].ring"
    free = FreeParameters(wide, first=f"{key}.*")
    count = sum(name.startswith(f"{key}.") for name in free.names)
    reference = _make_pose_reference(turns, recording, options)
    problem = BundleProblem(stack, free, BundleData(turns.scans, np.ones(len(turns.scans)), turns.poses, reference))
    try:
        names = [_shorten(name, orders) for name in problem.names]
        found = problem.fit(names, uninformative=problem.uninformative, loss=options.loss, what=NAME)
    except OutOfRangeError as error:
        raise FitError(
            f"{int(error.which.sum())} scans leave the calibrated range of the probes", where=NAME, expected="none"
        ) from None
    readings = [f"{name} of scan {number}" for number in turns.scans.numbers for name in stack.reading_names]
    check_spread(found, readings if len(readings) == len(found.residuals) else (), f"{NAME}, {recording.source}")
    joint = free.joint_covariance(found.covariance, count)
    found = found.select_first(count)
    remaining = dict(zip(found.names, (found.sigmas / problem.scales[:count]).tolist(), strict=True))
    return Outcome(
        method=f"self-calibration over {turns.travel / (2.0 * np.pi):.2f} turns, {len(turns.thetas)} scans, poses "
        f"eliminated; theta {'by a reference' if options.theta else 'counted from the home mark'}",
        fits={NAME: found},
        parts=(Part(key, _ring_entry(found, part, orders)),),
        covariances=(joint,),
        tables=(_tabulate_profile(found, part, orders, remaining),),
        warnings=(*_describe_unobservable(remaining, orders, options), *describe_residuals(found)),
        figures=(_plot_change(found, part, orders),),
    )


def _widen_prior(part: BumpyRingCalibration, orders: list[int], options: RingProfileOptions) -> BumpyRingCalibration:
    """Return the sensor with all orders, and the prior uncertainties of the options."""

    def amplitudes(quantity: Quantity) -> Quantity:
        known = dict(zip(part.ring.orders, quantity.array.tolist(), strict=True))
        return Quantity(value=[known.get(k, 0.0) for k in orders], sigma=options.expected_amplitude, unit="m")

    radius = Quantity(value=part.ring.mean_radius.number, sigma=options.expected_radius, unit="m")
    cos, sin = amplitudes(part.ring.cos), amplitudes(part.ring.sin)
    ring = part.ring.model_copy(update={"orders": orders, "cos": cos, "sin": sin, "mean_radius": radius})
    return part.model_copy(update={"ring": ring})


def _select_turns(
    recording: Recording, calibration: Calibration, part: BumpyRingCalibration, options: RingProfileOptions
) -> _Turns:
    """Return the scans that count, with poses estimated by the present profile."""
    scans, where = recording.scans, f"{NAME}, {recording.source}"
    volts = scans.ring_voltages
    if volts.shape[1] != len(part.probes):
        raise FitError(f"scans of {volts.shape[1]} ring probes", where=where, expected=f"{len(part.probes)}")
    whole = np.isfinite(volts).all(axis=1) & np.isfinite(scans.gap_voltages).all(axis=1)
    scans = scans.select(np.flatnonzero(whole))
    check_count(len(scans), 2 * SCANS_PER_BUMP * part.ring.bumps, "scans", where)
    for index, probe in enumerate(part.probes):
        own, others = scans.ring_voltages[:, [index]], np.delete(scans.ring_voltages, index, axis=1)
        check_channels_move((f"ring probe {probe.name}",), own, np.zeros_like(own), others, where, "sample")
    reference = None
    if options.theta:
        track = recording.find_track(options.theta, SCALAR)
        reference = track.interpolate(scans.stamps_ns, round(options.longest_gap * 1e9))[:, 0]
    estimates = _estimate_poses(scans, calibration, reference, where)
    is_uncounted = reference is None and estimates.states == int(State.UNCOUNTED)
    thetas = np.where(is_uncounted, np.nan, estimates.thetas)
    counted = thetas if reference is None else reference  # with a reference the POSOR's own thetas wrap
    valid = np.isfinite(thetas) & np.isfinite(counted)
    travel = float(np.ptp(counted[valid])) if valid.any() else 0.0
    if travel < 2.0 * np.pi * (1.0 - 1.0 / part.ring.bumps):
        raise FitError(f"{travel / (2.0 * np.pi):.2f} of a turn", where=where, expected="at least a full turn")
    if reference is not None:
        _check_coherence(reference[valid] - thetas[valid], part, track.source)
        valid = use_values_once(track, scans.stamps_ns, valid)
    which = np.flatnonzero(valid)
    if len(which) > options.at_most:
        which = which[np.round(np.linspace(0, len(which) - 1, options.at_most)).astype(np.int64)]
    poses = [pin.SE3(estimates.rotations[i], estimates.translations[i]) for i in which]
    return _Turns(scans.select(which), poses, thetas[which], None if reference is None else reference[which])


def _check_coherence(lead: FloatArray, part: BumpyRingCalibration, source: str) -> None:
    """Raise TrackError if the lead of a theta reference over the ring [rad] (n,) is not constant within a bump."""
    if float(np.abs(np.mean(np.exp(1j * part.ring.bumps * lead)))) < COHERENCE:
        raise TrackError(
            "turns unlike the ring: its theta has no constant phase to the bumps, which are "
            f"{part.bump_angle:.3g} rad long",
            where=source,
            expected="theta of this joint [rad], positive about Z, stamped by the clock of the scans",
        )


def _estimate_poses(scans: Scans, calibration: Calibration, reference: FloatArray | None, where: str) -> Estimates:
    """Return poses with theta from the first home mark or the reference on; FitError: neither, or count lost."""
    posor = posor_without_rejection(calibration)
    if reference is not None:
        return posor.estimate_each(scans, reference)
    return counted_estimates(posor, count_from_first_mark(posor, scans, where), where)


def _make_pose_reference(turns: _Turns, recording: Recording, options: RingProfileOptions) -> PoseReference | None:
    """Return the knowledge of the poses besides the readings: theta, the runout of the axis, or None."""
    if turns.reference is None and options.runout_sigma is None:
        return None
    sigmas = np.full((len(turns.poses), 6), UNKNOWN_SIGMA)
    poses = [pose.copy() for pose in turns.poses]
    if options.runout_sigma is not None:
        sigmas[:, :2] = options.runout_sigma
        middle = np.mean([pose.translation for pose in poses], axis=0)
        for pose in poses:
            pose.translation = np.array([*middle[:2], pose.translation[2]])
    if turns.reference is not None:
        sigmas[:, 5] = recording.find_track(options.theta, SCALAR).sigmas[0]
        for pose, theta, known in zip(poses, turns.thetas, turns.reference, strict=True):
            pose.rotation = pin.utils.rotate("z", float(known - theta)) @ pose.rotation
    return PoseReference(poses, sigmas, np.zeros(12))


def _shorten(name: str, orders: list[int]) -> str:
    """Return ``cos 36`` for ``sensors[1].ring.cos[2]``."""
    head, bracket, index = name.rsplit(".", maxsplit=1)[-1].partition("[")
    return f"{head} {orders[int(index.rstrip(']'))]}" if bracket else head


def _describe_unobservable(
    remaining: dict[str, float], orders: list[int], options: RingProfileOptions
) -> tuple[str, ...]:
    """Return the warning that names the orders that the turns do not determine, or none."""
    weak = [k for k in orders if max(remaining[f"{phase} {k}"] for phase in PHASES) > WEAK]
    if not weak:
        return ()
    helpful = (("a reference of theta", options.theta), ("runout_sigma", options.runout_sigma))
    missing = [name for name, given in helpful if not given]
    more = f"; {' or '.join(missing)} would determine more" if missing else ""
    listed = ", ".join(map(str, weak))
    return (f"Orders {listed} cannot be separated from runout or uneven rotation: they stay as they were{more}.",)


def _ring_entry(found: Fit, part: BumpyRingCalibration, orders: list[int]) -> dict[str, object]:
    def quantity(*names: str) -> dict[str, object]:
        return {"value": [found.value(n) for n in names], "sigma": [found.sigma(n) for n in names], "unit": "m"}

    ring = part.ring.model_dump(mode="json")
    amplitudes = {phase: quantity(*(f"{phase} {k}" for k in orders)) for phase in PHASES}
    radius = {"value": found.value("mean_radius"), "sigma": found.sigma("mean_radius"), "unit": "m"}
    return {**ring, **amplitudes, "mean_radius": radius, "orders": orders}


def _tabulate_profile(found: Fit, part: BumpyRingCalibration, orders: list[int], remaining: dict[str, float]) -> Table:
    before = {
        f"{phase} {k}": amplitude
        for phase in PHASES
        for k, amplitude in zip(part.ring.orders, getattr(part.ring, phase).array.tolist(), strict=True)
    }
    names = [(k, phase, f"{phase} {k}") for k in orders for phase in PHASES]
    rows = tuple(
        (k, phase, before.get(n, 0.0) / UM, found.value(n) / UM, found.sigma(n) / UM, remaining[n])
        for k, phase, n in names
    )
    columns = ("order", "part", "before", "found", "sigma", "remaining")
    return Table("profile of the ring", columns, ("", "", "um", "um", "um", "of the prior sigma"), rows)


def _plot_change(found: Fit, part: BumpyRingCalibration, orders: list[int]) -> Figure:
    azimuths = np.linspace(0.0, 2.0 * np.pi, 40 * part.ring.bumps)
    change = np.zeros_like(azimuths)
    for k in orders:
        change += found.value(f"cos {k}") * np.cos(k * azimuths) + found.value(f"sin {k}") * np.sin(k * azimuths)
    for k, c, s in zip(part.ring.orders, part.ring.cos.array, part.ring.sin.array, strict=True):
        change -= c * np.cos(k * azimuths) + s * np.sin(k * azimuths)
    series = {"found less before": (azimuths, change / UM)}
    return Figure("change of the profile", "azimuth [rad]", "radius [um]", series)


PROCEDURE = Procedure(NAME, "profile of a bumpy ring from full turns", RingProfileOptions, find_ring_profile)
