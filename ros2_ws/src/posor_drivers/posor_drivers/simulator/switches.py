"""Which imperfections are simulated; how large they are stands in the scenario and in the arm's own files."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self


@dataclass(frozen=True)
class Switches:
    """One switch for each; the mechanics of the arm is always as the scenario says.

    Attributes:
        noise: Of the readings, as large as the calibration says.
        quantisation: Steps of the converter; its range ends where it does in any case.
        zero_drift: Of the probes.
        supply_drift: Of the supply voltage about its mean.
        contamination: Dirt on single channels.
        dropouts: Scans that are not sent.
        latency: Between exposure and publication.
        calibration_errors: The real POSORs differ from their calibrations, by as much as those say is uncertain.
        beam_errors: The real measuring beams differ from the beams file, likewise.
        sag: The measuring beams sag.
        inertia: And otherwise while they accelerate.

    """

    noise: bool = True
    quantisation: bool = True
    zero_drift: bool = True
    supply_drift: bool = True
    contamination: bool = True
    dropouts: bool = True
    latency: bool = True
    calibration_errors: bool = True
    beam_errors: bool = True
    sag: bool = True
    inertia: bool = True

    @classmethod
    def only(cls, *names: str) -> Self:
        """Return switches of which only those named are on."""
        return cls(**{field.name: field.name in names for field in fields(cls)})
