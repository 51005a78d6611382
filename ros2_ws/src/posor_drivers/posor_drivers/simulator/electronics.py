"""Sensors and electronics of one simulated joint: from the true pose of the target plate to a raw scan."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.errors import CalibrationError
from posor.estimation.forward import scans_at
from posor.estimation.sensor_stack import Stack
from posor.model.native_coordinates import thetas_of
from posor.model.scan import HOME_BUMP, SATURATED, SIMULATED
from posor.numerics.stamps import NS, tick_stamp_ns
from posor.numerics.vector import wrapped_angles
from posor.sensors.base import RowSensor

from posor_drivers.simulator.random_stream import RandomStream
from posor_drivers.simulator.simulated_scans import (
    DIODE_FIELD,
    PROBE_FIELDS,
    SimulatedScans,
    find_channel,
)

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

    from posor_drivers.simulator.imperfections import Imperfections
    from posor_drivers.simulator.pose_array import PoseArray
    from posor_drivers.simulator.scenario import Scenario

HOME_MARK = 0.25
"""Half the width of the home mark, in bumps; the mark is unambiguous within half a bump."""


class JointElectronics:
    """Sensors and electronics of one joint. A scan depends on its tick and pose only, not on earlier scans."""

    def __init__(
        self, scenario: Scenario, joint: str, calibration: Calibration, imperfections: Imperfections, source: str
    ) -> None:
        """Draw the errors that are constant in time.

        Args:
            scenario: Magnitudes of the imperfections.
            joint: Name of the joint.
            calibration: Calibration of its POSOR.
            imperfections: Which imperfections are simulated.
            source: Name of the scenario in error messages.

        Raises:
            CalibrationError: A sensor cannot be simulated, or the scenario names a channel that does not exist.

        """
        self._rate, self._cycle_ticks = scenario.ticks_per_second, scenario.cycle_ticks
        self._settings, self._imperfections = scenario.electronics, imperfections
        self._stack = Stack([sensor.build() for sensor in calibration.sensors])
        if imperfections.calibration_errors:
            random = RandomStream(scenario.seed, "calibration", joint).generator()
            errors = self._stack.parameter_sigmas * random.normal(size=self._stack.parameters)
            self._stack = self._stack.with_parameter_values(self._stack.parameter_values + errors)
        self._sensors: list[RowSensor] = []
        for sensor in self._stack.sensors:
            if not isinstance(sensor, RowSensor):
                what = f"a sensor of type {type(sensor).__name__} cannot be simulated"
                raise CalibrationError(what, where=f"calibration '{calibration.name}'", expected="sensors with rows")
            self._sensors.append(sensor)
        self._readings = RandomStream(scenario.seed, "readings", joint)
        random = RandomStream(scenario.seed, "zero drift", joint).generator()
        phases = random.uniform(0.0, 2.0 * np.pi, size=(len(PROBE_FIELDS), 16))
        self._drift_phases = dict(zip(PROBE_FIELDS, phases, strict=True))
        self._dirt = [
            (dirt, *find_channel(calibration, dirt, f"{source}, key electronics.contamination[{index}]"))
            for index, dirt in enumerate(scenario.electronics.contamination)
            if dirt.joint == joint
        ]
        counted = [sensor for sensor in calibration.sensors if sensor.bump_angle > 0.0]
        self._home = (counted[0].bump_angle, counted[0].home_theta) if counted else None

    @property
    def home(self) -> float | None:
        """Theta at the ring's home mark [rad]; None without a counted ring."""
        return None if self._home is None else self._home[1]

    def is_at_home(self, rotations: FloatArray) -> BoolArray:
        """Return whether the ring's home mark is seen at rotations (n, 3, 3); never without a counted ring."""
        if self._home is None:
            return np.zeros(len(rotations), dtype=bool)
        bump, home = self._home
        distance = wrapped_angles(thetas_of(rotations) - home)
        return np.asarray(np.abs(distance) < HOME_MARK * bump)

    def latency_ns(self, tick: int) -> int:
        """Return the delay from the stamp of a tick's scan to its publication [ns]."""
        return int(self._latencies_ns(self._readings.generator(tick).uniform(size=2)[1:])[0])

    def scans(self, ticks: IntArray, poses: PoseArray) -> SimulatedScans:
        """Return the scans at ticks (n,), with the target plate at poses ``T_parent_child``."""
        supply = self._supply_voltages(ticks)
        scans = scans_at(
            self._stack,
            np.ascontiguousarray(poses.rotations),
            np.ascontiguousarray(poses.translations),
            tick_stamp_ns(ticks, self._rate),
            supply_voltages=supply,
        )
        out_of_range = {name: np.isnan(getattr(scans, name)) for name in (*PROBE_FIELDS, DIODE_FIELD)}
        home = self.is_at_home(poses.rotations)
        scans = scans.with_fields({"numbers": ticks, "at_home": home.astype(np.int64)})
        scans, chances = self._add_noise(scans, ticks)
        scans = self._add_zero_drift(scans, ticks)
        scans = self._add_contamination(scans, ticks)
        scans, saturated = self._convert(scans, out_of_range)
        if supply is not None and not (self._settings.supply and self._settings.supply.measured):
            scans = scans.with_fields({"supply_voltages": np.full(len(ticks), np.nan)})
        statuses = SIMULATED | SATURATED * saturated | HOME_BUMP * home
        dropouts = self._settings.dropouts if self._imperfections.dropouts else None
        sent = np.asarray(chances[:, 0] >= (0.0 if dropouts is None else dropouts.probability.number))
        return SimulatedScans(scans, statuses, sent, self._latencies_ns(chances[:, 1]))

    def _supply_voltages(self, ticks: IntArray) -> FloatArray | None:
        supply = self._settings.supply
        if supply is None:
            return None
        amplitude = supply.amplitude.number if self._imperfections.supply_drift else 0.0
        return np.asarray(supply.mean.number + amplitude * np.sin(self._phases(ticks, supply.period.number)))

    def _phases(self, ticks: IntArray, period: float) -> FloatArray:
        """Return the phase [rad] at ticks of a slow sine with this period [s]."""
        return np.asarray(2.0 * np.pi * np.mod(ticks / self._rate, period) / period)

    def _add_noise(self, scans: Scans, ticks: IntArray) -> tuple[Scans, FloatArray]:
        """Return the scans with noise, and two uniform random numbers for each tick, (n, 2)."""
        chances = np.empty((len(ticks), 2))
        noisy: dict[str, list[FloatArray]] = {}
        for n, tick in enumerate(ticks.tolist()):
            random = self._readings.generator(tick)
            chances[n] = random.uniform(size=2)
            if self._imperfections.noise:
                scan = scans.part(n, n + 1)
                for sensor in self._sensors:
                    for name, values in sensor.disturbed(scan, random).items():
                        noisy.setdefault(name, []).append(values)
        return scans.with_fields({name: np.concatenate(values) for name, values in noisy.items()}), chances

    def _add_zero_drift(self, scans: Scans, ticks: IntArray) -> Scans:
        drift = self._settings.zero_drift
        if drift is None or not self._imperfections.zero_drift:
            return scans
        phase = self._phases(ticks, drift.period.number)[:, None]
        drifted = {}
        for name, offsets in self._drift_phases.items():
            volts = getattr(scans, name)
            drifted[name] = volts + drift.amplitude.number * np.sin(phase + offsets[: volts.shape[1]])
        return scans.with_fields(drifted)

    def _add_contamination(self, scans: Scans, ticks: IntArray) -> Scans:
        if not self._imperfections.contamination:
            return scans
        seconds = np.mod(ticks, self._cycle_ticks) / self._rate
        for dirt, name, channel in self._dirt:
            dirty = (seconds >= dirt.begin.number) & (seconds < dirt.end.number)
            values = getattr(scans, name).copy()
            if dirt.contact is None:
                values[(dirty, *channel)] += dirt.size.number
            else:
                values[(dirty, *channel)] *= 1.0 + dirt.size.number
            scans = scans.with_fields({name: values})
        return scans

    def _convert(self, scans: Scans, out_of_range: dict[str, BoolArray]) -> tuple[Scans, BoolArray]:
        """Return the scans after the converter, and which of them have a channel at the end of its range.

        A probe beyond its calibrated range drives its channel to the upper end; a diode that the light misses gives no
        current.
        """
        converter = self._settings.converter
        saturated = np.zeros(len(scans), dtype=bool)
        out: dict[str, FloatArray] = {}
        for name, invalid in out_of_range.items():
            limits = converter.diodes.array if name == DIODE_FIELD else converter.probes.array
            values = np.where(invalid, 0.0 if name == DIODE_FIELD else limits[1], getattr(scans, name))
            steps = self._imperfections.quantisation
            out[name], at_end = convert_to_digital(values, limits, converter.bits, steps=steps)
            saturated |= at_end
        return scans.with_fields(out), saturated

    def _latencies_ns(self, chances: FloatArray) -> IntArray:
        latency = self._settings.latency
        if latency is None or not self._imperfections.latency:
            return np.zeros(len(chances), dtype=np.int64)
        seconds = latency.mean.number + latency.jitter.number * (2.0 * chances - 1.0)
        return np.round(seconds * NS).astype(np.int64)


def convert_to_digital(
    values: FloatArray, limits: FloatArray, bits: int, *, steps: bool
) -> tuple[FloatArray, BoolArray]:
    """Return the values after an analogue-to-digital converter, and which scans have a channel at the end of its range.

    Code c of the ``2^bits`` codes means ``low + c (high - low) / 2^bits``.

    Args:
        values: (n, ...).
        limits: Low and high end of the range, (2,).
        bits: Of the converter.
        steps: Whether values are rounded to codes; the range is limited in any case.

    """
    low, high = limits
    step = (high - low) / 2**bits
    codes = (values - low) / step
    last = 2**bits - 1
    at_end = (codes <= 0.0) | (codes >= last)
    codes = np.clip(codes, 0.0, last)
    if steps:
        codes = np.round(codes)
    return low + step * codes, at_end.reshape(len(values), -1).any(axis=1)
