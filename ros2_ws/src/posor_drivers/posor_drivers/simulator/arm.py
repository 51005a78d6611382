"""A simulated arm: truth and scans at any tick, for nodes, bags and accuracy runs alike.

The same files and the same seed give the same numbers in every process, whatever ticks it asks for and in which order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.errors import CalibrationError

from posor_drivers.simulator.electronics import Electronics
from posor_drivers.simulator.nominal import NominalArm
from posor_drivers.simulator.poses import Poses
from posor_drivers.simulator.scenario import load_scenario
from posor_drivers.simulator.structure import check_serial, true_cycle
from posor_drivers.simulator.switches import Switches
from posor_drivers.simulator.trajectory import commanded_angles

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.arm import Arm
    from posor_estimator.core.types import FloatArray, IntArray

    from posor_drivers.simulator.electronics import SimulatedScans


@dataclass(frozen=True)
class ArmTruth:
    """The truth at n ticks; j joints in order from the base.

    Attributes:
        joints: Names.
        commanded: Angles that the motors are told, and follow [rad], (n, j).
        encoder: What their encoders read [rad], (n, j).
        angles: How far the joints truly turn [rad], (n, j).
        T_parent_child: Of each POSOR, by joint.
        endpoint: In the base.
        target: Where the endpoint is commanded to be, in the base.
        by_encoders: Where it would be by what the encoders read: nominal kinematics, in the base.
        stage: Position of the stage, axes of the endpoint [m], (n, 3).

    """

    joints: tuple[str, ...]
    commanded: FloatArray
    encoder: FloatArray
    angles: FloatArray
    T_parent_child: Mapping[str, Poses]
    endpoint: Poses
    target: Poses
    by_encoders: Poses
    stage: FloatArray


class ArmSimulation:
    """One arm in one scenario.

    Attributes:
        arm: The arm file.
        chain: The arm's kinematics, as it is known.
        scenario: What it does and what is imperfect.
        joints: Names, from the base.

    """

    def __init__(self, arm: Arm, switches: Switches | None = None) -> None:
        """Read the arm's files and work out one cycle.

        Args:
            arm: The arm file.
            switches: What is simulated; None: everything.

        Raises:
            ChainError: The URDF or the beams cannot be used.
            CalibrationError: A file cannot be read, the scenario does not fit the arm, or the arm cannot follow it.

        """
        if arm.scenario is None:
            raise CalibrationError("key 'scenario' is missing", where=str(arm.path), expected="a scenario file")
        self.arm = arm
        self.chain = arm.chain()
        check_serial(self.chain, str(arm.urdf))
        self.scenario = load_scenario(arm.scenario)
        source = str(arm.scenario)
        nominal = NominalArm(self.chain)
        self.joints = nominal.joints
        if set(self.scenario.joints) != set(self.joints):
            named = ", ".join(self.scenario.joints)
            raise CalibrationError(f"joints {named}", where=f"{source}, key joints", expected=", ".join(self.joints))
        switches = switches or Switches()
        commanded = commanded_angles(self.scenario, nominal, source)
        self._cycle = true_cycle(
            self.scenario,
            self.chain,
            nominal,
            commanded,
            beam_errors=switches.beam_errors,
            sag=switches.sag,
            inertia=switches.inertia,
        )
        self.calibrations = {joint: arm.calibration(joint) for joint in self.joints}
        self._electronics = {
            joint: Electronics(self.scenario, joint, self.calibrations[joint], switches, source)
            for joint in self.joints
        }
        for joint, seen in zip(self.joints, self._cycle.T_parent_child, strict=True):
            electronics = self._electronics[joint]
            home = electronics.home
            if home is not None and not electronics.at_home(seen.rotations).any():
                raise CalibrationError(
                    f"joint '{joint}' never passes the home mark of its ring, so that its theta cannot be counted",
                    where=f"{source}, key motion",
                    expected=f"a motion through theta = {home:g} rad",
                )

    def truth(self, ticks: IntArray, stage: FloatArray | None = None) -> ArmTruth:
        """Return the truth at ticks (n,), with the stage at positions (n, 3) [m], axes of the endpoint; None: zero."""
        at = np.mod(ticks, self.scenario.cycle_ticks)
        cycle = self._cycle
        endpoint = cycle.endpoint.at(at)
        seen = {joint: poses.at(at) for joint, poses in zip(self.joints, cycle.T_parent_child, strict=True)}
        if stage is None:
            stage = np.zeros((len(ticks), 3))
        else:
            # It moves the last measuring beam as a whole: the last target plate and the endpoint alike.
            shift = endpoint.turned(stage)
            endpoint = Poses(endpoint.rotations, endpoint.translations + shift)
            last = seen[self.joints[-1]]
            in_parent = np.einsum("nij,nj->ni", cycle.R_parent_base[at], shift)
            seen[self.joints[-1]] = Poses(last.rotations, last.translations + in_parent)
        return ArmTruth(
            self.joints,
            cycle.commanded[at],
            cycle.encoder[at],
            cycle.angles[at],
            seen,
            endpoint,
            cycle.target.at(at),
            cycle.by_encoders.at(at),
            stage,
        )

    def latency_ns(self, joint: str, tick: int) -> int:
        """Return how long after its stamp a joint's scan of a tick is published [ns]."""
        return self._electronics[joint].latency_ns(tick)

    def scans(self, joint: str, ticks: IntArray, truth: ArmTruth | None = None) -> SimulatedScans:
        """Return the scans of a joint at ticks (n,); ``truth`` is that of the same ticks, where the stage matters."""
        if truth is None:
            truth = self.truth(ticks)
        return self._electronics[joint].scans(ticks, truth.T_parent_child[joint])
