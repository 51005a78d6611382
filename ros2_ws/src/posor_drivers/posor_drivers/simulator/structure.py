"""Where everything on the arm truly is over one cycle: joints, structure, measuring beams, POSORs.

J_i is the structure before bearing i, K_i behind it, B_i the line of the measuring beam that starts there:

    K_i     = J_i E_i(theta) O_i Rz(theta)      E_i: error motions of the bearing, O_i: its nominal origin
    J_(i+1) = K_i L_i after the bend of link i  L_i: the nominal link
    B_i     = K_i turned, about its origin, by the least turn that brings L_i's line onto J_(i+1)

A measuring beam hangs on its structural link at both ends and is not bent by it: it follows the line from joint to
joint, and keeps its roll from K_i. The POSOR of joint i sees the target plate on beam i from the receiving plate at the
end of beam i - 1; the first receiving plate is on the base.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor_estimator.errors import ChainError

from posor_drivers.simulator.bearing import error_motions
from posor_drivers.simulator.bending import Compliance, bends
from posor_drivers.simulator.play import after_backlash, encoder_reading
from posor_drivers.simulator.poses import Poses
from posor_drivers.simulator.randomness import Stream
from posor_drivers.simulator.true_beam import TrueBeam

if TYPE_CHECKING:
    from posor_estimator.core.chain import Chain
    from posor_estimator.core.types import FloatArray

    from posor_drivers.simulator.nominal import NominalArm
    from posor_drivers.simulator.scenario import Scenario


@dataclass(frozen=True)
class Cycle:
    """One cycle of a scenario, n ticks; j joints in order from the base, the stage in its middle.

    Attributes:
        commanded: Angles that the motors are told, and follow [rad], (n, j).
        encoder: What their encoders read [rad], (n, j).
        angles: How far the joints truly turn [rad], (n, j).
        T_parent_child: Of each POSOR.
        R_parent_base: Turns vectors of the base into the axes of the last receiving plate, (n, 3, 3).
        endpoint: In the base.
        target: Where the endpoint is commanded to be, in the base.
        by_encoders: Where it would be by what the encoders read, in the base.

    """

    commanded: FloatArray
    encoder: FloatArray
    angles: FloatArray
    T_parent_child: tuple[Poses, ...]
    R_parent_base: FloatArray
    endpoint: Poses
    target: Poses
    by_encoders: Poses


def true_cycle(
    scenario: Scenario,
    chain: Chain,
    arm: NominalArm,
    commanded: FloatArray,
    *,
    beam_errors: bool,
    sag: bool,
    inertia: bool = False,
) -> Cycle:
    """Return the truth over one cycle.

    Args:
        scenario: What is imperfect.
        chain: The arm as it is known.
        arm: Its nominal kinematics.
        commanded: Angles [rad], (n, j).
        beam_errors: Whether the measuring beams differ from what is known of them.
        sag: Whether they sag.
        inertia: Whether they sag otherwise while they accelerate.

    """
    files = [scenario.joints[name] for name in arm.joints]
    encoder, angles = commanded.copy(), commanded.copy()
    for column, file in enumerate(files):
        if file.encoder is not None:
            encoder[:, column] = encoder_reading(commanded[:, column], file.encoder.resolution.number)
        if file.gear is not None:
            angles[:, column] = after_backlash(commanded[:, column], file.gear.backlash.number)
    spans = [link.translation for link in arm.links[1:]]
    compliances = [
        Compliance.of(file.structure, float(np.linalg.norm(span))) for file, span in zip(files, spans, strict=True)
    ]
    bent = bends(arm.targets(angles), spans, compliances, scenario.payload.mass.number, chain.gravity)
    beams = [TrueBeam.of(link, scenario.seed, errors=beam_errors, sag=sag) for link in chain.links]
    forces = _specific_forces(chain, arm, commanded, scenario.ticks_per_second, inertia=inertia)
    base = Poses.repeated(pin.SE3.Identity(), len(commanded))
    structure = base @ arm.links[0]
    receiving = beams[0].plates(base, forces[0])[1]
    seen: list[Poses] = []
    for column, (name, file) in enumerate(zip(arm.joints, files, strict=True)):
        turned = structure
        if file.bearing is not None:
            turned = turned @ error_motions(
                file.bearing, angles[:, column], Stream(scenario.seed, "bearing", name).at()
            )
        turned = turned @ arm.origins[column] @ Poses.turns(2, angles[:, column])
        link = arm.links[column + 1]
        end = Poses.repeated(link, len(commanded)).moved(bent[column].translations, bent[column].rotations)
        structure = turned @ end
        line = turned @ _least_turns(link.translation, end.translations)
        target, next_receiving = beams[column + 1].plates(line, forces[column + 1])
        last_receiving = receiving
        seen.append(receiving.inverse() @ target)
        receiving = next_receiving
    return Cycle(
        commanded,
        encoder,
        angles,
        tuple(seen),
        np.swapaxes(last_receiving.rotations, 1, 2),
        receiving,
        arm.endpoint(commanded),
        arm.endpoint(encoder),
    )


def _specific_forces(
    chain: Chain, arm: NominalArm, commanded: FloatArray, rate: int, *, inertia: bool
) -> list[FloatArray]:
    """Return gravity less the acceleration of the middle of each link's beam [m/s^2], (n, 3) or (3,), in the base.

    The acceleration is that of the commanded motion, which repeats with the cycle: what backlash adds is left out.
    """
    forces: list[FloatArray] = [chain.gravity]
    for target, link in zip(arm.targets(commanded), chain.links[1:], strict=True):
        force = chain.gravity
        if inertia and link.beam is not None:
            centre = (target @ link.before @ pin.SE3(np.eye(3), 0.5 * link.beam.T_start_end.translation)).translations
            force = force - rate**2 * (np.roll(centre, -1, axis=0) - 2.0 * centre + np.roll(centre, 1, axis=0))
        forces.append(force)
    return forces


def _least_turns(before: FloatArray, after: FloatArray) -> Poses:
    """Return the least turns that bring the direction ``before`` (3,) onto the directions ``after`` (n, 3)."""
    length = float(np.linalg.norm(before))
    if length == 0.0:
        return Poses.motions(np.zeros(after.shape), np.zeros(after.shape))
    cross = np.cross(before / length, after / np.linalg.norm(after, axis=1, keepdims=True))
    sine = np.linalg.norm(cross, axis=1, keepdims=True)
    scale = np.divide(np.arcsin(sine), sine, out=np.ones(sine.shape), where=sine > 0.0)
    return Poses.motions(np.zeros(after.shape), scale * cross)


def check_serial(chain: Chain, source: str) -> None:
    """Refuse an arm that is not one row of joints.

    Raises:
        ChainError: A joint is not between base and endpoint.

    """
    between = len(chain.links) - 1
    if between != len(chain.joints):
        what = f"{len(chain.joints)} POSOR joints, of which {between} move the endpoint"
        raise ChainError(what, where=source, expected="one row of joints from the base to the endpoint")
