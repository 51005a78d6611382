# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulation of an arm: true poses and raw scans at any tick, for nodes, bags and accuracy runs.

Equal files and seeds give equal numbers in every process, for any ticks in any order.
"""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import CalibrationError, ChainError

from posor_drivers.simulator.arm_truth import true_cycle
from posor_drivers.simulator.beam_heat import beam_heats
from posor_drivers.simulator.electronics import JointElectronics
from posor_drivers.simulator.faults import JointFaults
from posor_drivers.simulator.imperfections import Imperfections
from posor_drivers.simulator.link_vibration import BeamAccelerometers
from posor_drivers.simulator.nominal_arm import NominalArm
from posor_drivers.simulator.pose_array import poses_between
from posor_drivers.simulator.scenario import load_scenario
from posor_drivers.simulator.truth_model import load_truth

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from posor.chain.arm_file import ArmFile
    from posor.chain.beam_entries import AccelerometersFile, BeamThermometerFile
    from posor.numerics.array_types import FloatArray, IntArray

    from posor_drivers.simulator.faults import SimulatedFault
    from posor_drivers.simulator.pose_array import ArmTruth, PoseArray
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

    def __init__(
        self, arm: ArmFile, imperfections: Imperfections | None = None, rate: int = 0, truth: str = ""
    ) -> None:
        """Read the arm's files and compute one cycle.

        Without ``imperfections`` all are simulated. ``rate`` is in ticks per second; 0: those of the scenario.
        ``truth`` names the model of the readings, see ``truth_model``; empty: that of the scenario.

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
        scenario, source = load_scenario(arm.scenario), str(arm.scenario)
        self.scenario = scenario.at_rate(rate) if rate else scenario
        self._cycle_ticks = self.scenario.cycle_ticks
        model = load_truth(truth or scenario.truth, arm.path, "parameter truth" if truth else f"{source}, key truth")
        nominal = NominalArm(self.chain, model)
        self.joints = nominal.joints
        if set(self.scenario.joints) != set(self.joints):
            found = ", ".join(self.scenario.joints)
            raise CalibrationError(f"joints {found}", where=f"{source}, key joints", expected=", ".join(self.joints))
        imperfections = imperfections or Imperfections()
        commanded = self.scenario.commanded_angles(nominal, source)
        shares = np.arange(self._cycle_ticks) / self._cycle_ticks
        self._heats = beam_heats(self.scenario, self.chain, shares, imperfections, source)
        self._cycle = true_cycle(self.scenario, self.chain, nominal, commanded, imperfections, model, self._heats)
        forces = self._cycle.specific_forces
        self._accelerometers = BeamAccelerometers(self.chain.beams, forces, self.scenario.seed)
        self.calibrations = {joint: arm.calibration(joint) for joint in self.joints}
        self._electronics = {
            joint: JointElectronics(self.scenario, joint, calibration, imperfections, source, model)
            for joint, calibration in self.calibrations.items()
        }
        self._faults = self._place_faults(self.scenario.faults, source)
        for joint, electronics in self._electronics.items():
            home = electronics.home
            if home is not None and not electronics.is_at_home(self._cycle.T_parent_child[joint].rotations).any():
                what = f"joint '{joint}' never passes the home mark of its ring, so its theta cannot be counted"
                expected = f"a motion through theta = {home:g} rad"
                raise CalibrationError(what, where=f"{source}, key motion", expected=expected)

    def start_at(self, joint: str, tick: int) -> None:
        """Make a tick that of the first scan of a joint's driver, which is dark where the joint has dark scans."""
        self._electronics[joint].first_tick = tick

    def with_faults(self, faults: Sequence[SimulatedFault]) -> ArmSimulation:
        """Return the same arm with other faults.

        Raises CalibrationError: a fault names a joint or channel that the arm does not have.
        """
        other = copy(self)
        other._faults = self._place_faults(faults, "with_faults")  # noqa: SLF001  of the same class
        return other

    def _place_faults(self, faults: Sequence[SimulatedFault], source: str) -> dict[str, JointFaults]:
        placed: dict[str, list[tuple[str, SimulatedFault]]] = {}
        for i, fault in enumerate(faults):
            placed.setdefault(fault.joint, []).append((f"{source}, key faults[{i}]", fault))
        return {
            joint: JointFaults(
                own,
                self.calibrations[joint],
                seed=self.scenario.seed,
                rate=self.scenario.ticks_per_second,
                cycle_ticks=self._cycle_ticks,
            )
            for joint, own in placed.items()
        }

    def truth(self, ticks: IntArray, stage: FloatArray | None = None) -> ArmTruth:
        """Return the truth at ticks (n,), with the stage at positions (n, 3) [m], axes of the endpoint; None: zero."""
        truth = self._cycle.select(np.mod(ticks, self._cycle_ticks))
        return truth if stage is None else truth.with_stage(stage)

    @property
    def thermometers(self) -> Mapping[str, BeamThermometerFile]:
        """The thermometers of the beams, by beam."""
        found = {beam.name: beam.entry.thermometer for beam in self.chain.beams}
        return {name: entry for name, entry in found.items() if entry is not None}

    def temperatures(self, tick: int) -> dict[str, float]:
        """Return the readings [K] that the thermometers of beams publish at a tick, by beam; empty: none is due."""
        if tick % max(1, round(self.scenario.thermometer_period.number * self.scenario.ticks_per_second)):
            return {}
        place = tick % self._cycle_ticks
        changes = {name: float(heat.readings[place]) for name, heat in self._heats.items()}
        return {name: each.reference.number + changes.get(name, 0.0) for name, each in self.thermometers.items()}

    @property
    def accelerometers(self) -> Mapping[str, AccelerometersFile]:
        """The accelerometers of the beams, by name."""
        stated = [beam.entry.vibration.accelerometers for beam in self.chain.beams if beam.entry.vibration is not None]
        return {name: entry for entry in stated for name in entry.names}

    def accelerations(self, tick: int) -> dict[str, FloatArray]:
        """Return the readings [m/s^2] that the accelerometers of beams publish at a tick, by name, (3,)."""
        return self._accelerometers.readings(tick)

    def latency_ns(self, joint: str, tick: int) -> int:
        """Return the delay from the stamp of a joint's scan to its publication [ns]."""
        latency_ns, faults = self._electronics[joint].latency_ns(tick), self._faults.get(joint)
        return latency_ns if faults is None else latency_ns + faults.delay_ns(tick)

    def scans(self, joint: str, ticks: IntArray, truth: ArmTruth | None = None) -> SimulatedScans:
        """Return the scans of a joint at ticks (n,); ``truth`` at the same ticks is needed where the stage moves."""
        truth = self.truth(ticks) if truth is None else truth
        sound = JointScans(self._electronics[joint], self._cycle.T_parent_child[joint], self.scenario.ticks_per_second)
        published = sound.scans_at(ticks, truth.T_parent_child[joint])
        faults = self._faults.get(joint)
        return published if faults is None else faults.change(published, ticks, sound)


class JointScans:
    """Scans of a joint without the faults of the scenario: ``SoundScans``."""

    def __init__(self, electronics: JointElectronics, cycle: PoseArray, rate: int) -> None:
        """Read poses of the target plate in a cycle, at ticks of a rate [Hz]."""
        self._electronics, self._cycle, self._rate = electronics, cycle, rate

    def scans_at(self, ticks: IntArray, poses: PoseArray | None = None) -> SimulatedScans:
        """Return the scans at ticks, (n,); ``poses``: of the target plate there, if the stage moves it."""
        return self._electronics.scans(ticks, self._poses_at(ticks, poses))

    def exposure_changes(self, ticks: IntArray, interval_s: float) -> dict[str, FloatArray]:
        """Return what multiplexing at an interval [s] changes in the readings at ticks, (n,), by field."""
        return self._electronics.exposure_changes(ticks, self._poses_at(ticks), interval_s)

    def exposure_offsets(self, interval_s: float) -> FloatArray:
        """Return the offset of each channel from the stamp, multiplexed at an interval [s], (c,)."""
        return self._electronics.exposure_offsets(interval_s)

    def _poses_at(self, ticks: IntArray, poses: PoseArray | None = None) -> Callable[[float], PoseArray]:
        """Return a function that returns the poses at a time after ticks [s]."""
        around = [self._cycle.select(np.mod(ticks + n, len(self._cycle))) for n in (-1, 0, 1)]
        present = around[1] if poses is None else poses
        return lambda after_s: poses_between(present, around, self._rate * after_s) if after_s else present
