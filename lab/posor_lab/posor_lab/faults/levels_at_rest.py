# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Protection levels of an arm at rest whose temperatures are known, over the postures of its scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.calibration.causes import DEFAULT_CAUSES
from posor.chain.arm_file import load_arm_file
from posor.chain.beams_file import BeamsFile, load_beams
from posor.chain.kinematic_chain import Chain
from posor.uncertainty.protection_level import arm_reliability
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

POSTURES = 40  # evenly spread over the scenario
DEVIATION_K = 0.2  # largest deviation of beams, and largest error of the thermometers of the joints
TWO_DIODES = "six_axis with two of its three diodes"
AIMS = {"six_axis": (100e-6, 130e-6), TWO_DIODES: (200e-6, 200e-6), "five_axis_checked": (80e-6, 100e-6)}
"""Largest levels along [m] and about [rad] an axis that are aimed at."""


class RestingArm(NamedTuple):
    """Levels of an arm at rest along and about X, Y, Z of the base [m], [rad]."""

    arm: str
    worst: FloatArray  # of the postures, (6,)
    median: FloatArray  # (6,)

    @property
    def holds(self) -> bool:
        """Whether the arm reaches its aim in every posture."""
        along, about = AIMS[self.arm]
        return bool(self.worst[:3].max() <= along and self.worst[3:].max() <= about)

    def describe(self, levels: FloatArray) -> str:
        """Return levels in micrometres and microradians."""
        along, about = np.split(np.ceil(1e6 * levels).astype(int), 2)
        return f"{along[0]}, {along[1]}, {along[2]} um; {about[0]}, {about[1]}, {about[2]} urad"


def levels_at_rest(name: str, postures: int = POSTURES) -> RestingArm:
    """Return the levels of an arm of ``AIMS`` with beams and thermometers within ``DEVIATION_K``, without encoders."""
    arm = load_arm_file("six_axis" if name == TWO_DIODES else name)
    content = load_beams(arm.beams).model_dump(mode="json") if arm.beams else {}
    for beam in content["beams"]:
        if beam["temperature"]:
            beam["temperature"]["deviation"]["value"] = DEVIATION_K
    chain = Chain(arm.urdf.read_text(encoding="utf-8"), arm.endpoint_frame, BeamsFile.model_validate(content))
    calibrations = {joint.name: _with_thermometer(arm.calibration(joint.name)) for joint in chain.joints}
    if name == TWO_DIODES:
        calibrations = {joint: _with_two_diodes(each) for joint, each in calibrations.items()}
    simulation = ArmSimulation(arm, Imperfections.only())
    commanded = simulation.truth((np.arange(postures) * simulation.scenario.cycle_ticks) // postures).commanded
    angles = [dict(zip(calibrations, row, strict=True)) for row in commanded.tolist()]
    levels = np.array([arm_reliability(chain, calibrations, each).protection_level for each in angles])
    return RestingArm(name, levels.max(axis=0), np.median(levels, axis=0))


def _with_thermometer(calibration: Calibration) -> Calibration:
    """Return the calibration of a joint whose temperature is measured so well."""
    (default,) = [cause for cause in DEFAULT_CAUSES if cause.moves == "temperature channel"]
    own = [cause for cause in calibration.causes if cause.name != default.name]
    known = default.model_copy(update={"bound": DEVIATION_K, "source": "a thermometer"})
    return calibration.model_copy(update={"causes": [*own, known]})


def _with_two_diodes(calibration: Calibration) -> Calibration:
    """Return the calibration of a joint without its third diode."""
    content = calibration.model_dump(mode="json", exclude_none=True)
    (ring,) = [each for each in content["sensors"] if each["type"] == "diodes"]
    ring["diodes"] = ring["diodes"][:2]
    ring["maps"] = {name: maps[:2] for name, maps in ring["maps"].items()}
    return calibration.model_validate(content)
