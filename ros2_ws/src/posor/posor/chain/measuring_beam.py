# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A measuring beam: the bar between two POSORs, its sag on its gimbals, and its thermal expansion.

The beam carries only its own weight and the plates of the POSORs at its ends. Its sag follows from its section and
from the direction of gravity, and is corrected (thesis 6.2.1, 9.3.2). Sag is linear in the component of the specific
force (gravity minus acceleration) across the beam. A beam whose temperature is measured has the length that follows
from the temperature (``at_temperature``); of every other beam, the uncertainty of the temperature is in the covariance.
The largest expansion that may remain is a bound, which only protection levels use (``chain.fault_bounds``).
"""

from __future__ import annotations

import math
from copy import copy
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor.calibration.shared_terms import effect_on
from posor.chain.beam_bending import PointForce, Tube, on_gimbals
from posor.chain.beam_entries import STANDARD_GRAVITY
from posor.errors import ChainError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.calibration.shared_terms import SharedTerm
    from posor.chain.beam_bending import BentBeam
    from posor.chain.beam_entries import BeamFile, SagFile
    from posor.chain.robot_model import FreeJoint
    from posor.numerics.array_types import FloatArray

LARGEST_SAG, LARGEST_SLOPE = 0.01, 0.01  # of a beam's length, [rad]: beyond, the linear theory of bending does not hold
LARGEST_MASS = 30.0  # of a plate, in masses of the beam's tube
LARGEST_PLATE_OFFSET = 0.05  # of a plate's centre of mass from the link of its name [m]
_PLACES = 65  # along a beam, where sag and slope are compared with them
LEAST_FREQUENCY, MOST_FREQUENCY = 0.3, 1.5  # natural frequency of a beam, in those of its tube and plates


class MeasuringBeam:
    """One beam, from the frame at its start to the frame at its end.

    Attributes:
        name: Name of the fixed joint in the URDF.
        T_start_end: The beam without sag, at its measured temperature or that of the URDF.
        covariance: Of the placement, (6, 6) of x, y, z [m], about X, Y, Z [rad] of the end, axes of the start, the
            small turn applied on the start's side at the end's origin.
        thermal: Independent changes of the end by the uncertain temperature, one standard deviation each, (n, 6), as
            ``covariance``, which does not contain them; no rows: no uncertainty is stated.
        expansion: Largest change of the end's translation by the unknown temperature, (3,) [m], axes of the start;
            zero: not stated.
        sag_sigma: Standard uncertainty of the sag, relative to the sag.
        start_gain: (6, 3): translation [m] and rotation vector [rad] of the plate at the start, axes of the start, for
            a specific force [m/s^2] in the same axes, counted from the line through the gimbals.
        end_gain: (6, 3): the same of the plate at the end.
        start_tilt_gain: (6, 3): as ``start_gain``, for a specific force that grows along the beam by 1 m/s^2, from
            -0.5 m/s^2 at its start.
        end_tilt_gain: (6, 3): the same of the plate at the end.
        shared_placements: By name of a shared term: change of the end by one standard uncertainty, (6,) as
            ``covariance``, which does not contain the terms; changes of the sag and by the temperature apart.
        shared_effects: The same with the change by the temperature.
        shared_sags: The same: relative change of the sag.

    """

    def __init__(self, entry: BeamFile, T_start_end: pin.SE3, shared: Mapping[str, SharedTerm] | None = None) -> None:
        """Create the beam from its entries in the beams file and in the URDF, which have none of ``beam_faults``.

        ``entry``: its entry in the beams file; ``T_start_end``: origin of its fixed joint; ``shared``: the file's
        shared terms.
        """
        self.name, self.entry, self._shared = entry.joint, entry, shared or {}
        self._cold = self.T_start_end = T_start_end
        sigmas = np.concatenate([entry.uncertainty.position.array, entry.uncertainty.orientation.array])
        self.covariance: FloatArray = np.diag(np.square(sigmas))
        self.start_gain: FloatArray = np.zeros((6, 3))
        self.end_gain: FloatArray = np.zeros((6, 3))
        self.start_tilt_gain: FloatArray = np.zeros((6, 3))
        self.end_tilt_gain: FloatArray = np.zeros((6, 3))
        self.sag_sigma = 0.0
        if entry.sag is not None:
            self.sag_sigma = entry.sag.uncertainty.number
            self._compute_gains(entry.sag)
        self.shared_placements: dict[str, FloatArray] = {}
        self.shared_sags: dict[str, float] = {}
        for name, term in self._shared.items():
            shift = effect_on(term, f"{entry.joint}.position", T_start_end.translation)
            turn = effect_on(term, f"{entry.joint}.orientation", np.zeros(3))
            self.shared_placements[name] = np.concatenate([shift, turn])
            self.shared_sags[name] = self.shared_change(name, "sag")
        self._set_temperature(None)

    def shared_change(self, term: str, quantity: str) -> float:
        """Return the change of a number of the beam by one standard uncertainty of a shared term."""
        return float(effect_on(self._shared[term], f"{self.name}.{quantity}", np.ones(())))

    def at_temperature(self, kelvin: float | None) -> MeasuringBeam:
        """Return the same beam at the temperature of its thermometer [K]; None: the thermometer cannot be used."""
        beam = copy(self)
        beam._set_temperature(kelvin)  # noqa: SLF001  of the same class
        return beam

    def _set_temperature(self, kelvin: float | None) -> None:
        own, self.T_start_end = self.entry.temperature, self._cold
        self.thermal: FloatArray = np.zeros((0, 6))
        self.expansion: FloatArray = np.zeros(3)
        self.shared_effects: dict[str, FloatArray] = dict(self.shared_placements)
        if own is None:
            return
        span, coefficient = self._cold.translation, own.coefficient.number
        spread, bound, change, unknown = (
            0.0 if own.spread is None else own.spread.number,
            own.deviation.number,
            0.0,
            0.0,
        )
        if kelvin is not None and (thermometer := own.thermometer) is not None:
            change = kelvin - thermometer.reference.number
            self.T_start_end = pin.SE3(self._cold.rotation, (1.0 + coefficient * change) * span)
            drift = thermometer.rate.number * thermometer.age.number
            along = 0.0 if own.gradient is None else own.gradient.along.number
            spread = math.hypot(thermometer.uncertainty.number, along, drift / math.sqrt(3.0))  # drift: rectangular
            bound += abs(change)  # what a wrong reading within its range does unseen
            if thermometer.neighbour is not None:
                bound = min(bound, 2.0 * thermometer.neighbour.difference.number + drift)
            unknown = float(own.coefficient.sigmas) * change
        self.expansion = coefficient * bound * span
        stretch = math.hypot(coefficient * spread, unknown) * span
        across = 0.0 if own.gradient is None else own.gradient.across.number
        effects = [np.concatenate([stretch, np.zeros(3)]), *(across * bend for bend in self.bends_per_kelvin())]
        self.thermal = np.array([effect for effect in effects if effect.any()]).reshape(-1, 6)
        for name in self._shared:
            heat = (
                self.shared_change(name, "temperature") if kelvin is None else -self.shared_change(name, "thermometer")
            )
            strain = coefficient * (heat + self.shared_change(name, "coefficient") * change)
            if strain:
                self.shared_effects[name] = self.shared_placements[name] + np.concatenate([strain * span, np.zeros(3)])

    def bends_per_kelvin(self) -> list[FloatArray]:
        """Return the changes of the end, (6,) each as ``covariance``, by 1 K between opposite sides, in two directions.

        Such a difference bends a beam that is free to an arc. Empty: the beam has no difference across.
        """
        length, own, width = float(np.linalg.norm(self._cold.translation)), self.entry.temperature, self.entry.width
        if own is None or width is None or not length:
            return []
        curvature, along = own.coefficient.number / width.number, self._cold.translation / length
        sides = np.linalg.svd(along[None, :])[2][1:]  # two directions across
        return [curvature * np.concatenate([0.5 * length**2 * side, length * np.cross(along, side)]) for side in sides]

    def _compute_gains(self, sag: SagFile) -> None:
        length = float(np.linalg.norm(self.T_start_end.translation))
        along = self.T_start_end.translation / length
        across = np.eye(3) - np.outer(along, along)
        for bent, start_gain, end_gain in (
            (_bent(sag, length), self.start_gain, self.end_gain),
            (_bent_by_tilt(sag, length), self.start_tilt_gain, self.end_tilt_gain),
        ):
            for x, gain in ((0.0, start_gain), (length, end_gain)):
                gain[:3] = bent.deflection(x) * across
                gain[3:] = bent.slope(x) * pin.skew(along) @ across

    def T_under(self, force: FloatArray) -> pin.SE3:
        """Return start plate to end plate under a specific force [m/s^2], (3,), axes of the start."""
        return _moved(pin.SE3.Identity(), self.start_gain @ force).inverse() * _moved(
            self.T_start_end, self.end_gain @ force
        )

    def covariance_under(self, force: FloatArray) -> FloatArray:
        """Return the covariance of ``T_under``, as the attribute ``covariance``, including that of the sag."""
        total = self.covariance_without_sag + self.spread_covariance
        if self.sag_sigma == 0.0:
            return total
        sag = self.sag_sigma * (self.sag_gain @ force)
        return total + np.outer(sag, sag)

    @property
    def covariance_without_sag(self) -> FloatArray:
        """Sum of ``covariance`` and of the products of ``thermal``, (6, 6)."""
        return self.covariance + self.thermal.T @ self.thermal

    def shared_effects_under(self, force: FloatArray) -> dict[str, FloatArray]:
        """Return the changes of ``T_under`` by one standard uncertainty of each shared term, by name, (6,)."""
        sag = self.sag_gain @ force
        return {name: effect + self.shared_sags[name] * sag for name, effect in self.shared_effects.items()}

    @property
    def spread_covariance(self) -> FloatArray:
        """Of the sag while no accelerometer can be used, (6, 6), as ``covariance``; zero: no vibration is stated."""
        sigma = 0.0 if self.entry.vibration is None else self.entry.vibration.spread.number
        gains = np.hstack([self.sag_gain, self.tilt_gain])
        spread: FloatArray = sigma**2 * gains @ gains.T
        return spread

    @property
    def sag_gain(self) -> FloatArray:
        """(6, 3): translation [m] and rotation vector [rad] of the end relative to the plate at the start, as above."""
        return self._relative_gain(self.start_gain, self.end_gain)

    @property
    def tilt_gain(self) -> FloatArray:
        """(6, 3): as ``sag_gain``, for a specific force that grows along the beam as for ``start_tilt_gain``."""
        return self._relative_gain(self.start_tilt_gain, self.end_tilt_gain)

    def _relative_gain(self, start: FloatArray, end: FloatArray) -> FloatArray:
        gain: FloatArray = end - start
        gain[:3] += pin.skew(self.T_start_end.translation) @ start[3:]
        return gain


def _moved(T_start_plate: pin.SE3, motion: FloatArray) -> pin.SE3:
    """Return a plate after a small motion in the axes of the beam's start, turned about its own origin."""
    return pin.SE3(pin.exp3(motion[3:]) @ T_start_plate.rotation, T_start_plate.translation + motion[:3])


def _tube(sag: SagFile) -> Tube:
    own = sag.tube
    return Tube(own.outer_diameter.number, own.inner_diameter.number, own.modulus.number, own.density.number)


def _bent(sag: SagFile, length: float) -> BentBeam:
    """Return the shape of a beam under a specific force of 1 m/s^2: masses are in place of forces."""
    (near, far), tube = sag.gimbals.array.tolist(), _tube(sag)
    masses = [PointForce(plate.at.number, plate.mass.number) for plate in sag.plates]
    return on_gimbals(length, tube.bending_stiffness, tube.mass_per_length, masses, (near, far))


def _bent_by_tilt(sag: SagFile, length: float) -> BentBeam:
    """Return the shape under a specific force that grows from -0.5 m/s^2 at the start to 0.5 m/s^2 at the end."""
    (near, far), tube = sag.gimbals.array.tolist(), _tube(sag)
    forces = [PointForce(p.at.number, p.mass.number * (p.at.number / length - 0.5)) for p in sag.plates]
    load = tube.mass_per_length
    return on_gimbals(length, tube.bending_stiffness, -0.5 * load, forces, (near, far), load / length)


def beam_faults(entry: BeamFile, joint: FreeJoint, source: str) -> list[ChainError]:
    """Return what is wrong with a beam: gimbals or plates beyond its ends, heavy plates, sag beyond the linear theory.

    A plate with the name of the link at an end of the beam must be there: the length in the URDF may have been changed.

    ``entry``: its entry in the beams file; ``joint``: its fixed joint; ``source``: name of the beams file in errors.
    """
    sag, where = entry.sag, f"{source}, beam '{entry.joint}'"
    if sag is None:
        return []
    length = float(np.linalg.norm(joint.T_parent_joint.translation))
    positions = [("gimbal", float(at)) for at in sag.gimbals.array]
    positions += [(f"plate '{plate.name}'", plate.at.number) for plate in sag.plates]
    expected = f"0 to {length:g} m, the beam's length"
    faults = [
        ChainError(f"{name} at {at:g} m", where=where, expected=expected)
        for name, at in positions
        if not 0.0 <= at <= length
    ]
    for plate in sag.plates:
        there = {joint.parent: 0.0, joint.child: length}.get(plate.name, plate.at.number)
        if plate.at.number <= length and abs(plate.at.number - there) > LARGEST_PLATE_OFFSET:
            what = f"plate '{plate.name}' at {plate.at.number:g} m"
            expected = f"{there:g} m, where the URDF has the link of this name; the gimbals may be wrong, too"
            faults.append(ChainError(what, where=where, expected=expected))
    weight = _tube(sag).mass_per_length * length
    expected = f"at most {LARGEST_MASS:g} times the mass of its tube, {weight:.3g} kg (masses in g, or lengths in mm?)"
    faults += [
        ChainError(f"plate '{plate.name}' has {plate.mass.number:g} kg", where=where, expected=expected)
        for plate in sag.plates
        if plate.mass.number > LARGEST_MASS * weight
    ]
    if faults:
        return faults
    bent, places = _bent(sag, length), np.linspace(0.0, length, _PLACES)
    deflection = STANDARD_GRAVITY * max(abs(bent.deflection(x)) for x in places)
    slope = STANDARD_GRAVITY * max(abs(bent.slope(x)) for x in places)
    if deflection <= LARGEST_SAG * length and slope <= LARGEST_SLOPE:
        return _frequency_faults(entry, sag, length, where)
    expected = (
        f"at most {LARGEST_SAG * length:.3g} m and {LARGEST_SLOPE:g} rad, as far as the linear theory holds (modulus "
        "in GPa, diameters in mm, density in g/cm^3 or masses in g?)"
    )
    what = f"sags by {deflection:.3g} m, with a slope of {slope:.3g} rad, under its weight"
    return [ChainError(what, where=where, expected=expected)]


def _frequency_faults(entry: BeamFile, sag: SagFile, length: float, where: str) -> list[ChainError]:
    """Return what is wrong with the natural frequency of a beam: it is far from that of its tube and plates.

    That is Rayleigh's upper bound, with the static shape: work of the loads over the motion of the masses.
    """
    if entry.vibration is None:
        return []
    bent, tube = _bent(sag, length), _tube(sag)
    places = (np.arange(_PLACES) + 0.5) * length / _PLACES
    masses = [(float(x), tube.mass_per_length * length / _PLACES) for x in places]
    masses += [(plate.at.number, plate.mass.number) for plate in sag.plates]
    work, motion = (math.fsum(m * bent.deflection(x) ** power for x, m in masses) for power in (1, 2))
    bound, stated = math.sqrt(work / motion) / (2.0 * math.pi), entry.vibration.frequency.number
    if LEAST_FREQUENCY * bound <= stated <= MOST_FREQUENCY * bound:
        return []
    expected = (
        f"{LEAST_FREQUENCY * bound:.4g} to {MOST_FREQUENCY * bound:.4g} Hz; that of its tube and plates is about "
        f"{bound:.4g} Hz (in rad/s, or is a plate missing in 'sag'?)"
    )
    return [ChainError(f"natural frequency {stated:.4g} Hz", where=where, expected=expected)]
