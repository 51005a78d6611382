# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Scans without ambient light and with the converter's gain of one, for procedures that use raw readings offline."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from posor.model.scan import DARK_SUBTRACTED
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray


def corrected_scans(scans: Scans, calibration: Calibration, dark_currents: FloatArray | None = None) -> Scans:
    """Return the lit scans, their diode currents less those of the last dark scan, their voltages at a gain of one.

    ``dark_currents`` (diodes, 4) [A]: of the ambient light before the first dark scan; None: those of the first one.
    Without both, where scans are flagged STATUS_DARK_SUBTRACTED, and where the calibration does not remove ambient
    light, the currents stay as they are. If no scan is lit, all are returned.
    """
    fields = dict[str, Any]()
    removes = any(
        isinstance(sensor, DiodesCalibration) and sensor.ambient is not None for sensor in calibration.sensors
    )
    dark = scans.dark if removes and not scans.dark.all() else np.zeros(len(scans), dtype=bool)
    lit = scans.select(~dark) if dark.any() else scans
    known = scans.diode_currents[dark]
    if dark_currents is not None:
        known = np.concatenate([dark_currents[None], known])
    if len(known):
        last = np.cumsum(dark)[~dark] - (dark_currents is None)
        held = (lit.statuses & DARK_SUBTRACTED == 0)[:, None, None]
        fields["diode_currents"] = lit.diode_currents - np.where(held, known[np.maximum(last, 0)], 0.0)
        fields["statuses"] = lit.statuses | DARK_SUBTRACTED
    for sensor in calibration.sensors:
        if isinstance(sensor, GapProbesCalibration) and sensor.reference is not None:
            known_voltage = sensor.reference.voltage.number
            measured = np.where(lit.reference_voltages > 0.0, lit.reference_voltages, known_voltage)
            for name in ("gap_voltages", "ring_voltages"):
                fields[name] = getattr(lit, name) * (known_voltage / measured)[:, None]
            fields["reference_voltages"] = np.full(len(lit), known_voltage)
    return lit.with_fields(fields) if fields else lit
