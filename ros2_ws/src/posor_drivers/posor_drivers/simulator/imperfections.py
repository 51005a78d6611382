"""Switches for the simulated imperfections; their magnitudes are in the scenario and in the arm's own files."""

from __future__ import annotations

from typing import Self

from pydantic import BaseModel, ConfigDict, Field


class Imperfections(BaseModel):
    """One switch for each imperfection. The mechanics of the arm always follow the scenario."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    noise: bool = Field(default=True, description="noise of the readings, as large as the calibration says")
    quantisation: bool = Field(default=True, description="steps of the analogue-to-digital converter")
    zero_drift: bool = Field(default=True, description="slow drift of the probes' zeros")
    supply_drift: bool = Field(default=True, description="slow drift of the probes' supply voltage")
    contamination: bool = Field(default=True, description="dirt on single channels, part of the time")
    dropouts: bool = Field(default=True, description="scans that are never published")
    latency: bool = Field(default=True, description="delay between exposure and publication")
    calibration_errors: bool = Field(
        default=True, description="POSORs differ from their calibrations, by as much as those say is uncertain"
    )
    beam_errors: bool = Field(
        default=True, description="measuring beams differ from the beams file, by as much as it says is uncertain"
    )
    sag: bool = Field(default=True, description="sag of the measuring beams")
    inertia: bool = Field(default=True, description="change of the sag while the beams accelerate")

    @classmethod
    def only(cls, *names: str) -> Self:
        """Return the model with only the named switches on."""
        return cls(**{name: name in names for name in cls.model_fields})
