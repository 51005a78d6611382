# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sensors and electronics of one simulated joint: from the true pose of the target plate to a raw scan."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from posor.calibration.parameter_covariance import shared_effects
from posor.errors import CalibrationError
from posor.estimation.forward import empty_scans, scans_at
from posor.estimation.sensor_stack import Stack
from posor.model.scan import DARK_SUBTRACTED, HOME_BUMP, NO_SOURCE, SATURATED, SIMULATED
from posor.numerics.stamps import NS, tick_stamp_ns
from posor.numerics.vector import thetas_of, wrapped_angles
from posor.sensors.base import READING_KINDS, RowSensor
from posor.sensors.diodes import DiodesCalibration

from posor_drivers.simulator.imperfections import RandomStream, shared_errors
from posor_drivers.simulator.simulated_scans import (
    DIODE_FIELD,
    PROBE_FIELDS,
    SimulatedScans,
    find_channel,
    stated_exposures,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

    from posor_drivers.simulator.electronics_settings import ElectronicsSettings
    from posor_drivers.simulator.imperfections import Imperfections
    from posor_drivers.simulator.pose_array import PoseArray
    from posor_drivers.simulator.scenario import Scenario
    from posor_drivers.simulator.truth_model import TrueArm, TrueJoint

STAMP_ERROR = {"stamp_uncertainties": 1e-9 / math.sqrt(12.0), "stamp_limits": 0.5e-9}
"""Error of the stamps of the simulator, which are exact but for their steps of a nanosecond [s]."""
HOME_MARK = 0.25
"""Half the width of the home mark, in bumps; the mark is unambiguous within half a bump."""


class _Dirt(NamedTuple):
    """Contamination of a channel: a field of ``Scans`` and an index in a scan, times [s], and a shift or a share."""

    field: str
    channel: tuple[int, ...]
    begin_s: float
    end_s: float
    size: float
    is_shift: bool


class JointElectronics:
    """Sensors and electronics of one joint. A scan depends on its tick and pose only, not on earlier scans.

    Attributes:
        first_tick: Tick of the driver's first scan, which is dark where the joint has dark scans.

    """

    def __init__(
        self,
        scenario: Scenario,
        joint: str,
        calibration: Calibration,
        imperfections: Imperfections,
        source: str,
        truth: TrueArm | None = None,
    ) -> None:
        """Draw the errors that are constant in time.

        ``scenario`` holds the magnitudes of the imperfections; ``source`` is its name in error messages; ``truth``
        reads the sensors; None: the estimator's own model does.

        Raises:
            CalibrationError: A sensor cannot be simulated, or the scenario names a channel that does not exist.

        """
        self._rate, self._cycle_ticks = scenario.ticks_per_second, scenario.cycle_ticks
        self._steps, self._noise = imperfections.quantisation, imperfections.noise
        self._read_settings(scenario.electronics, imperfections)
        self._stack = Stack([sensor.build() for sensor in calibration.sensors])
        errors = np.zeros(self._stack.parameters)
        if imperfections.calibration_errors:
            random = RandomStream(scenario.seed, "calibration", joint).generator()
            errors = self._stack.parameter_sigmas * random.normal(size=self._stack.parameters)
            if calibration.shared:
                common = shared_effects(calibration, calibration.session)
                errors += common @ shared_errors(scenario.seed, calibration.shared)
            self._stack = self._stack.with_parameter_values(self._stack.parameter_values + errors)
        self._truth: TrueJoint | None = None
        if truth is not None:
            by_name = dict(zip(self._stack.parameter_names, errors.tolist(), strict=True))
            try:
                self._truth = truth.joint(joint, by_name)
            except ValueError as error:
                raise CalibrationError(f"{error}", where=f"calibration '{calibration.name}'") from error
        diodes = [sensor for sensor in calibration.sensors if isinstance(sensor, DiodesCalibration)]
        removal = diodes[0].ambient if diodes else None
        self._ambient = scenario.electronics.ambient if removal is not None and imperfections.ambient_light else None
        self._dark_noise = removal.noise.number if removal is not None and self._noise else 0.0
        self.first_tick = 0
        self._sensors: list[RowSensor] = []
        for sensor in self._stack.sensors:
            if not isinstance(sensor, RowSensor):
                what = f"a sensor of type {type(sensor).__name__} cannot be simulated"
                raise CalibrationError(what, where=f"calibration '{calibration.name}'", expected="sensors with rows")
            self._sensors.append(sensor)
        one = scans_at(self._stack, np.eye(3)[None], np.zeros((1, 3)), np.zeros(1, dtype=np.int64))
        self._channels = sum(getattr(one, name).size for name in READING_KINDS)
        self._readings = RandomStream(scenario.seed, "readings", joint)
        self._dark_readings = RandomStream(scenario.seed, "dark readings", joint)
        random = RandomStream(scenario.seed, "zero drift", joint).generator()
        phases = random.uniform(0.0, 2.0 * np.pi, size=(len(PROBE_FIELDS), 16))
        self._drift_phases = dict(zip(PROBE_FIELDS, phases, strict=True))
        dirt = [
            _Dirt(
                *find_channel(calibration, each, f"{source}, key electronics.contamination[{index}]"),
                begin_s=each.begin.number,
                end_s=each.end.number,
                size=each.size.number,
                is_shift=each.contact is None,
            )
            for index, each in enumerate(scenario.electronics.contamination)
            if each.joint == joint
        ]
        self._dirt = dirt if imperfections.contamination else []
        counted = [sensor for sensor in calibration.sensors if sensor.bump_angle > 0.0]
        self._home = (counted[0].bump_angle, counted[0].home_theta) if counted else None

    def _read_settings(self, settings: ElectronicsSettings, imperfections: Imperfections) -> None:
        """Take the numbers of what is simulated: amplitudes [V], periods [s], limits [V] or [A], times [s]."""
        converter, supply, self._bits = settings.converter, settings.supply, settings.converter.bits
        self._limits = dict.fromkeys(PROBE_FIELDS, converter.probes.array) | {DIODE_FIELD: converter.diodes.array}
        self._supply = None
        if supply is not None:
            amplitude = supply.amplitude.number if imperfections.supply_drift else 0.0
            self._supply = supply.mean.number, amplitude, supply.period.number
        self._hides_supply = supply is not None and not supply.measured
        drift = settings.zero_drift if imperfections.zero_drift else None
        self._drift = None if drift is None else (drift.amplitude.number, drift.period.number)
        dropouts = settings.dropouts if imperfections.dropouts else None
        self._lost_share = 0.0 if dropouts is None else dropouts.probability.number
        latency = settings.latency if imperfections.latency else None
        self._multiplexer = settings.multiplexer
        self._latency = (0.0, 0.0) if latency is None else (latency.mean.number, latency.jitter.number)

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

    def scans(self, ticks: IntArray, poses_at: Callable[[float], PoseArray]) -> SimulatedScans:
        """Return the scans at ticks (n,).

        ``poses_at`` returns the poses ``T_parent_child`` of the target plate at a time after the ticks [s].
        """
        poses = poses_at(0.0)
        supply = self._supply_voltages(ticks)
        scans = self._sound_scans(poses, tick_stamp_ns(ticks, self._rate), supply)
        out_of_range = {name: np.isnan(getattr(scans, name)) for name in (*PROBE_FIELDS, DIODE_FIELD)}
        home = self.is_at_home(poses.rotations)
        stated: dict[str, Any] = {"numbers": ticks, "at_home": home.astype(np.int64)}
        stated |= {name: np.full(len(ticks), value) for name, value in STAMP_ERROR.items()}
        if self._multiplexer is not None:
            changes = self.exposure_changes(ticks, poses_at, self._multiplexer.interval.number)
            stated |= {name: getattr(scans, name) + change for name, change in changes.items()}
            offsets_s = self.exposure_offsets(self._multiplexer.interval.number)
            stated |= stated_exposures(offsets_s, len(ticks), self._multiplexer.offsets)
        scans = scans.with_fields(stated)
        scans, chances = self._add_noise(scans, ticks)
        scans = self._add_ambient_light(scans, ticks)
        scans = self._add_contamination(self._add_zero_drift(scans, ticks), ticks)
        scans, saturated = self._convert(scans, out_of_range)
        if self._hides_supply:
            scans = scans.with_fields({"supply_voltages": np.full(len(ticks), np.nan)})
        statuses = SIMULATED | SATURATED * saturated | HOME_BUMP * home | (scans.statuses & DARK_SUBTRACTED)
        sent = np.asarray(chances[:, 0] >= self._lost_share)
        return SimulatedScans(scans, statuses, sent, self._latencies_ns(chances[:, 1]))

    def _sound_scans(self, poses: PoseArray, stamps_ns: IntArray, supply: FloatArray | None) -> Scans:
        """Return the scans of poses without noise."""
        rotations, translations = np.ascontiguousarray(poses.rotations), np.ascontiguousarray(poses.translations)
        if self._truth is None:
            return scans_at(self._stack, rotations, translations, stamps_ns, supply_voltages=supply)
        stated = {} if supply is None else {"supply_voltages": supply}
        return empty_scans(stamps_ns).with_fields(stated | self._truth.readings(rotations, translations, supply))

    def exposure_offsets(self, interval_s: float) -> FloatArray:
        """Return the offset of each channel from the stamp, read one after another at an interval [s], (c,)."""
        return np.asarray(interval_s * (np.arange(self._channels) - 0.5 * (self._channels - 1)))

    def exposure_changes(
        self, ticks: IntArray, poses_at: Callable[[float], PoseArray], interval_s: float
    ) -> dict[str, FloatArray]:
        """Return what each reading changes from the stamp to its exposure, by field, (n, ...).

        ``poses_at`` returns the poses at a time after the ticks [s]. Where the lit source changes meanwhile, and where
        a reading is out of range, it is zero.
        """
        stamps_ns, supply = tick_stamp_ns(ticks, self._rate), self._supply_voltages(ticks)
        offsets_s = iter(self.exposure_offsets(interval_s).tolist())
        present = self._sound_scans(poses_at(0.0), stamps_ns, supply)
        changes = {
            name: np.zeros(getattr(present, name).shape) for name in READING_KINDS if getattr(present, name).size
        }
        for name, change in changes.items():
            for channel in np.ndindex(change.shape[1:]):
                moved = self._sound_scans(poses_at(next(offsets_s)), stamps_ns, supply)
                same = (moved.lit_sources == present.lit_sources).all(axis=1)
                index = (slice(None), *channel)
                found = getattr(moved, name)[index] - getattr(present, name)[index]
                change[index] = np.where(same & np.isfinite(found), found, 0.0)
        return changes

    def _supply_voltages(self, ticks: IntArray) -> FloatArray | None:
        if self._supply is None:
            return None
        mean, amplitude, period = self._supply
        return np.asarray(mean + amplitude * np.sin(self._phases(ticks, period)))

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
            if self._noise:
                scan = scans.part(n, n + 1)
                for sensor in self._sensors:
                    for name, values in sensor.disturbed(scan, random).items():
                        noisy.setdefault(name, []).append(values)
        return scans.with_fields({name: np.concatenate(values) for name, values in noisy.items()}), chances

    def _add_ambient_light(self, scans: Scans, ticks: IntArray) -> Scans:
        """Return the scans with ambient light, those with it alone where no source is lit."""
        if self._ambient is None:
            return scans
        interval = max(1, round(self._ambient.interval.number * self._rate))
        currents, lit = scans.diode_currents.copy(), scans.lit_sources.copy()
        for n in np.flatnonzero((ticks % interval == 0) | (ticks == self.first_tick)):
            random = self._dark_readings.generator(int(ticks[n]))
            currents[n], lit[n] = self._dark_noise * random.normal(size=currents[n].shape), NO_SOURCE
        fields = {"diode_currents": currents + self._ambient.current.number, "lit_sources": lit}
        return scans.with_fields(fields | {"statuses": scans.statuses & ~DARK_SUBTRACTED})

    def _add_zero_drift(self, scans: Scans, ticks: IntArray) -> Scans:
        if self._drift is None:
            return scans
        amplitude, period = self._drift
        phase = self._phases(ticks, period)[:, None]
        drifted = {}
        for name, offsets in self._drift_phases.items():
            volts = getattr(scans, name)
            drifted[name] = volts + amplitude * np.sin(phase + offsets[: volts.shape[1]])
        return scans.with_fields(drifted)

    def _add_contamination(self, scans: Scans, ticks: IntArray) -> Scans:
        seconds = np.mod(ticks, self._cycle_ticks) / self._rate
        for dirt in self._dirt:
            dirty = (seconds >= dirt.begin_s) & (seconds < dirt.end_s)
            values = getattr(scans, dirt.field).copy()
            if dirt.is_shift:
                values[(dirty, *dirt.channel)] += dirt.size
            else:
                values[(dirty, *dirt.channel)] *= 1.0 + dirt.size
            scans = scans.with_fields({dirt.field: values})
        return scans

    def _convert(self, scans: Scans, out_of_range: dict[str, BoolArray]) -> tuple[Scans, BoolArray]:
        """Return the scans after the converter, and which of them have a channel at the end of its range.

        A probe beyond its calibrated range drives its channel to the upper end; a diode that the light misses gives no
        current.
        """
        saturated = np.zeros(len(scans), dtype=bool)
        out: dict[str, FloatArray] = {}
        for name, invalid in out_of_range.items():
            limits = self._limits[name]
            values = np.where(invalid, 0.0 if name == DIODE_FIELD else limits[1], getattr(scans, name))
            out[name], at_end = convert_to_digital(values, limits, self._bits, steps=self._steps)
            saturated |= at_end
        return scans.with_fields(out), saturated

    def _latencies_ns(self, chances: FloatArray) -> IntArray:
        mean, jitter = self._latency
        return np.round((mean + jitter * (2.0 * chances - 1.0)) * NS).astype(np.int64)


def convert_to_digital(
    values: FloatArray, limits: FloatArray, bits: int, *, steps: bool
) -> tuple[FloatArray, BoolArray]:
    """Return the values after an analogue-to-digital converter, and which scans have a channel at the end of its range.

    Code c of the ``2^bits`` codes means ``low + c (high - low) / 2^bits``. ``values`` are of shape (n, ...), ``limits``
    are low and high, (2,). Without ``steps`` values are not rounded to codes, only limited.
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
