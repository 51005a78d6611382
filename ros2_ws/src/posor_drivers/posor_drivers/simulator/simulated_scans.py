"""Scans as the simulator makes them, and where a channel stands in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor.errors import CalibrationError
from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, IntArray

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
        return DIODE_FIELD, (diodes[entry.channel], "ABCD".index(entry.contact))
    if whole_diode and entry.channel in diodes:
        return DIODE_FIELD, (diodes[entry.channel],)
    kind, known = (
        ("probe", [*probes, *(diodes if whole_diode else ())]) if entry.contact is None else ("diode", [*diodes])
    )
    expected = f"one of {', '.join(known)}" if known else f"a joint with {kind}s"
    raise CalibrationError(f"joint '{entry.joint}' has no {kind} '{entry.channel}'", where=where, expected=expected)
