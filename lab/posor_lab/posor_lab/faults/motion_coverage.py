# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Coverage of the endpoint's protection level in fast motion, with all that is bounded at its stated bound at once.

An arm moves at up to 0.7 rad/s and rests in between. Each drawn arm differs from its files within their uncertainties
and obeys the independent truth. In addition, and in all scans alike: causes that are always there act with the size of
their bounds, the stamps of each joint are wrong by the stated limit, and each beam is longer or shorter by its largest
expansion. Signs are random.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from posor.bags.arm_estimator import EndpointPipeline
from posor.bags.recording import unpack_poses
from posor.chain.arm_file import CHAIN_NODE, chain_parameters
from posor.chain.beams_file import load_beams
from posor.estimation.posor import Posor
from posor.messages.joint_transform import TransformConstants
from posor.model.fault import USABLE_STATES
from posor.model.scan import NO_SOURCE
from posor.node_parameters import ChainParameters
from posor.parameter_model import validate_parameters
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.electronics import JointElectronics
from posor_drivers.simulator.pose_array import PoseArray, poses_between

from posor_lab.faults.cause_injection import inject
from posor_lab.faults.fault_table import IMPERFECTIONS, write_fault_arm
from posor_lab.faults.offline_time import RATE, RESTS, SWINGS
from posor_lab.faults.pose_judge import small_errors
from posor_lab.faults.storm_faults import RANGES
from posor_lab.independent.true_arm import TrueArm

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor.estimation.estimate import Estimates
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray

    from posor_lab.faults.fault_table import ArmName

LEAST = 0.999  # share of endpoints within their level
STAMP_LIMIT_S = 1e-4
CYCLE_S = 20  # of the motion of each drawn arm


@dataclass(frozen=True)
class LevelCoverage:
    """Figures of drawn arms in motion."""

    arm: str
    scans: int = 0
    usable: int = 0  # endpoints with a pose and a level; dark scans have no level
    covered: int = 0  # of these, within their level along and about all axes
    largest: float = 0.0  # largest error as a share of its level

    @property
    def share(self) -> float:
        """Share of the usable endpoints that are within their level."""
        return self.covered / self.usable if self.usable else 0.0

    def describe(self) -> str:
        """Return the figures as a phrase."""
        of_level = f"error at most {self.largest:.2f} of the level"
        return f"{self.usable} of {self.scans} scans with a pose and a level; {of_level}"


def motion_coverage(
    name: ArmName, scans: int, seed: int, folder: Path, on_drawn: Callable[[int], None], cycle_s: int = CYCLE_S
) -> LevelCoverage:
    """Return the figures of at least ``scans`` scans of drawn arms, whose seeds follow ``seed``.

    ``folder``: for the files of the arms; ``on_drawn`` is called with the number of scans of each.
    """
    total = LevelCoverage(name)
    while total.scans < scans:
        number = total.scans // (cycle_s * RATE)
        own = _MovingArm(name, folder / f"{name}_{number}", seed + number, cycle_s).coverage()
        total = LevelCoverage(
            name,
            total.scans + own.scans,
            total.usable + own.usable,
            total.covered + own.covered,
            max(total.largest, own.largest),
        )
        on_drawn(own.scans)
    return total


class _MovingArm:
    def __init__(self, name: ArmName, folder: Path, seed: int, cycle_s: int) -> None:
        amplitude, waypoint_s = SWINGS[name]
        self._name, self._random = name, np.random.default_rng(seed)
        arm = write_fault_arm(
            name, folder, cycle_s, seed, waypoint_s=waypoint_s, amplitude=amplitude, rests=RESTS, rate=RATE
        )
        self._simulation, self._model = ArmSimulation(arm, IMPERFECTIONS), TrueArm(arm.path)
        self._beams = load_beams(arm.beams) if arm.beams else None
        self._parameters = validate_parameters(ChainParameters, dict(chain_parameters(arm)), node=CHAIN_NODE)
        self._ticks = np.arange(cycle_s * RATE)

    def coverage(self) -> LevelCoverage:
        """Return the figures of one cycle."""
        posors = {joint: Posor(each) for joint, each in self._simulation.calibrations.items()}
        found = {joint: self._estimate(joint, posor) for joint, posor in posors.items()}
        constants = {joint: TransformConstants.of(posor) for joint, posor in posors.items()}
        orders = {joint: len(found) * np.arange(len(self._ticks)) + n for n, joint in enumerate(found)}
        ends = EndpointPipeline(self._simulation.chain, self._parameters, constants).estimate(found, orders)
        usable = np.all([np.isin(each.states, USABLE_STATES) for each in found.values()], axis=0)
        true = self._true_endpoints().select(usable)
        has_level = ~np.isnan(ends.protection_levels).any(axis=1)  # dark scans have none
        errors = np.abs(small_errors(PoseArray(*unpack_poses(ends.poses)), true))[has_level]
        shares = np.max(errors / ends.protection_levels[has_level], axis=1, initial=0.0)
        covered = int(np.count_nonzero(shares <= 1.0))
        return LevelCoverage(self._name, len(self._ticks), len(shares), covered, float(shares.max(initial=0.0)))

    def _sign(self) -> float:
        return float(self._random.choice([-1.0, 1.0]))

    def _estimate(self, joint: str, posor: Posor) -> Estimates:
        """Return the estimates of a joint whose stamps are wrong by the limit."""
        simulation, late_s = self._simulation, self._sign() * STAMP_LIMIT_S
        electronics = JointElectronics(
            simulation.scenario, joint, posor.calibration, IMPERFECTIONS, self._name, self._model
        )
        around = [simulation.truth(self._ticks + n).T_parent_child[joint] for n in (-1, 0, 1)]
        scans = electronics.scans(self._ticks, lambda _: poses_between(around[1], around, RATE * late_s)).scans
        scans = self._with_causes(posor, scans.with_fields({"stamp_limits": np.full(len(scans), STAMP_LIMIT_S)}))
        return posor.estimate_all(scans, fault_effects=True)

    def _with_causes(self, posor: Posor, scans: Scans) -> Scans:
        """Return scans with the causes that are always there; dark scans are as before."""
        is_lit = ~np.any(scans.lit_sources == NO_SOURCE, axis=1)
        for cause in posor.hypotheses.causes:
            if cause.kind == "always":
                lit = scans.select(is_lit)
                moved = inject(cause, np.full(len(lit), cause.limit), lit, posor.stack, self._random, alike=True)
                fields: dict[str, FloatArray] = {}
                for name in (*RANGES, "supply_voltages", "temperatures"):
                    fields[name] = getattr(scans, name).copy()
                    fields[name][is_lit] = getattr(moved, name)
                scans = scans.with_fields(fields)
        return scans

    def _true_endpoints(self) -> PoseArray:
        """Return the endpoints with beams that are longer or shorter by their largest expansion."""
        truth, model = self._simulation.truth(self._ticks), self._model
        seen = [truth.T_parent_child[joint] for joint in model.joints]
        poses = np.stack([each.rotations for each in seen], 1), np.stack([each.translations for each in seen], 1)
        expansions = [each.temperature for each in (self._beams.beams if self._beams else ()) if each.temperature]
        strain = min((each.coefficient.number * each.deviation.number for each in expansions), default=0.0)
        expanded = TrueArm(self._simulation.arm.path)
        expanded.links = tuple(
            replace(link, end=pin.SE3(link.end.rotation, (1.0 + self._sign() * strain) * link.end.translation))
            for link in model.links
        )
        shifts = expanded.endpoints(*poses)[1] - model.endpoints(*poses)[1]
        return PoseArray(truth.endpoint.rotations, truth.endpoint.translations + shifts)
