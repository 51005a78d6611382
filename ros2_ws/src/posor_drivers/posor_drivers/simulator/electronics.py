"""From where the target plate truly is to what the electronics of a POSOR sends."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.core.forward import scans_at
from posor_estimator.core.sensors.base import RowSensor
from posor_estimator.core.sensors.bumpy_ring import BumpyRingCalibration
from posor_estimator.core.sensors.diodes import DiodesCalibration
from posor_estimator.core.sensors.gap_probes import GapProbesCalibration
from posor_estimator.core.stack import Stack
from posor_estimator.errors import CalibrationError

from posor_drivers.simulator.converter import converted
from posor_drivers.simulator.randomness import Stream
from posor_drivers.simulator.ticks import NS, stamps_of

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.types import FloatArray, IntArray

    from posor_drivers.simulator.electronics_file import Contamination
    from posor_drivers.simulator.poses import Poses
    from posor_drivers.simulator.scenario import Scenario
    from posor_drivers.simulator.switches import Switches

STATUS_SATURATED = 16
STATUS_SIMULATED = 64
STATUS_HOME_BUMP = 128
"""Flags of ``posor_msgs/RawScan``; this package's core imports no ROS, a test compares them."""

HOME_MARK = 0.25
"""Half the width of the home mark, in bumps: well within the half bump in which it is unambiguous."""
VOLTAGES = ("gap_voltages", "ring_voltages")


@dataclass(frozen=True)
class SimulatedScans:
    """n scans of one joint, as the electronics gives them.

    Attributes:
        scans: Raw readings.
        statuses: Flags of ``posor_msgs/RawScan.status``, (n,).
        sent: Whether the scan is sent at all, (n,).
        latencies_ns: From the stamp to the publication [ns], (n,).

    """

    scans: Scans
    statuses: IntArray
    sent: NDArray[np.bool_]
    latencies_ns: IntArray


class Electronics:
    """Sensors and electronics of one joint. A scan depends on its tick and on the pose, on nothing before it."""

    def __init__(
        self, scenario: Scenario, joint: str, calibration: Calibration, switches: Switches, source: str
    ) -> None:
        """Draw what is drawn once.

        Args:
            scenario: What is imperfect.
            joint: Name of the joint.
            calibration: What is known of its POSOR.
            switches: What is simulated.
            source: What to call the scenario in complaints.

        Raises:
            CalibrationError: A sensor cannot be simulated, or the scenario names a channel that is not there.

        """
        self._rate, self._cycle = scenario.ticks_per_second, scenario.cycle_ticks
        self._said, self._switches = scenario.electronics, switches
        known = Stack([sensor.build() for sensor in calibration.sensors])
        self._sensors: list[RowSensor] = []
        self._stack = known
        if switches.calibration_errors:
            random = Stream(scenario.seed, "calibration", joint).at()
            errors = known.parameter_sigmas * random.normal(size=known.parameters)
            self._stack = known.with_parameter_values(known.parameter_values + errors)
        for sensor in self._stack.sensors:
            if not isinstance(sensor, RowSensor):
                what = f"a sensor of type {type(sensor).__name__} cannot be simulated"
                raise CalibrationError(what, where=f"calibration '{calibration.name}'", expected="sensors with rows")
            self._sensors.append(sensor)
        self._readings = Stream(scenario.seed, "readings", joint)
        phases = Stream(scenario.seed, "zero drift", joint).at().uniform(0.0, 2.0 * np.pi, size=(len(VOLTAGES), 16))
        self._drift_phases = dict(zip(VOLTAGES, phases, strict=True))
        self._dirt = [
            (dirt, *_channel(calibration, dirt, f"{source}, key electronics.contamination[{index}]"))
            for index, dirt in enumerate(scenario.electronics.contamination)
            if dirt.joint == joint
        ]
        counted = [(sensor.bump_angle, sensor.home_theta) for sensor in calibration.sensors if sensor.bump_angle > 0.0]
        self._home = counted[0] if counted else None

    def at_home(self, rotations: FloatArray) -> NDArray[np.bool_]:
        """Return whether the ring's home mark is seen at rotations (n, 3, 3); never where nothing is counted."""
        if self._home is None:
            return np.zeros(len(rotations), dtype=bool)
        bump, home = self._home
        theta = np.arctan2(-rotations[:, 0, 1], rotations[:, 1, 1])
        away = np.mod(theta - home + np.pi, 2.0 * np.pi) - np.pi
        return np.asarray(np.abs(away) < HOME_MARK * bump)

    @property
    def home(self) -> float | None:
        """Theta at the ring's home mark [rad]; None where nothing is counted."""
        return None if self._home is None else self._home[1]

    def latency_ns(self, tick: int) -> int:
        """Return how long after its stamp the scan of a tick is published [ns]."""
        return int(self._latencies(self._readings.at(tick).uniform(size=2)[1:])[0])

    def scans(self, ticks: IntArray, poses: Poses) -> SimulatedScans:
        """Return the scans of ticks (n,) at which the target plate is at poses ``T_parent_child``."""
        count = len(ticks)
        stamps = stamps_of(ticks, self._rate)
        supply = self._supply(ticks)
        scans = scans_at(
            self._stack,
            np.ascontiguousarray(poses.rotations),
            np.ascontiguousarray(poses.translations),
            stamps,
            supply_voltages=supply,
        )
        missing = {name: np.isnan(getattr(scans, name)) for name in (*VOLTAGES, "diode_currents")}
        home = self.at_home(poses.rotations)
        scans = replace(scans, numbers=ticks.astype(np.uint64), at_home=home.astype(np.int64))
        scans, chances = self._disturbed(scans, ticks)
        scans = self._drifted(scans, ticks)
        scans = self._soiled(scans, ticks)
        scans, saturated = self._converted(scans, missing)
        if supply is not None and not self._reports_supply:
            scans = scans.with_fields({"supply_voltages": np.full(count, np.nan)})
        statuses = STATUS_SIMULATED | STATUS_SATURATED * saturated | STATUS_HOME_BUMP * home
        return SimulatedScans(scans, statuses, self._sent(chances[:, 0]), self._latencies(chances[:, 1]))

    @property
    def _reports_supply(self) -> bool:
        return self._said.supply is not None and self._said.supply.measured

    def _supply(self, ticks: IntArray) -> FloatArray | None:
        said = self._said.supply
        if said is None:
            return None
        amplitude = said.amplitude.number if self._switches.supply_drift else 0.0
        return np.asarray(said.mean.number + amplitude * np.sin(self._turns(ticks, said.period.number)))

    def _turns(self, ticks: IntArray, period: float) -> FloatArray:
        """Return the phase [rad] of something slow of this period [s] at ticks of the ROS clock."""
        return np.asarray(2.0 * np.pi * np.mod(ticks / self._rate, period) / period)

    def _disturbed(self, scans: Scans, ticks: IntArray) -> tuple[Scans, FloatArray]:
        """Return the scans with noise, and two even chances for each tick, (n, 2)."""
        chances = np.empty((len(ticks), 2))
        noisy: dict[str, list[FloatArray]] = {}
        for n, tick in enumerate(ticks.tolist()):
            random = self._readings.at(tick)
            chances[n] = random.uniform(size=2)
            if self._switches.noise:
                one = scans.part(n, n + 1)
                for sensor in self._sensors:
                    for name, values in sensor.disturbed(one, random).items():
                        noisy.setdefault(name, []).append(values)
        return scans.with_fields({name: np.concatenate(values) for name, values in noisy.items()}), chances

    def _drifted(self, scans: Scans, ticks: IntArray) -> Scans:
        said = self._said.zero_drift
        if said is None or not self._switches.zero_drift:
            return scans
        turns = self._turns(ticks, said.period.number)[:, None]
        drifted = {}
        for name, phases in self._drift_phases.items():
            volts = getattr(scans, name)
            drifted[name] = volts + said.amplitude.number * np.sin(turns + phases[: volts.shape[1]])
        return scans.with_fields(drifted)

    def _soiled(self, scans: Scans, ticks: IntArray) -> Scans:
        if not self._switches.contamination:
            return scans
        seconds = np.mod(ticks, self._cycle) / self._rate
        for dirt, name, place in self._dirt:
            dirty = (seconds >= dirt.begin.number) & (seconds < dirt.end.number)
            values = getattr(scans, name).copy()
            if dirt.contact is None:
                values[(dirty, *place)] += dirt.size.number
            else:
                values[(dirty, *place)] *= 1.0 + dirt.size.number
            scans = scans.with_fields({name: values})
        return scans

    def _converted(self, scans: Scans, missing: dict[str, NDArray[np.bool_]]) -> tuple[Scans, NDArray[np.bool_]]:
        """Return the scans as the converter gives them, and which of them have a channel at the end of its range.

        A probe whose target is beyond its calibrated range drives its channel to the upper end; a diode that the light
        misses gives no current.
        """
        said = self._said.converter
        saturated = np.zeros(len(scans), dtype=bool)
        out: dict[str, FloatArray] = {}
        for name, unknown in missing.items():
            limits = said.diodes.array if name == "diode_currents" else said.probes.array
            instead = 0.0 if name == "diode_currents" else limits[1]
            values = np.where(unknown, instead, getattr(scans, name))
            out[name], ended = converted(values, limits, said.bits, steps=self._switches.quantisation)
            saturated |= ended
        return scans.with_fields(out), saturated

    def _sent(self, chances: FloatArray) -> NDArray[np.bool_]:
        said = self._said.dropouts
        lost = 0.0 if said is None or not self._switches.dropouts else said.probability.number
        return np.asarray(chances >= lost)

    def _latencies(self, chances: FloatArray) -> IntArray:
        said = self._said.latency
        if said is None or not self._switches.latency:
            return np.zeros(len(chances), dtype=np.int64)
        seconds = said.mean.number + said.jitter.number * (2.0 * chances - 1.0)
        return np.round(seconds * NS).astype(np.int64)


def _channel(calibration: Calibration, dirt: Contamination, where: str) -> tuple[str, tuple[int, ...]]:
    """Return the field of ``Scans`` that a channel is in, and its place in it after the scan's index.

    Raises:
        CalibrationError: There is no such channel.

    """
    probes, diodes = {}, {}
    for sensor in calibration.sensors:
        if isinstance(sensor, GapProbesCalibration | BumpyRingCalibration):
            name = VOLTAGES[isinstance(sensor, BumpyRingCalibration)]
            probes.update({probe.name: (name, (index,)) for index, probe in enumerate(sensor.probes)})
        elif isinstance(sensor, DiodesCalibration):
            diodes.update({diode.name: index for index, diode in enumerate(sensor.diodes)})
    if dirt.contact is None and dirt.channel in probes:
        return probes[dirt.channel]
    if dirt.contact is not None and dirt.channel in diodes:
        return "diode_currents", (diodes[dirt.channel], "ABCD".index(dirt.contact))
    kind, known = ("probe", probes) if dirt.contact is None else ("diode", diodes)
    raise CalibrationError(
        f"joint '{dirt.joint}' has no {kind} '{dirt.channel}'",
        where=where,
        expected=f"one of {', '.join(known) or 'none, it has no such sensor'}",
    )
