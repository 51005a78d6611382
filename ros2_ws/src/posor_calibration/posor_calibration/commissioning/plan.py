# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The steps of the commissioning of an arm: each plug in turn, each joint through a range, the endpoint in postures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np
from numpy.polynomial import polynomial
from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray
    from posor.sensors.probe import ProbeCalibration

Action = Literal["rest", "lift", "cover", "sweep", "posture"]
ACTIONS: tuple[str, ...] = get_args(Action)


@dataclass(frozen=True)
class CommissioningSettings:
    """What is stated about the steps, and how well the arm is known to follow its nominal motion."""

    lift: float = 2e-4  # amount by which a probe is lifted, the thickness of a gauge [m]
    lift_sigma: float = 1e-6  # its standard uncertainty [m]
    sweep: float = math.radians(30.0)  # range of the motion of a joint [rad]
    position: float = 20e-6  # standard deviation of a joint from its nominal place [m]
    tilt: float = 1e-4  # of its axis from the nominal one [rad]; assumed, as the others
    runout: float = 6e-6  # of the change of the place within a sweep [m]
    wobble: float = 20e-6  # of the change of the tilt within a sweep [rad]
    encoder: float = 1e-4  # of the encoder from the joint, backlash included [rad]
    encoder_zero: float = 2e-3  # largest difference of the zeros of encoder and joint [rad]
    postures: int = 0  # number of postures in which a reference measures the endpoint; 0: no reference
    reference: float = 1e-5  # standard uncertainty of the reference along each axis [m]
    serial: str = ""  # serial number on the arm's plate; empty: not read


class Step(NamedTuple):
    """One step; the fields of ``posor_msgs/CommissioningStep``."""

    action: str
    joint: str = ""
    channel: str = ""
    size: float = 0.0
    size_uncertainty: float = 0.0

    @property
    def name(self) -> str:
        """Name in reports."""
        return f"{self.joint}: {' '.join(filter(None, (self.action, self.channel)))}".removeprefix(": ")

    @property
    def instruction(self) -> str:
        """What to do before the step begins."""
        match self.action:
            case "rest":
                return f"{self.joint}: bring the joint to its home mark and leave the arm at rest"
            case "lift":
                return f"{self.joint}: lift probe {self.channel} from its surface by {self.size * 1e3:g} mm"
            case "cover":
                return f"{self.joint}: cover diode {self.channel}, or the light source that it sees; nothing lifted"
            case "sweep":
                degrees = math.degrees(self.size)
                return f"{self.joint}: all as in operation, joint at home; in the step, move it through {degrees:g} deg"
        return "bring the arm to another posture, all joints moved, and leave it at rest"


def probes_of(calibration: Calibration) -> dict[str, tuple[str, int, ProbeCalibration]]:
    """Return each probe by name: field of ``Scans`` with its voltages, index there, calibration."""
    return {
        probe.name: (field, index, probe)
        for kind, field in ((GapProbesCalibration, "gap_voltages"), (BumpyRingCalibration, "ring_voltages"))
        for sensor in calibration.sensors
        if isinstance(sensor, kind)
        for index, probe in enumerate(sensor.probes)
    }


def diodes_of(calibration: Calibration) -> list[str]:
    """Return the names of the diodes."""
    diodes = [sensor for sensor in calibration.sensors if isinstance(sensor, DiodesCalibration)]
    return [diode.name for sensor in diodes for diode in sensor.diodes]


def probe_gaps(calibration: Calibration, scans: Scans) -> dict[str, FloatArray]:
    """Return what each probe reads, without its supply and temperature [m], (n,)."""
    return {
        name: np.asarray(
            polynomial.polyval(getattr(scans, field)[:, index] + probe.zero_shift.number, probe.volts_to_gap.array)
        )
        for name, (field, index, probe) in probes_of(calibration).items()
    }


def diode_sums(calibration: Calibration, scans: Scans) -> dict[str, FloatArray]:
    """Return the sum of the four currents of each diode [A], (n,)."""
    return {name: scans.diode_currents[:, i].sum(axis=1) for i, name in enumerate(diodes_of(calibration))}


def steps_of(calibrations: Mapping[str, Calibration], settings: CommissioningSettings) -> list[Step]:
    """Return the steps of an arm, joint after joint, then the postures."""
    steps: list[Step] = []
    for joint, calibration in calibrations.items():
        steps.append(Step("rest", joint))
        steps += [Step("lift", joint, name, settings.lift, settings.lift_sigma) for name in probes_of(calibration)]
        steps += [Step("cover", joint, name) for name in diodes_of(calibration)]
        steps.append(Step("sweep", joint, "", settings.sweep))
    return [*steps, *(Step("posture", "", f"{n + 1}") for n in range(settings.postures))]
