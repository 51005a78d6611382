# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Scans as the simulator makes them, and where a channel stands in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from posor.errors import CalibrationError
from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor.sensors.diodes import CONTACT_LETTERS, DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray

    from posor_drivers.simulator.electronics_settings import TimedEntry

PROBE_FIELDS = ("gap_voltages", "ring_voltages")
DIODE_FIELD = "diode_currents"


@dataclass(frozen=True)
class SimulatedScans:
    """n scans of one joint."""

    scans: Scans  # raw readings
    statuses: IntArray  # flags of ``posor_msgs/RawScan.status``, (n,)
    sent: BoolArray  # whether the scan is published at all, (n,)
    latencies_ns: IntArray  # from the stamp to the publication [ns], (n,)


class SoundScans(Protocol):
    """Scans of a joint without the faults of the scenario, at any ticks (n,)."""

    def scans_at(self, ticks: IntArray) -> SimulatedScans:
        """Return the scans."""

    def exposure_changes(self, ticks: IntArray, interval_s: float) -> dict[str, FloatArray]:
        """Return what multiplexing at an interval [s] changes in the readings, by field."""

    def exposure_offsets(self, interval_s: float) -> FloatArray:
        """Return the offset of each channel from the stamp, multiplexed at an interval [s], (c,)."""


def stated_exposures(offsets_s: FloatArray, count: int, statement: str) -> dict[str, FloatArray]:
    """Return the fields of scans, (count,), that state exposures: "stated", "unknown", or "unstated": none."""
    if statement == "unstated":
        return {}
    offsets = offsets_s if statement == "stated" else np.full(len(offsets_s), np.nan)
    return {
        "exposure_offsets": np.tile(offsets, (count, 1)),
        "exposure_spans": np.full(count, offsets_s[-1] - offsets_s[0]),
    }


def find_channel(
    calibration: Calibration, entry: TimedEntry, where: str, *, whole_diode: bool = False
) -> tuple[str, tuple[int, ...]]:
    """Return the field of ``Scans`` that holds a channel, and the channel's index in one scan.

    With ``whole_diode``, a diode without a contact is all of its contacts. ``where`` is the place of the entry.

    Raises:
        CalibrationError: There is no such channel.

    """
    probes, diodes = {}, {}
    for sensor in calibration.sensors:
        if isinstance(sensor, GapProbesCalibration | BumpyRingCalibration):
            name = PROBE_FIELDS[isinstance(sensor, BumpyRingCalibration)]
            probes.update({probe.name: (name, (index,)) for index, probe in enumerate(sensor.probes)})
        elif isinstance(sensor, DiodesCalibration):
            diodes.update({diode.name: index for index, diode in enumerate(sensor.diodes)})
    if entry.contact is None and entry.channel in probes:
        return probes[entry.channel]
    if entry.contact is not None and entry.channel in diodes:
        return DIODE_FIELD, (diodes[entry.channel], CONTACT_LETTERS.index(entry.contact))
    if whole_diode and entry.channel in diodes:
        return DIODE_FIELD, (diodes[entry.channel],)
    kind, known = (
        ("probe", [*probes, *(diodes if whole_diode else ())]) if entry.contact is None else ("diode", [*diodes])
    )
    expected = f"one of {', '.join(known)}" if known else f"a joint with {kind}s"
    raise CalibrationError(f"joint '{entry.joint}' has no {kind} '{entry.channel}'", where=where, expected=expected)
