"""Scans as the simulator makes them, and where a channel stands in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from posor.errors import CalibrationError
from posor.sensors.bumpy_ring import BumpyRingCalibration
from posor.sensors.diodes import DiodesCalibration
from posor.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, IntArray

PROBE_FIELDS = ("gap_voltages", "ring_voltages")
DIODE_FIELD = "diode_currents"


@dataclass(frozen=True)
class SimulatedScans:
    """n scans of one joint.

    Attributes:
        scans: Raw readings.
        statuses: Flags of ``posor_msgs/RawScan.status``, (n,).
        sent: Whether the scan is published at all, (n,).
        latencies_ns: From the stamp to the publication [ns], (n,).

    """

    scans: Scans
    statuses: IntArray
    sent: BoolArray
    latencies_ns: IntArray


class ChannelEntry(Protocol):
    """Entry of a scenario file that names a channel of a joint: a probe, or a diode and one of its contacts."""

    @property
    def joint(self) -> str:
        """Name of the joint."""

    @property
    def channel(self) -> str | None:
        """Name of the probe or diode; None: not stated."""

    @property
    def contact(self) -> str | None:
        """Letter of the diode's contact; None: not stated."""


def find_channel(
    calibration: Calibration, entry: ChannelEntry, where: str, *, whole_diode: bool = False
) -> tuple[str, tuple[int, ...]]:
    """Return the field of ``Scans`` that holds a channel, and the channel's index in one scan.

    Args:
        calibration: Of the joint's POSOR.
        entry: Entry of the scenario file that names the channel.
        where: Where it stands.
        whole_diode: Whether a diode without a contact is all of its contacts.

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
    raise CalibrationError(
        f"joint '{entry.joint}' has no {kind} '{entry.channel}'",
        where=where,
        expected=f"one of {', '.join(known)}" if known else f"a joint with {kind}s",
    )
