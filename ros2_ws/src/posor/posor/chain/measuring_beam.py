"""A measuring beam: the bar between two POSORs, its sag on its gimbals, and its thermal expansion.

The beam carries only its own weight and the plates of the POSORs at its ends. Its sag follows from its section and
from the direction of gravity, and is corrected (thesis 6.2.1, 9.3.2). Sag is linear in the component of the specific
force (gravity minus acceleration) across the beam. The temperature of the beam is not measured: the expansion is a
bound, which only protection levels use (``uncertainty.protection_level``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor.calibration.shared_terms import effect_on
from posor.chain.beam_bending import PointForce, Tube, on_gimbals
from posor.chain.beams_file import STANDARD_GRAVITY
from posor.errors import ChainError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.calibration.shared_terms import SharedTerm
    from posor.chain.beam_bending import BentBeam
    from posor.chain.beams_file import BeamFile, SagFile
    from posor.chain.robot_model import FreeJoint
    from posor.numerics.array_types import FloatArray

LARGEST_SAG, LARGEST_SLOPE = 0.01, 0.01  # of a beam's length, [rad]: beyond, the linear theory of bending does not hold
LARGEST_MASS = 30.0  # of a plate, in masses of the beam's tube
LARGEST_PLATE_OFFSET = 0.05  # of a plate's centre of mass from the link of its name [m]
_PLACES = 65  # along a beam, where sag and slope are compared with them


class MeasuringBeam:
    """One beam, from the frame at its start to the frame at its end.

    Attributes:
        name: Name of the fixed joint in the URDF.
        T_start_end: The beam without sag.
        covariance: (6, 6) of x, y, z [m], about X, Y, Z [rad] of the end, axes of the start, the small turn applied on
            the start's side at the end's origin.
        expansion: Largest change of the end's translation by the temperature, (3,) [m], axes of the start: coefficient
            of expansion times deviation times translation; zero: not stated.
        sag_sigma: Standard uncertainty of the sag, relative to the sag.
        start_gain: (6, 3): translation [m] and rotation vector [rad] of the plate at the start, axes of the start, for
            a specific force [m/s^2] in the same axes, counted from the line through the gimbals.
        end_gain: (6, 3): the same of the plate at the end.
        shared_effects: By name of a shared term: change of the end by one standard uncertainty, (6,) as ``covariance``,
            which does not contain the terms; the change of the sag apart.
        shared_sags: The same: relative change of the sag.

    """

    def __init__(self, entry: BeamFile, T_start_end: pin.SE3, shared: Mapping[str, SharedTerm] | None = None) -> None:
        """Create the beam from its entries in the beams file and in the URDF, which have none of ``beam_faults``.

        ``entry``: its entry in the beams file; ``T_start_end``: origin of its fixed joint; ``shared``: the file's
        shared terms.
        """
        self.name = entry.joint
        self.T_start_end = T_start_end
        sigmas = np.concatenate([entry.uncertainty.position.array, entry.uncertainty.orientation.array])
        self.covariance: FloatArray = np.diag(np.square(sigmas))
        self.expansion: FloatArray = np.zeros(3)
        if entry.temperature is not None:
            strain = entry.temperature.coefficient.number * entry.temperature.deviation.number
            self.expansion = strain * T_start_end.translation
        self.start_gain: FloatArray = np.zeros((6, 3))
        self.end_gain: FloatArray = np.zeros((6, 3))
        self.sag_sigma = 0.0
        if entry.sag is not None:
            self.sag_sigma = entry.sag.uncertainty.number
            self._compute_gains(entry.sag)
        self.shared_effects: dict[str, FloatArray] = {}
        self.shared_sags: dict[str, float] = {}
        for name, term in (shared or {}).items():
            shift = effect_on(term, f"{entry.joint}.position", T_start_end.translation)
            turn = effect_on(term, f"{entry.joint}.orientation", np.zeros(3))
            self.shared_effects[name] = np.concatenate([shift, turn])
            self.shared_sags[name] = float(effect_on(term, f"{entry.joint}.sag", np.ones(())))

    def _compute_gains(self, sag: SagFile) -> None:
        length = float(np.linalg.norm(self.T_start_end.translation))
        bent = _bent(sag, length)
        along = self.T_start_end.translation / length
        across = np.eye(3) - np.outer(along, along)
        for x, gain in ((0.0, self.start_gain), (length, self.end_gain)):
            gain[:3] = bent.deflection(x) * across
            gain[3:] = bent.slope(x) * pin.skew(along) @ across

    def T_under(self, force: FloatArray) -> pin.SE3:
        """Return start plate to end plate under a specific force [m/s^2], (3,), axes of the start."""
        return _moved(pin.SE3.Identity(), self.start_gain @ force).inverse() * _moved(
            self.T_start_end, self.end_gain @ force
        )

    def covariance_under(self, force: FloatArray) -> FloatArray:
        """Return the covariance of ``T_under``, as the attribute ``covariance``, including that of the sag."""
        if self.sag_sigma == 0.0:
            return self.covariance
        sag = self.sag_sigma * (self.sag_gain @ force)
        return self.covariance + np.outer(sag, sag)

    def shared_effects_under(self, force: FloatArray) -> dict[str, FloatArray]:
        """Return the changes of ``T_under`` by one standard uncertainty of each shared term, by name, (6,)."""
        sag = self.sag_gain @ force
        return {name: effect + self.shared_sags[name] * sag for name, effect in self.shared_effects.items()}

    @property
    def sag_gain(self) -> FloatArray:
        """(6, 3): translation [m] and rotation vector [rad] of the end relative to the plate at the start, as above."""
        gain = self.end_gain - self.start_gain
        gain[:3] += pin.skew(self.T_start_end.translation) @ self.start_gain[3:]
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
        return []
    expected = (
        f"at most {LARGEST_SAG * length:.3g} m and {LARGEST_SLOPE:g} rad, as far as the linear theory holds (modulus "
        "in GPa, diameters in mm, density in g/cm^3 or masses in g?)"
    )
    what = f"sags by {deflection:.3g} m, with a slope of {slope:.3g} rad, under its weight"
    return [ChainError(what, where=where, expected=expected)]
