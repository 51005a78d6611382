# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Readings of a simulated arm at any time, as devices measure them, and the true endpoint."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from posor.numerics.stamps import NS
from posor.sensors.diodes import DiodesCalibration
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_drivers.simulator.imperfections import Imperfections
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.chain.arm_file import ArmFile
    from posor.numerics.array_types import FloatArray, IntArray

SIMULATED_RATE = 1000  # rate of the tables [Hz]; between their rows readings and truth are interpolated
SEED = 1985


class ReadingChannel(NamedTuple):
    """One reading of a joint."""

    name: str
    kind: str  # entry of the joint in the instruments file
    unit: str


class SimulatedReadings:
    """The arm of a scenario, slowed down by a factor; every reading has the noise of its calibration.

    It rests at the begin of the cycle, where rings see their home marks, until ``start_motion``.
    """

    def __init__(self, arm: ArmFile, slowness: float = 1.0, seed: int = SEED) -> None:
        """Compute one cycle."""
        self._begin_ns: int | None = None
        self.arm = arm
        self._rate_ns = SIMULATED_RATE / slowness / NS
        self._random = np.random.default_rng(seed)
        self._drawn: dict[str, tuple[int, int]] = {}
        effects = ("sag", "inertia") if slowness == 1.0 else ("sag",)  # slower, its accelerations are negligible
        smooth = ArmSimulation(arm, Imperfections.only(*effects), SIMULATED_RATE)
        noisy = ArmSimulation(arm, Imperfections.only("noise", *effects), SIMULATED_RATE)
        ticks = np.arange(smooth.scenario.cycle_ticks)
        self._points: FloatArray = np.asarray(smooth.truth(ticks).endpoint.translations)
        self._velocities = _joint_velocities(smooth, ticks) / slowness
        self.channels: dict[str, list[ReadingChannel]] = {}
        self._tables: dict[str, tuple[FloatArray, FloatArray]] = {}
        self._whole: dict[str, list[int]] = {}
        for joint in arm.calibrations:
            self.channels[joint], table = _table(smooth.scans(joint, ticks).scans)
            noise = _table(noisy.scans(joint, ticks).scans)[1] - table
            self._whole[joint] = [n for n, each in enumerate(self.channels[joint]) if each.unit == "1"]
            noise[:, self._whole[joint]] = 0.0
            self._tables[joint] = table, noise

    def start_motion(self) -> None:
        """Begin the cycle, once the graph runs."""
        self._begin_ns = time.time_ns()

    def at(self, joint: str, time_ns: int, hold_ns: int = 0) -> list[float]:
        """Return the readings of a joint at a ROS time [ns], in the order of its channels.

        Noise that was drawn less than ``hold_ns`` before is kept: channels of a frame have the noise of one scan, which
        is not independent from contact to contact.
        """
        table, noise = self._tables[joint]
        row, following, share = self._rows(time_ns)
        values = (1.0 - share) * table[row] + share * table[following]
        drawn_ns, drawn = self._drawn.get(joint, (0, 0))
        if not 0 <= time_ns - drawn_ns < hold_ns:
            drawn = int(self._random.integers(len(noise)))
            self._drawn[joint] = time_ns, drawn
        values += noise[drawn]
        values[self._whole[joint]] = table[row, self._whole[joint]]
        readings: list[float] = values.tolist()
        return readings

    def true_points(self, stamps_ns: Sequence[int]) -> FloatArray:
        """Return the true position of the endpoint at ROS times [ns], (n, 3) [m]."""
        rows = [self._rows(stamp) for stamp in stamps_ns]
        return np.array(
            [(1.0 - share) * self._points[row] + share * self._points[following] for row, following, share in rows]
        )

    def joint_velocities(self, stamps_ns: Sequence[int]) -> FloatArray:
        """Return the velocity of the endpoint from the motion of each joint alone, (n, joints, 3) [m/s]."""
        return self._velocities[[self._rows(stamp)[0] for stamp in stamps_ns]]

    def _rows(self, time_ns: int) -> tuple[int, int, float]:
        """Return the rows before and after a time, and the share of the one after."""
        begin_ns = time_ns if self._begin_ns is None else self._begin_ns
        position = max(0, time_ns - begin_ns) * self._rate_ns
        number, count = int(position), len(self._points)
        return number % count, (number + 1) % count, position - number

    def joint_entry(self, joint: str, channels: dict[str, dict[str, Any]]) -> dict[str, Any]:
        """Return the joint of an instruments file; ``channels`` are the entries of the readings by their names."""
        entry: dict[str, Any] = {"frame_id": self.arm.calibration(joint).frames.parent}
        for name, kind, _ in self.channels[joint]:
            if kind in {"supply_voltage", "temperature", "reference_voltage", "home_mark"}:
                entry[kind] = channels[name]
            else:
                entry.setdefault(kind, []).append(channels[name])
        diodes = [each for each in self.arm.calibration(joint).sensors if isinstance(each, DiodesCalibration)]
        if any(each.ambient is not None for each in diodes):
            entry["demodulated"] = True
        return entry


def _joint_velocities(simulation: ArmSimulation, ticks: IntArray) -> FloatArray:
    """Return the velocity of the endpoint from the motion of each joint alone at all ticks of a cycle, (n, j, 3)."""
    truth, chain = simulation.truth(ticks), simulation.chain
    parts = [truth.T_parent_child[joint.name] for joint in chain.joints]
    poses = np.stack(
        [np.hstack([part.translations, Rotation.from_matrix(part.rotations).as_quat()]) for part in parts], axis=1
    )
    exact = np.zeros((*poses.shape[:2], 6, 6))
    points = chain.estimate_all(poses, exact, exact).poses[:, :3]
    velocities = np.empty((*poses.shape[:2], 3))
    for n in range(len(parts)):
        ahead = poses.copy()
        ahead[:, n] = np.roll(poses[:, n], -1, axis=0)
        velocities[:, n] = (chain.estimate_all(ahead, exact, exact).poses[:, :3] - points) * SIMULATED_RATE
    return velocities


def _table(scans: Any) -> tuple[list[ReadingChannel], FloatArray]:
    """Return channels and readings of scans, (n, channels)."""
    n = len(scans.stamps_ns)
    parts = {
        "gap_voltages": ("V", scans.gap_voltages),
        "ring_voltages": ("V", scans.ring_voltages),
        "diode_currents": ("A", scans.diode_currents.reshape(n, -1)),
        "lit_sources": ("1", scans.lit_sources),
        "home_mark": ("1", (scans.at_home == 1)[:, None]),
        "supply_voltage": ("V", scans.supply_voltages[:, None]),
    }
    if not np.isnan(scans.reference_voltages).any():
        parts["reference_voltage"] = "V", scans.reference_voltages[:, None]
    channels = [
        ReadingChannel(f"{kind}{column}", kind, unit)
        for kind, (unit, columns) in parts.items()
        for column in range(columns.shape[1])
    ]
    return channels, np.concatenate([columns for _, columns in parts.values()], axis=1, dtype=np.float64)
