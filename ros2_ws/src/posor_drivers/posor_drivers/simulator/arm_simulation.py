"""Simulation of an arm: true poses and raw scans at any tick, for nodes, bags and accuracy runs.

Equal files and seeds give equal numbers in every process, for any ticks in any order.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import CalibrationError, ChainError

from posor_drivers.simulator.arm_truth import ArmTruth, true_cycle
from posor_drivers.simulator.electronics import JointElectronics
from posor_drivers.simulator.faults import JointFaults
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.nominal_arm import NominalArm
from posor_drivers.simulator.scenario import load_scenario

if TYPE_CHECKING:
    from posor.chain.arm_file import ArmFile
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray, IntArray

    from posor_drivers.simulator.simulated_scans import SimulatedScans


class ArmSimulation:
    """One arm in one scenario.

    Attributes:
        arm: The arm file.
        chain: Kinematics of the arm as its files describe it.
        scenario: Motion and imperfections.
        joints: Names, from the base.
        calibrations: Calibration of each POSOR, by joint.

    """

    def __init__(self, arm: ArmFile, imperfections: Imperfections | None = None, rate: int = 0) -> None:
        """Read the arm's files and compute one cycle.

        Args:
            arm: The arm file.
            imperfections: Which imperfections are simulated; None: all.
            rate: Ticks per second; 0: those of the scenario.

        Raises:
            ChainError: The URDF or the beams file is invalid.
            CalibrationError: A file is invalid, the scenario does not fit the arm, or the arm cannot follow it.
            ParameterError: The rate does not fit the scenario.

        """
        if arm.scenario is None:
            raise CalibrationError("key 'scenario' is missing", where=str(arm.path), expected="a scenario file")
        self.arm = arm
        self.chain = arm.chain()
        moving = len(self.chain.links) - 1
        if moving != len(self.chain.joints):
            what = f"{len(self.chain.joints)} POSOR joints, of which {moving} move the endpoint"
            raise ChainError(what, where=str(arm.urdf), expected="one row of joints from the base to the endpoint")
        scenario = load_scenario(arm.scenario)
        self.scenario = scenario.at_rate(rate) if rate else scenario
        source = str(arm.scenario)
        nominal = NominalArm(self.chain)
        self.joints = nominal.joints
        if set(self.scenario.joints) != set(self.joints):
            found = ", ".join(self.scenario.joints)
            raise CalibrationError(f"joints {found}", where=f"{source}, key joints", expected=", ".join(self.joints))
        imperfections = imperfections or Imperfections()
        self._cycle = true_cycle(
            self.scenario,
            self.chain,
            nominal,
            self.scenario.commanded_angles(nominal, source),
            beam_errors=imperfections.beam_errors,
            sag=imperfections.sag,
            inertia=imperfections.inertia,
        )
        self.calibrations = {joint: arm.calibration(joint) for joint in self.joints}
        self._electronics = {
            joint: JointElectronics(self.scenario, joint, calibration, imperfections, source)
            for joint, calibration in self.calibrations.items()
        }
        placed = [(f"{source}, key faults[{i}]", fault) for i, fault in enumerate(self.scenario.faults)]
        self._faults = {
            joint: JointFaults(
                [(where, fault) for where, fault in placed if fault.joint == joint],
                calibration,
                self.scenario.ticks_per_second,
                self.scenario.seed,
            )
            for joint, calibration in self.calibrations.items()
        }
        for joint, electronics in self._electronics.items():
            home = electronics.home
            if home is not None and not electronics.is_at_home(self._cycle.T_parent_child[joint].rotations).any():
                raise CalibrationError(
                    f"joint '{joint}' never passes the home mark of its ring, so its theta cannot be counted",
                    where=f"{source}, key motion",
                    expected=f"a motion through theta = {home:g} rad",
                )

    def truth(self, ticks: IntArray, stage: FloatArray | None = None) -> ArmTruth:
        """Return the truth at ticks (n,), with the stage at positions (n, 3) [m], axes of the endpoint; None: zero."""
        truth = self._cycle.select(np.mod(ticks, self.scenario.cycle_ticks))
        return truth if stage is None else truth.with_stage(stage)

    def latency_ns(self, joint: str, tick: int) -> int:
        """Return the delay from the stamp of a joint's scan to its publication [ns]."""
        latency_ns = self._electronics[joint].latency_ns(tick)
        return latency_ns + self._faults[joint].delay_ns(tick, self.scenario.cycle_ticks)

    def scans(self, joint: str, ticks: IntArray, truth: ArmTruth | None = None) -> SimulatedScans:
        """Return the scans of a joint at ticks (n,); ``truth`` at the same ticks is needed where the stage moves."""
        truth = self.truth(ticks) if truth is None else truth
        published = self._electronics[joint].scans(ticks, truth.T_parent_child[joint])
        return self._faults[joint].change(published, ticks, self.scenario.cycle_ticks, partial(self._scan_at, joint))

    def _scan_at(self, joint: str, tick: int) -> Scans:
        """Return the scan of a joint at one tick, without the faults of the scenario."""
        ticks = np.array([tick])
        return self._electronics[joint].scans(ticks, self.truth(ticks).T_parent_child[joint]).scans
