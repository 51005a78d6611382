# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""True poses of a simulated arm over one cycle of its scenario.

J_i is the structure before bearing i, K_i behind it, B_i the line of the measuring beam that starts there:

    K_i     = J_i E_i(theta) O_i Rz(theta)      E_i: error motions of the bearing, O_i: its nominal origin
    J_(i+1) = K_i L_i after the bend of link i  L_i: the nominal link
    B_i     = K_i rotated about its origin by the least rotation that brings the line of L_i onto J_(i+1)

A measuring beam is hung on its structural link at both ends, so the link does not bend it: it follows the line from
joint to joint and keeps its roll from K_i. The POSOR of joint i sees the target plate on beam i from the receiving
plate at the end of beam i - 1; the first receiving plate is on the base.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from posor_drivers.simulator.imperfections import RandomStream, shared_errors
from posor_drivers.simulator.link_vibration import SharedBeam, drive_beam, vibrating_links
from posor_drivers.simulator.mechanics import (
    LinkCompliance,
    apply_backlash,
    bearing_error_motions,
    bend_links,
    quantise_encoder,
)
from posor_drivers.simulator.pose_array import ArmTruth, PoseArray

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.chain.kinematic_chain import Chain, FixedLink
    from posor.chain.measuring_beam import MeasuringBeam
    from posor.numerics.array_types import FloatArray

    from posor_drivers.simulator.beam_heat import BeamHeat
    from posor_drivers.simulator.imperfections import Imperfections
    from posor_drivers.simulator.link_vibration import DrivenBeam
    from posor_drivers.simulator.mechanics import LinkBend
    from posor_drivers.simulator.nominal_arm import NominalArm
    from posor_drivers.simulator.scenario import Scenario
    from posor_drivers.simulator.truth_model import TrueArm, TrueLink


@dataclass(frozen=True)
class TrueBeam:
    """One true beam from target plate to receiving plate; without beam in the beams file a link is exact."""

    before: pin.SE3  # from the target plate to the beam's start
    end: pin.SE3  # from the beam's start to its end, without sag
    after: pin.SE3  # from the beam's end to the next receiving plate, or to the endpoint
    start_gain: FloatArray
    """Motion of the plate at the start per specific force, axes of the start, (6, 3), see ``MeasuringBeam``."""
    end_gain: FloatArray  # the same for the plate at the end
    warm_ends: PoseArray | None = None  # the end at the temperatures of n ticks; None: it does not change
    sag_factor: float = 1.0  # of the sag without errors

    @classmethod
    def without_errors(cls, link: FixedLink, true_link: TrueLink | None) -> TrueBeam:
        """Return the beam of a link as another model describes it; None: as ``link`` does."""
        if true_link is not None:
            return cls(true_link.before, true_link.end, true_link.after, true_link.start_gain, true_link.end_gain)
        if link.beam is None:
            return cls(link.before, pin.SE3.Identity(), link.after, np.zeros((6, 3)), np.zeros((6, 3)))
        return cls(link.before, link.beam.T_start_end, link.after, link.beam.start_gain, link.beam.end_gain)

    def draw(
        self,
        beam: MeasuringBeam | None,
        seed: int,
        imperfections: Imperfections,
        warm_ends: tuple[FloatArray, FloatArray] | None = None,
    ) -> TrueBeam:
        """Return the beam with errors; ``beam`` states their uncertainties, ``seed`` is that of the scenario.

        ``warm_ends``: the end without errors at the temperatures of n ticks, (n, 3, 3), (n, 3) [m].
        """
        if beam is None:
            return self
        random = RandomStream(seed, "beam", beam.name).generator()
        error = np.sqrt(np.diagonal(beam.covariance)) * random.normal(size=6)
        scale = 1.0 + beam.sag_sigma * float(random.normal())
        for name, value in zip(beam.shared_placements, shared_errors(seed, beam.shared_placements), strict=True):
            error += value * beam.shared_placements[name]
            scale += value * beam.shared_sags[name]
        end, warm = self.end, None if warm_ends is None else PoseArray(*warm_ends)
        if imperfections.beam_errors:
            end = pin.SE3(pin.exp3(error[3:]) @ end.rotation, end.translation + error[:3])
            warm = None if warm is None else warm.displace(error[:3], error[3:])
        factor = (scale if imperfections.beam_errors else 1.0) if imperfections.sag else 0.0
        gains = {"start_gain": factor * self.start_gain, "end_gain": factor * self.end_gain}
        return replace(self, end=end, warm_ends=warm, sag_factor=factor, **gains)

    def plates(
        self, lines: PoseArray, specific_force: FloatArray, driven: DrivenBeam | None = None
    ) -> tuple[PoseArray, PoseArray]:
        """Return the target plate at the start and the receiving plate at the end.

        ``lines`` (n) go through the gimbals: the target plate without sag. ``specific_force`` is gravity minus
        acceleration [m/s^2], (3,) or (n, 3), in their parent frame. ``driven``: what vibration does beside.
        """
        start = lines @ self.before
        force = start.rotate_back(specific_force)
        at_start, at_end = force @ self.start_gain.T, force @ self.end_gain.T
        if driven is not None:
            at_start, at_end = (
                at_start + self.sag_factor * driven.start_motion,
                at_end + self.sag_factor * driven.end_motion,
            )
        sag_at_start = PoseArray.from_rotation_vectors(*np.hsplit(at_start, 2))
        ends = PoseArray.repeat(self.end, len(start)) if self.warm_ends is None else self.warm_ends
        end = ends.displace(*np.hsplit(at_end, 2))
        return start @ sag_at_start @ self.before.inverse(), start @ end @ self.after


def true_cycle(
    scenario: Scenario,
    chain: Chain,
    arm: NominalArm,
    commanded: FloatArray,
    imperfections: Imperfections,
    truth: TrueArm | None = None,
    heats: Mapping[str, BeamHeat] | None = None,
) -> ArmTruth:
    """Return the truth over one cycle of commanded angles [rad], (n, j), with the stage in its middle.

    ``heats``: temperatures of beams at the n ticks, by name.

    ``chain`` is the arm as its files describe it; ``truth`` is another model of it, whose geometry, gravity and sag
    hold then, and from which ``arm`` is made too. Of the imperfections, those of the measuring beams have an effect.
    """
    gravity = chain.gravity if truth is None else truth.gravity
    true_links = [None] * len(chain.links) if truth is None else truth.links
    settings = [scenario.joints[name] for name in arm.joints]
    encoder, angles = commanded.copy(), commanded.copy()
    for column, joint in enumerate(settings):
        if joint.encoder is not None:
            encoder[:, column] = quantise_encoder(commanded[:, column], joint.encoder.resolution.number)
        if joint.gear is not None:
            angles[:, column] = apply_backlash(commanded[:, column], joint.gear.backlash.number)
    spans = [link.translation for link in arm.links[1:]]
    compliances = [
        LinkCompliance.from_structure(joint.structure, float(np.linalg.norm(span)))
        for joint, span in zip(settings, spans, strict=True)
    ]
    bends = bend_links(arm.target_plates(angles), spans, compliances, scenario.payload.mass.number, gravity)
    exact = [TrueBeam.without_errors(link, true) for link, true in zip(chain.links, true_links, strict=True)]
    beams = []
    for beam, link, true in zip(exact, chain.links, true_links, strict=True):
        heat = None if link.beam is None else (heats or {}).get(link.beam.name)
        warm = None if heat is None or link.beam is None else heat.ends(link.beam, true)
        beams.append(beam.draw(link.beam, scenario.seed, imperfections, warm))
    forces = _specific_forces(gravity, exact, arm, commanded, scenario.ticks_per_second, inertia=imperfections.inertia)
    base, rate = PoseArray.repeat(pin.SE3.Identity(), len(commanded)), scenario.ticks_per_second
    lines = still = _lines(scenario, arm, angles, bends)
    if imperfections.vibration and scenario.vibrations:
        vibrations = [scenario.vibrations.get(name) for name in arm.joints]
        lines = _lines(scenario, arm, angles, vibrating_links(bends, spans, vibrations, rate))
    last_receiving = receiving = beams[0].plates(base, forces[0])[1]
    seen: dict[str, PoseArray] = {}
    specific_forces: dict[str, FloatArray] = {}
    for column, name in enumerate(arm.joints):
        driven, own, true = None, chain.links[column + 1].beam, true_links[column + 1]
        if own is not None and (own.entry.vibration or (own.entry.sag and lines is not still)):
            before = exact[column + 1].before
            starts, at_rest = lines[column] @ before, still[column] @ before
            model = true or SharedBeam(own)
            pace = _pace(own, model, scenario.seed, drawn=imperfections.beam_errors)
            driven = drive_beam(own, model, starts, at_rest, rate, pace)
            force = starts.rotate_back(forces[column + 1])[:, None]
            specific_forces[own.name] = force - driven.accelerations
        target, next_receiving = beams[column + 1].plates(lines[column], forces[column + 1], driven)
        seen[name] = receiving.inverse() @ target
        last_receiving, receiving = receiving, next_receiving
    return ArmTruth(
        arm.joints,
        commanded,
        encoder,
        angles,
        seen,
        np.swapaxes(last_receiving.rotations, 1, 2),
        receiving,
        arm.endpoint(commanded),
        specific_forces,
    )


def _pace(beam: MeasuringBeam, model: SharedBeam | TrueLink, seed: int, *, drawn: bool) -> float:
    """Return the natural frequency of a beam over that of a model of it.

    The natural frequency is that of the beams file with an error drawn within its uncertainty; that of the model: not
    stated.
    """
    if beam.entry.vibration is None:
        return 1.0
    frequency, error = beam.entry.vibration.frequency, RandomStream(seed, "vibration", beam.name).generator().normal()
    return float(frequency.number + drawn * error * float(frequency.sigmas)) / model.first_frequency


def _lines(scenario: Scenario, arm: NominalArm, angles: FloatArray, bends: Sequence[LinkBend]) -> list[PoseArray]:
    """Return the lines of the measuring beams behind all joints at joint angles (n, j) [rad]."""
    structure = PoseArray.repeat(arm.links[0], len(angles))
    lines = []
    for column, name in enumerate(arm.joints):
        behind, joint = structure, scenario.joints[name]
        if joint.bearing is not None:
            random = RandomStream(scenario.seed, "bearing", name).generator()
            behind = behind @ bearing_error_motions(joint.bearing, angles[:, column], random)
        behind = behind @ arm.origins[column] @ PoseArray.from_axis_angles(2, angles[:, column])
        link, bend = arm.links[column + 1], bends[column]
        end = PoseArray.repeat(link, len(angles)).displace(bend.translations, bend.rotations)
        structure = behind @ end
        lines.append(behind @ _least_rotations(link.translation, end.translations))
    return lines


def _specific_forces(
    gravity: FloatArray, beams: Sequence[TrueBeam], arm: NominalArm, commanded: FloatArray, rate: int, *, inertia: bool
) -> list[FloatArray]:
    """Return gravity minus the acceleration of the middle of each link's beam [m/s^2], (n, 3) or (3,), in the base.

    The acceleration is that of the commanded motion, which repeats with the cycle; backlash is neglected.
    """
    forces: list[FloatArray] = [gravity]
    for target, beam in zip(arm.target_plates(commanded), beams[1:], strict=True):
        force = gravity
        if inertia and beam.end_gain.any():
            centre = (target @ beam.before @ pin.SE3(np.eye(3), 0.5 * beam.end.translation)).translations
            force = force - rate**2 * (np.roll(centre, -1, axis=0) - 2.0 * centre + np.roll(centre, 1, axis=0))
        forces.append(force)
    return forces


def _least_rotations(before: FloatArray, after: FloatArray) -> PoseArray:
    """Return the least rotations that bring the direction ``before`` (3,) onto the directions ``after`` (n, 3)."""
    length = float(np.linalg.norm(before))
    vectors = np.zeros(after.shape)
    if length > 0.0:
        cross = np.cross(before / length, after / np.linalg.norm(after, axis=1, keepdims=True))
        sine = np.linalg.norm(cross, axis=1, keepdims=True)
        vectors = np.divide(np.arcsin(sine), sine, out=np.ones(sine.shape), where=sine > 0.0) * cross
    return PoseArray.from_rotation_vectors(np.zeros(after.shape), vectors)
