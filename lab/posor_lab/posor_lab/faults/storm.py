# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A storm of faults through the estimator: many scans of which nearly a third is faulty, all kinds mixed.

Three stacks with a fourth gap probe: light ring, bumpy ring, fixed diodes. The scans obey the independent truth, with
parameters that are drawn within the uncertainties of their calibration. Faults come at random and last for 1 to 200
scans. A probe is off by at least twice its minimal detectable bias; smaller errors are in ``offline_faults``. A stuck
reading begins to differ by less than that, zero or garbage may be near the true reading, and a pose of sound readings
may exceed 5 standard deviations by chance. Poses that the protection level of the same scan covers are counted
separately.

Once readings have been sound for ``OPERATOR_SCANS``, an operator acknowledges a latched joint, and its encoder confirms
theta. Nobody acknowledges during a fault.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from posor.calibration.designs import design, sized_design
from posor.estimation.estimate import ESTIMATE, Estimates
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import USABLE_STATES, Fault, State
from posor.model.scan import HOME_BUMP, Scans
from posor.numerics.stamps import NS
from posor.numerics.vector import thetas_of
from posor.uncertainty.protection_level import joint_protection_levels
from posor.uncertainty.reliability import joint_reliability
from posor_drivers.simulator.electronics import convert_to_digital
from posor_drivers.simulator.pose_array import PoseArray
from posor_drivers.simulator.simulated_scans import DIODE_FIELD

from posor_lab.faults.cause_injection import draw_sensors
from posor_lab.faults.pose_judge import estimated_poses, small_errors, wrong_poses
from posor_lab.faults.storm_faults import RANGES, Episode, field_of, storm_faults
from posor_lab.true_scans import TruePosor

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.calibration.calibration_file import Calibration, Converter
    from posor.estimation.sensor_stack import Stack
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

RATE = 500
BLOCK = 20_000  # scans of one block, for which the true parameters of the sensors are drawn once
FAULTY_SHARE = 0.3
LONGEST = 200  # scans of the longest fault; the logarithm of the length is uniformly distributed
OPERATOR_SCANS = 20  # sound scans after a fault until an operator acknowledges it
ENCODER_SIGMA = 1e-3  # standard uncertainty of the encoder that confirms theta after an acknowledgement [rad]
START_SCANS = 1000  # scans without faults at the beginning of a block, in which rings pass their home mark
SWING_S, PHASES = 2.5, 40  # period of theta, and poses of half of it at which the detectable biases are computed
HOME_WIDTH = 0.25  # half width of the home mark, in periods of theta


def storm_calibrations() -> dict[str, Calibration]:
    """Return the calibration of each stack."""
    frames = ("receiving", "target")
    return {
        "light_ring": sized_design("quad_light_ring", 0.2032, frames=frames, title="storm_light_ring"),
        "bumpy_ring": sized_design("quad_bumpy_ring", 0.2032, frames=frames, title="storm_bumpy_ring"),
        "diodes": design("quad_diodes", motion=True, converter=True, frames=frames),
    }


@dataclass(frozen=True)
class Storm:
    """Scans with faults, and the true poses."""

    scans: Scans  # as the driver publishes them, (n)
    faults: IntArray  # fault of each scan, (n,): an index of ``names``; -1: no fault
    names: tuple[str, ...]  # names of the faults
    truth: PoseArray  # true poses, (n)
    acknowledgements: IntArray  # scans before which an operator acknowledges, in order


class StormMaker:
    """Draws blocks of scans of one stack."""

    def __init__(self, calibration: Calibration) -> None:
        """Compute the largest minimal detectable biases over the motion."""
        self.calibration, self.posor, self._truth = calibration, Posor(calibration), TruePosor(calibration)
        self._faults = storm_faults(calibration, self.posor.hypotheses.causes)
        self.names = tuple(self._faults)
        poses = _motion(np.linspace(0.0, SWING_S / 2.0, PHASES), 0.0)
        scans = scans_at(self.posor.stack, poses.rotations, poses.translations, np.arange(PHASES))
        biases = [joint_reliability(self.posor, scans[n], poses[n]).biases for n in range(PHASES)]
        self._biases = dict(zip(self.posor.stack.reading_names, np.max(biases, axis=0).tolist(), strict=True))

    def draw(self, seed: int, count: int = BLOCK) -> Storm:
        """Return a block of ``count`` scans; the same seed gives the same block."""
        random = np.random.default_rng([seed, *self.calibration.name.encode()])
        times = np.arange(count) / RATE
        truth = _motion(times, random.uniform(0.0, 2.0 * np.pi))
        stack = draw_sensors(self.posor, random)
        arrays = self._sound_readings(truth, stack, random)
        faults = np.full(count, -1)
        begin, acknowledgements = START_SCANS, []
        while True:
            length = int(math.exp(random.uniform(0.0, math.log(LONGEST + 1))))
            begin += 1 + int(random.exponential(_mean_length() * (1.0 - FAULTY_SHARE) / FAULTY_SHARE))
            if begin + length > count:
                break
            kind = int(random.integers(len(self.names)))
            part = slice(begin, begin + length)
            self._faults[self.names[kind]](Episode(arrays, part, random, self._bias, stack))
            faults[part] = kind
            begin += length
            acknowledgements.append(begin + OPERATOR_SCANS)
        sound = [n for n in acknowledgements if n < count and not np.any(faults[n - OPERATOR_SCANS : n + 1] >= 0)]
        sent = arrays.pop("sent")
        places = np.cumsum(sent) - 1
        return Storm(
            scans=Scans.from_fields(**arrays).select(sent),
            faults=faults[sent],
            names=self.names,
            truth=truth.select(sent),
            acknowledgements=places[np.array(sound, dtype=np.int64)],
        )

    def _sound_readings(self, truth: PoseArray, stack: Stack, random: np.random.Generator) -> dict[str, Any]:
        """Return the fields of sound scans as arrays that may be changed, and which are sent."""
        count = len(truth)
        stamps = np.arange(1, count + 1, dtype=np.int64) * (NS // RATE)
        scans = self._truth.scans_at(stack, truth.rotations, truth.translations, stamps, noise=random)
        arrays: dict[str, Any] = {"stamps_ns": stamps, "numbers": np.arange(count, dtype=np.uint64)}
        converter = cast("Converter", self.calibration.converter)
        for name, limits in RANGES.items():
            values = getattr(scans, name)
            step = (converter.current if name == DIODE_FIELD else converter.voltage).number
            bits = round(math.log2((limits[1] - limits[0]) / step))
            arrays[name] = (
                convert_to_digital(values, np.array(limits), bits, steps=True)[0] if values.size else values.copy()
            )
        arrays["lit_sources"] = scans.lit_sources.copy()
        arrays["supply_voltages"], arrays["temperatures"] = np.full(count, 15.0), np.full(count, 293.15)
        arrays["at_home"] = self._at_home(truth).astype(np.int64)
        arrays["statuses"] = HOME_BUMP * arrays["at_home"]
        arrays["sent"] = np.ones(count, dtype=bool)
        return arrays

    def _at_home(self, truth: PoseArray) -> BoolArray:
        settings = self.posor.settings
        if not settings["bump_angle"] > 0.0:
            return np.zeros(len(truth), dtype=bool)
        thetas = thetas_of(truth.rotations)
        return np.asarray(np.abs(thetas - settings["home_theta"]) < HOME_WIDTH * settings["bump_angle"])

    def _bias(self, field: str, channel: int) -> float:
        """Return the minimal detectable bias of a probe [V]."""
        sensor: Any = next(each for each in self.calibration.sensors if field_of(each) == field)
        probe, kind = sensor.probes[channel], "gap" if field == "gap_voltages" else "ring"
        return float(self._biases[f"{kind} {probe.name}"] / abs(probe.volts_to_gap.array[1]))


def _mean_length() -> float:
    """Return the mean length of a fault: ``floor(exp(u))``, u uniform from 0 to ln(LONGEST + 1)."""
    lengths = np.arange(1, LONGEST + 1)
    chances = np.log((lengths + 1) / lengths) / math.log(LONGEST + 1)
    return float(lengths @ chances)


def _motion(times: FloatArray, phase: float) -> PoseArray:
    """Return the target's true poses at times [s], (n,): theta swings about home, runout and inclination follow."""
    swing = 0.05 * np.sin(2.0 * np.pi * times / SWING_S + phase)
    leans = 2e-5 * np.column_stack([np.sin(3.0 * times), np.cos(2.0 * times + phase), np.zeros(len(times))])
    runout = 1e-5 * np.column_stack([np.cos(2.0 * times), np.sin(3.0 * times + phase), np.sin(5.0 * times)])
    leaned = PoseArray.from_rotation_vectors(np.array([0.0, 0.0, 0.735e-3]) + runout, leans)
    return leaned @ PoseArray.from_axis_angles(2, swing)


@dataclass(frozen=True)
class StormCount:
    """Figures of a storm."""

    scans: int = 0
    injected: int = 0
    wrong_ok: int = 0  # beyond 5 standard deviations of the truth, and published as valid
    uncovered: int = 0  # of these, beyond the protection level of the same scan
    sound: int = 0  # scans without a fault, outside of a latched period
    sound_ok: int = 0  # OK, or DEGRADED by the acknowledgement of an earlier fault alone
    latched: int = 0  # scans without a fault in a latched period
    wrong_by_fault: Counter[str] = field(default_factory=Counter)  # wrong_ok by the fault before or during them
    different: int = 0  # transforms of a node that differ from the estimator's

    def __add__(self, other: StormCount) -> StormCount:
        return StormCount(**{each.name: getattr(self, each.name) + getattr(other, each.name) for each in fields(self)})

    @property
    def sound_ok_share(self) -> float:
        """Share of sound scans outside of a latched period that are OK."""
        return self.sound_ok / self.sound if self.sound else math.nan


def estimate_storm(posor: Posor, storm: Storm, encoder: np.random.Generator | None = None) -> Estimates:
    """Return the estimates of a storm, acknowledged as an operator would; ``encoder``: its noise, None: no encoder."""
    records, effects = np.zeros(len(storm.scans), dtype=ESTIMATE), posor.allocate_effects(len(storm.scans))
    scans, begin, thetas = storm.scans._records.copy(), 0, thetas_of(storm.truth.rotations)
    for end in [*storm.acknowledgements.tolist(), len(scans)]:
        posor.estimate_records(scans[begin:end], records[begin:end], effects[begin:end])
        if end < len(scans):
            posor.acknowledge()
        if end < len(scans) and posor.counts_bumps and encoder is not None:
            posor.confirm_theta(thetas[end] + ENCODER_SIGMA * encoder.normal(), ENCODER_SIGMA)
        begin = end
    return Estimates(records, storm.scans, posor.reason, fault_effects=effects)


def count_storm(
    storm: Storm, states: IntArray, faults: IntArray, poses: PoseArray, covariances: FloatArray, levels: FloatArray
) -> StormCount:
    """Return the figures of a storm by the results of each of its scans.

    ``covariances``: totals, (n, 6, 6); ``levels``: protection levels published with the poses, (n, 6).
    """
    valid = np.isin(states, USABLE_STATES)
    is_ok = (states == State.OK) | (valid & (faults == Fault.ACKNOWLEDGED))
    wrong = valid & wrong_poses(poses, covariances, storm.truth)
    sound = storm.faults < 0
    with np.errstate(invalid="ignore"):
        covered = np.all(np.abs(small_errors(poses, storm.truth)) <= levels, axis=1)
    latched = sound & _latched_periods(states, faults)
    indices = np.maximum.accumulate(np.where(sound, 0, np.arange(len(sound))))
    by_fault = (storm.names[n] if n >= 0 else "none" for n in storm.faults[indices][wrong].tolist())
    return StormCount(
        scans=len(sound),
        injected=int(np.count_nonzero(~sound)),
        wrong_ok=int(np.count_nonzero(wrong)),
        uncovered=int(np.count_nonzero(wrong & ~covered)),
        sound=int(np.count_nonzero(sound & ~latched)),
        sound_ok=int(np.count_nonzero(sound & ~latched & is_ok)),
        latched=int(np.count_nonzero(latched)),
        wrong_by_fault=Counter(by_fault),
    )


def _latched_periods(states: IntArray, faults: IntArray) -> BoolArray:
    """Return which scans are in a period from a latched or uncounted scan, or the beginning, to the next pose, (n,)."""
    begins = (faults & Fault.LATCHED != 0) | (states == State.UNCOUNTED)
    ends = np.isin(states, USABLE_STATES)
    begins[0] |= not ends[0]
    latest = np.maximum.accumulate(np.where(begins | ends, np.arange(len(states)), 0))
    return np.asarray(begins[latest])


def _count_estimates(maker: StormMaker, storm: Storm, seed: int) -> StormCount:
    estimates = estimate_storm(maker.posor, storm, np.random.default_rng(seed))
    levels = joint_protection_levels(maker.posor, estimates).levels
    return count_storm(storm, estimates.states, estimates.faults, *estimated_poses(estimates), levels)


def run_storm(
    calibration: Calibration,
    injected: int,
    seed: int,
    on_block: Callable[[int], None],
    count_block: Callable[[StormMaker, Storm, int], StormCount] = _count_estimates,
) -> StormCount:
    """Return the figures of a storm of one stack with at least ``injected`` faulty scans.

    The seeds of further blocks follow ``seed``. ``on_block`` is called with the number of faulty scans of each block.
    """
    maker, total = StormMaker(calibration), StormCount()
    while total.injected < injected:
        storm = maker.draw(seed)
        maker.posor.reset()
        block = count_block(maker, storm, seed)
        total, seed = total + block, seed + 1
        on_block(block.injected)
    return total
