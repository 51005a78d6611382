# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses of devices whose values are older, or newer, than their frames: they are within their protection level.

The joint of the test rig swings in front of a server of frames; its true angle is known at each stamp. The level is
that of a sound scan: the coverage factor times the standard uncertainty, and the largest error by the stamps.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posor import Posor, State, load_calibration, simulate
from posor.arm_names import find_arm
from posor.calibration.design_parts import quantity_entry
from posor.chain.fault_bounds import COVERAGE_FACTOR
from posor.messages.message_definitions import MessageTypes
from posor.messages.raw_scan import scan_of
from posor.model.scan import Scan, Scans
from posor.numerics.array_types import FloatArray
from posor_drivers.sources.instrument_source import InstrumentParameters, InstrumentSource
from posor_lab.device_servers.stream_server import StreamServer
from posor_lab.harness.program import wait_until

from .stream_rig import stream_rig, write_rig

AMPLITUDE, FREQUENCY = 0.03, 25.0  # [rad], [rad/s]: up to 0.75 rad/s, 19 rad/s^2
GAP_NOISE, RATIO_NOISE = 1e-3, 1e-4  # as the calibration states [V], [1]
SCANS, TABLE = 200, 4001
CYCLE_NS = 103_000_000  # the ticks of scans are at other phases of each


def theta(time_ns: int) -> float:
    return AMPLITUDE * math.sin(FREQUENCY * 1e-9 * (time_ns % 1_000_000_000_000))


class Rig:
    """The test rig: readings at any time, with the noise of its calibration, and the estimator."""

    def __init__(self) -> None:
        self.calibration = load_calibration(find_arm("test_rig").parent / "calibrations" / "joint1.yaml")
        angles = np.linspace(-AMPLITUDE, AMPLITUDE, TABLE)
        poses = np.zeros((TABLE, 7))
        poses[:, 2], poses[:, 5], poses[:, 6] = 0.735e-3, np.sin(0.5 * angles), np.cos(0.5 * angles)
        scans = simulate(self.calibration, poses)
        currents = scans.diode_currents.reshape(TABLE, -1, 4)
        noise = RATIO_NOISE / math.sqrt(8.0) * currents.sum(axis=2, keepdims=True) * np.ones(4)
        self.gaps = scans.gap_voltages.shape[1]
        self._table = np.hstack([scans.gap_voltages, currents.reshape(TABLE, -1)])
        self._noise = np.hstack([np.full((TABLE, self.gaps), GAP_NOISE), noise.reshape(TABLE, -1)])
        self._random = np.random.default_rng(5)

    def readings(self, time_ns: int) -> FloatArray:
        row, share = divmod(0.5 * (theta(time_ns) / AMPLITUDE + 1.0) * (TABLE - 1), 1.0)
        before, after = self._table[int(row)], self._table[min(int(row) + 1, TABLE - 1)]
        sigma: FloatArray = self._noise[int(row)]
        found: FloatArray = before + share * (after - before) + sigma * self._random.standard_normal(len(sigma))
        return found

    def renewing(self, interval_ns: int, pause_ns: int = 0) -> Callable[[int], Sequence[float]]:
        """Return the readings of a device that has new ones at an interval, but for a pause in each ``CYCLE_NS``."""
        newest: dict[int, FloatArray] = {}

        def values(time_ns: int) -> Sequence[float]:
            renewed_ns = time_ns - time_ns % interval_ns
            if not newest or (renewed_ns not in newest and time_ns % CYCLE_NS >= pause_ns):
                newest.clear()
                newest[renewed_ns] = self.readings(renewed_ns)
            (found,) = newest.values()
            return [float(value) for value in found]

        return values

    def scans(
        self, folder: Path, server: StreamServer, rate_hz: float, device: dict[str, Any], act: Callable[[], None]
    ) -> Scans:
        """Return scans of ticks at 100 Hz; ``device``: further keys; ``act`` is called after a third of the scans."""
        units = {f"c{n}": "V" if n < self.gaps else "A" for n in range(self._table.shape[1])}
        channels = [{"channel": f"box/{name}"} for name in units]
        joint = {"gap_voltages": channels[: self.gaps], "diode_currents": channels[self.gaps :]}
        content = stream_rig(server.port, units, {**joint, "lit_sources": [0, 1], "demodulated": True}, rate_hz)
        content["devices"]["box"] |= device
        parameters = InstrumentParameters(file=write_rig(folder, content), joint="elbow", host_clock=False)
        source = InstrumentSource(parameters, MessageTypes())
        found: list[Scan] = []
        try:
            source.open()
            ticks = [source.newest_tick(time.time_ns())]

            def read() -> bool:
                while ticks[0] < source.newest_tick(time.time_ns()):
                    ticks[0] += 1
                    messages = source.read_tick(ticks[0])
                    found.extend(scan_of(message.data) for message in messages)
                    if messages and len(found) == SCANS // 3:
                        act()
                return len(found) >= SCANS

            wait_until(read, "scans", lambda: time.sleep(0.001))
        finally:
            source.close()
        return Scans.of(found)

    def largest_ratio(self, scans: Scans) -> float:
        """Return the largest error of a usable pose, divided by its level."""
        found = Posor(self.calibration).estimate_all(scans)
        usable = (found.states == State.OK) | (found.states == State.DEGRADED)
        angles = np.arctan2(found.rotations[:, 1, 0], found.rotations[:, 0, 0])
        true = np.array([theta(int(stamp)) for stamp in scans.stamps_ns])
        errors = np.column_stack([found.translations - [0.0, 0.0, 0.735e-3], angles - true])[usable]
        sigmas = np.sqrt(np.diagonal(found.covariances(), axis1=1, axis2=2))[usable][:, [0, 1, 2, 5]]
        shifts = found.stamp_shifts[usable][:, [0, 1, 2, 5]]
        assert usable.sum() > SCANS // 3
        return float(np.abs(errors / (COVERAGE_FACTOR * sigmas + shifts)).max())


@pytest.mark.parametrize(
    ("interval_ns", "pause_ns"), [(3_000_000, 0), (7_000_000, 0), (20_000_000, 0), (1, 5_000_000), (1, 15_000_000)]
)
def test_poses_of_repeated_values_are_within_their_level(tmp_path: Path, interval_ns: int, pause_ns: int) -> None:
    rig = Rig()
    with StreamServer(rig.renewing(interval_ns, pause_ns)) as server:
        scans = rig.scans(tmp_path, server, 1000, {}, lambda: None)
    assert rig.largest_ratio(scans) < 1.0
    without = {"stamp_limits": np.full(len(scans), 1e-4), "stamp_uncertainties": np.full(len(scans), 1e-5)}
    assert rig.largest_ratio(scans.with_fields(without)) > 1.0


@pytest.mark.parametrize(("fault", "value", "connections"), [("lost_triggers", 1, 1), ("false_trigger", True, 2)])
def test_poses_beside_a_lost_or_a_false_trigger_are_within_their_level(
    tmp_path: Path, fault: str, value: int, connections: int
) -> None:
    rig = Rig()
    with StreamServer(lambda time_ns: rig.readings(time_ns).tolist(), 100, triggered=True) as server:
        tolerance = {"trigger_tolerance": quantity_entry(2e-3, "s")}
        scans = rig.scans(tmp_path, server, 100, tolerance, lambda: setattr(server, fault, value))
        assert not getattr(server, fault)
        assert server.clients == connections
    assert rig.largest_ratio(scans) < 1.0
    if fault == "lost_triggers":
        without = {"stamp_limits": np.full(len(scans), 2e-3), "stamp_uncertainties": np.full(len(scans), 1e-5)}
        assert rig.largest_ratio(scans.with_fields(without)) > 1.0
