"""Profile of a bumpy ring from full turns: the ring calibrates itself, as far as its probes disagree about it.

Each probe sees every bump of the ring, the others see the same bump at another time. In each scan three unknowns, the
two runouts and theta, are free; what the probes read beyond these is the profile's. With four probes, over full turns,
that tells the even orders to some nanometres. It does not tell what runout or turning makes all probes read just the
same: the odd orders, near the bumps too, look like runout, and the bumps' own phase is where theta has its zero. A
reference of theta tells that phase, an axis that is known to run true the odd orders; order 1 is then the ring's
eccentricity to that axis. Each amplitude of the result says how much of its former uncertainty remains; what the turns
do not tell stays as it was, and is named.

Turns close by themselves: the profile has a period of one turn, and the count of bumps is that between home marks.
Poses are eliminated scan by scan, as in the bundle fit. Source: thesis chapter 5 (the bumpy ring); the reversal of
several probes around one part is that of multi-probe roundness measurement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from pydantic import Field

from posor_estimator.core.calibrate.bundle_problem import UNKNOWN, BundleProblem, OutOfRangeError, PoseReference
from posor_estimator.core.calibrate.checks import check_alive, check_enough, check_spread
from posor_estimator.core.calibrate.directions import UNTOLD
from posor_estimator.core.calibrate.fit import Fit, Loss, fit
from posor_estimator.core.calibrate.parameters import the_sensor
from posor_estimator.core.calibrate.procedure import Figure, Options, Outcome, Procedure, Table
from posor_estimator.core.calibrate.recording import PROBES_ESTIMATED, SATURATED, SCALAR
from posor_estimator.core.calibrate.replacement import JointCovariance, Part
from posor_estimator.core.calibrate.reporting import residual_warnings
from posor_estimator.core.calibrate.unknowns import Unknowns
from posor_estimator.core.calibration.quantity import Quantity
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.posor import Posor
from posor_estimator.core.sensors.bumpy_ring import BumpyRingCalibration
from posor_estimator.core.stack import Stack
from posor_estimator.errors import FitError, TrackError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.estimate import Estimates
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import FloatArray

NAME = "ring_profile"
PER_BUMP = 4
"""Scans to a bump, below which the profile's shape is not seen."""
TOGETHER = 0.8
"""Mean of exp(i bumps angle) of angles by which a reference may be ahead of the ring: 1 where all are the same."""
UM = 1e-6


class RingProfileOptions(Options):
    """Options of the ring's profile."""

    orders: tuple[int, ...] = Field(
        default=(), description="orders to find, 1 or more; empty: those that the calibration has"
    )
    theta: str = Field(default="", description="topic of a reference of theta [rad]; empty: none")
    runout_sigma: float | None = Field(
        default=None, gt=0.0, description="how true the axis runs, standard deviation across it [m]; none: not known"
    )
    expected_amplitude: float = Field(
        default=2e-6, gt=0.0, description="standard uncertainty of each amplitude so far [m]"
    )
    expected_radius: float = Field(default=5e-6, gt=0.0, description="standard uncertainty of the mean radius [m]")
    session: str = Field(default="", description="session of the file that holds")
    at_most: int = Field(default=1000, ge=50, description="scans beyond this number are thinned out evenly")
    longest_gap: float = Field(default=0.5, gt=0.0, description="references further apart are not joined by a line [s]")
    loss: Loss = Field(default="linear", description="of the fit; huber survives outliers, for turns without reference")


@dataclass(frozen=True)
class _Turns:
    """Scans of full turns, with where the target roughly was.

    Attributes:
        scans: (n,).
        poses: ``T_R_T``, (n,).
        thetas: By the POSOR [rad], (n,); turns counted where there is no reference.
        said: By the reference, turns counted [rad], (n,); None: there is none.

    """

    scans: Scans
    poses: list[pin.SE3]
    thetas: FloatArray
    said: FloatArray | None

    @property
    def turned(self) -> float:
        """How far the target went [rad]."""
        return float(np.ptp(self.thetas if self.said is None else self.said))


def find_ring_profile(recording: Recording, calibration: Calibration, options: RingProfileOptions) -> Outcome:
    """Find a ring's profile; see ``RingProfileOptions``.

    Raises:
        FitError: The turns are not full, the bumps' count is lost or never began, or the scans are too few.
        TrackError: The reference does not serve.
        CalibrationError: There is no such session.

    """
    calibration = calibration.for_session(options.session)
    sensor, part = the_sensor(calibration, BumpyRingCalibration, NAME)
    orders = sorted({*part.ring.orders, *options.orders})
    sensors = [_widened(part, orders, options) if one is part else one for one in calibration.sensors]
    wide = calibration.model_copy(update={"sensors": sensors})
    turns = _turns(recording.without(PROBES_ESTIMATED | SATURATED), wide, part, options)
    stack = Stack([one.build() for one in wide.sensors])
    key = f"sensors[{sensor}].ring"
    unknowns = Unknowns(wide, first=f"{key}.*")
    own = sum(name.startswith(f"{key}.") for name in unknowns.names)
    problem = BundleProblem(
        stack, unknowns, turns.scans, np.ones(len(turns.scans)), turns.poses, _reference(turns, recording, options)
    )
    try:
        found = fit(
            problem.residuals,
            problem.start,
            [_short(name, orders) for name in problem.names],
            problem.units,
            problem.scales,
            jacobian=problem.jacobian,
            prior=problem.prior,
            idle=problem.idle,
            loss=options.loss,
            what=NAME,
        )
    except OutOfRangeError as error:
        raise FitError(
            f"{int(error.which.sum())} scans leave the calibrated range of the probes", where=NAME, expected="none"
        ) from None
    numbers = turns.scans.numbers
    readings = [f"{name} of scan {number}" for number in numbers for name in stack.reading_names]
    check_spread(found, readings if len(readings) == len(found.residuals) else (), f"{NAME}, {recording.source}")
    joint = unknowns.beside(found.covariance, own)
    return _outcome(found.part(own), part, orders, key, turns, problem.scales[:own], options, joint)


def _widened(part: BumpyRingCalibration, orders: list[int], options: RingProfileOptions) -> BumpyRingCalibration:
    """Return the sensor with all orders, and the uncertainties that the options state."""

    def amplitudes(quantity: Quantity) -> Quantity:
        known = dict(zip(part.ring.orders, quantity.array.tolist(), strict=True))
        return Quantity(value=[known.get(k, 0.0) for k in orders], sigma=options.expected_amplitude, unit="m")

    radius = Quantity(value=part.ring.mean_radius.number, sigma=options.expected_radius, unit="m")
    ring = part.ring.model_copy(
        update={
            "orders": orders,
            "cos": amplitudes(part.ring.cos),
            "sin": amplitudes(part.ring.sin),
            "mean_radius": radius,
        }
    )
    return part.model_copy(update={"ring": ring})


def _turns(
    recording: Recording, calibration: Calibration, part: BumpyRingCalibration, options: RingProfileOptions
) -> _Turns:
    """Return the scans that count, located with the profile as it is."""
    scans, where = recording.scans, f"{NAME}, {recording.source}"
    volts = scans.ring_voltages
    if volts.shape[1] != len(part.probes):
        raise FitError(f"scans of {volts.shape[1]} ring probes", where=where, expected=f"{len(part.probes)}")
    whole = np.isfinite(volts).all(axis=1) & np.isfinite(scans.gap_voltages).all(axis=1)
    scans = scans.chosen(np.flatnonzero(whole))
    check_enough(len(scans), 2 * PER_BUMP * part.ring.bumps, "scans", where)
    for index, probe in enumerate(part.probes):
        others = np.delete(scans.ring_voltages, index, axis=1)
        own = scans.ring_voltages[:, [index]]
        check_alive((f"ring probe {probe.name}",), own, np.zeros_like(own), others, where)
    said = None
    if options.theta:
        track = recording.track(options.theta, SCALAR)
        said = track.at(scans.stamps_ns, round(options.longest_gap * 1e9))[:, 0]
    estimates = _located(scans, calibration, said, part.bump_angle, where)
    thetas = estimates.thetas
    kept = np.isfinite(thetas) if said is None else np.isfinite(thetas) & np.isfinite(said)
    counted = thetas if said is None else said  # with a reference the POSOR's own begin anew at each scan, and wrap
    turned = float(np.ptp(counted[kept])) if kept.any() else 0.0
    if turned < 2.0 * np.pi * (1.0 - 1.0 / part.ring.bumps):
        raise FitError(f"{turned / (2.0 * np.pi):.2f} of a turn", where=where, expected="a full turn, better several")
    which = np.flatnonzero(kept)
    if said is not None:
        _check_turning(said[which] - thetas[which], part, recording.track(options.theta, SCALAR).source)
    if len(which) > options.at_most:
        which = which[np.round(np.linspace(0, len(which) - 1, options.at_most)).astype(np.int64)]
    poses = [pin.SE3(estimates.rotations[i], estimates.translations[i]) for i in which]
    return _Turns(scans.chosen(which), poses, thetas[which], None if said is None else said[which])


def _check_turning(ahead: FloatArray, part: BumpyRingCalibration, source: str) -> None:
    """Refuse a reference of theta that is ahead of the ring [rad] by now this, now that part of a bump, (n,).

    Raises:
        TrackError: It turns unlike the ring: in another unit or sense, or it is of another joint.

    """
    together = float(np.abs(np.mean(np.exp(1j * part.ring.bumps * ahead))))
    if together < TOGETHER:
        raise TrackError(
            f"turns unlike the ring: its theta has no fixed place within the bumps, which are "
            f"{part.bump_angle:.3g} rad long",
            where=source,
            expected="theta of this joint [rad], positive about Z, stamped by the clock of the scans",
        )


def _located(scans: Scans, calibration: Calibration, said: FloatArray | None, bump: float, where: str) -> Estimates:
    """Return the poses by the present profile, their thetas counted from the home mark or by the reference.

    Raises:
        FitError: Neither is there, or the count is lost.

    """
    posor = Posor(calibration.model_copy(update={"motion": None}), false_alarm=0.0)
    if said is not None:
        return posor.locate_each(scans, said)
    estimates = posor.locate_all(scans)
    homes = np.flatnonzero(scans.at_home)
    if not homes.size:
        raise FitError("no scan saw the home mark", where=where, expected="one at least, or a reference of theta")
    lost = np.flatnonzero((estimates.faults[homes[0] :] & int(Fault.COUNT)) != 0)
    if lost.size:
        number = int(scans.numbers[homes[0] + lost[0]])
        raise FitError(
            f"the count of bumps is in doubt at scan {number}, the turns do not close",
            where=where,
            expected=f"scans less than a quarter of a bump, {0.25 * bump:.3g} rad, from where the motion leads",
        )
    estimates.thetas[estimates.states == int(State.UNCOUNTED)] = np.nan
    return estimates


def _reference(turns: _Turns, recording: Recording, options: RingProfileOptions) -> PoseReference | None:
    """Return what is known of the poses besides the readings: theta, the axis' run, or nothing."""
    if turns.said is None and options.runout_sigma is None:
        return None
    sigmas = np.full((len(turns.poses), 6), UNKNOWN)
    poses = [pose.copy() for pose in turns.poses]
    if options.runout_sigma is not None:
        sigmas[:, :2] = options.runout_sigma
        middle = np.mean([pose.translation for pose in poses], axis=0)
        for pose in poses:
            pose.translation = np.array([*middle[:2], pose.translation[2]])
    if turns.said is not None:
        sigmas[:, 5] = recording.track(options.theta, SCALAR).sigmas[0]
        for pose, theta, said in zip(poses, turns.thetas, turns.said, strict=True):
            pose.rotation = pin.utils.rotate("z", float(said - theta)) @ pose.rotation
    return PoseReference(poses, sigmas, np.zeros(12))


def _short(name: str, orders: list[int]) -> str:
    """Return ``cos 36`` for ``sensors[1].ring.cos[2]``."""
    what = name.rsplit(".", maxsplit=1)[-1]
    if "[" not in what:
        return what
    head, _, index = what.partition("[")
    return f"{head} {orders[int(index.rstrip(']'))]}"


def _outcome(
    found: Fit,
    part: BumpyRingCalibration,
    orders: list[int],
    key: str,
    turns: _Turns,
    scales: FloatArray,
    options: RingProfileOptions,
    joint: JointCovariance,
) -> Outcome:
    remaining = dict(zip(found.names, (found.sigmas / scales).tolist(), strict=True))
    untold = [k for k in orders if max(remaining[f"cos {k}"], remaining[f"sin {k}"]) > UNTOLD]
    ring = part.ring.model_dump(mode="json")
    for name in ("cos", "sin"):
        values = [found.value(f"{name} {k}") for k in orders]
        sigmas = [found.sigma(f"{name} {k}") for k in orders]
        ring[name] = {"value": values, "sigma": sigmas, "unit": "m"}
    radius = "mean_radius"
    ring[radius] = {"value": found.value(radius), "sigma": found.sigma(radius), "unit": "m"}
    ring["orders"] = orders
    warnings = []
    if untold:
        lacking = [
            word
            for word, known in (("a reference of theta", options.theta), ("runout_sigma", options.runout_sigma))
            if not known
        ]
        more = f"; {' or '.join(lacking)} would tell more" if lacking else ""
        warnings.append(
            f"Orders {', '.join(map(str, untold))} cannot be separated from runout or uneven turning: they stay as "
            f"they were{more}."
        )
    return Outcome(
        method=f"self-calibration over {turns.turned / (2.0 * np.pi):.2f} turns, {len(turns.thetas)} scans, poses "
        f"eliminated; theta {'by a reference' if options.theta else 'counted from the home mark'}",
        fits={NAME: found},
        parts=(Part(key, ring),),
        covariances=(joint,),
        tables=(_table(found, part, orders, remaining),),
        warnings=(*warnings, *residual_warnings(found)),
        figures=(_figure(found, part, orders),),
    )


def _table(found: Fit, part: BumpyRingCalibration, orders: list[int], remaining: dict[str, float]) -> Table:
    before = {
        f"{name} {k}": amplitude
        for name, quantity in (("cos", part.ring.cos), ("sin", part.ring.sin))
        for k, amplitude in zip(part.ring.orders, quantity.array, strict=True)
    }
    rows = tuple(
        (
            k,
            name,
            float(before.get(f"{name} {k}", 0.0)) / UM,
            found.value(f"{name} {k}") / UM,
            found.sigma(f"{name} {k}") / UM,
            remaining[f"{name} {k}"],
        )
        for k in orders
        for name in ("cos", "sin")
    )
    columns = ("order", "part", "before", "found", "sigma", "remaining")
    return Table("profile of the ring", columns, ("", "", "um", "um", "um", "of the sigma before"), rows)


def _figure(found: Fit, part: BumpyRingCalibration, orders: list[int]) -> Figure:
    azimuths = np.linspace(0.0, 2.0 * np.pi, 40 * part.ring.bumps)
    after = np.zeros_like(azimuths)
    before = np.zeros_like(azimuths)
    for k in orders:
        after += found.value(f"cos {k}") * np.cos(k * azimuths) + found.value(f"sin {k}") * np.sin(k * azimuths)
    for k, c, s in zip(part.ring.orders, part.ring.cos.array, part.ring.sin.array, strict=True):
        before += c * np.cos(k * azimuths) + s * np.sin(k * azimuths)
    change = {"found less before": (azimuths, (after - before) / UM)}
    return Figure("change of the profile", "azimuth [rad]", "radius [um]", change)


PROCEDURE = Procedure(NAME, "profile of a bumpy ring from full turns", RingProfileOptions, find_ring_profile)
