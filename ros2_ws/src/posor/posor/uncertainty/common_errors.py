# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors that one calibration laboratory gives all parts of an arm: the scale of its length reference, its temperature.

A relative error of the reference makes every length wrong by the same part of it. A wrong temperature of the parts
while they are measured does so by their expansion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from posor.calibration.calibration_file import VERSION, Calibration, calibration_from
from posor.calibration.parameter_entries import parameter_entries
from posor.chain.beams_file import VERSION as BEAMS_VERSION
from posor.chain.beams_file import BeamsFile

if TYPE_CHECKING:
    from collections.abc import Iterable

LENGTH_SCALE, TEMPERATURE = "length_scale", "calibration_temperature"
EXPANSION = 23e-6  # linear expansion of the parts, of aluminium [1/K]


@dataclass(frozen=True)
class CommonErrors:
    """Standard uncertainties of both errors; zero: not stated."""

    length_scale: float = 0.0  # relative
    temperature: float = 0.0  # [K]

    def calibration_with(self, calibration: Calibration) -> Calibration:
        """Return a calibration that states both errors for all its lengths."""
        lengths = {entry.key for entry in parameter_entries(calibration) if entry and entry.quantity.unit == "m"}
        content = calibration.model_dump(mode="json")
        shared = {**content["shared"], **self._terms(sorted(lengths))}
        return calibration_from({**content, "version": VERSION, "shared": shared})

    def beams_with(self, beams: BeamsFile) -> BeamsFile:
        """Return a beams file that states both errors for the lengths of all beams."""
        content = beams.model_dump(mode="json")
        shared = {**content["shared"], **self._terms([f"{beam.joint}.position" for beam in beams.beams])}
        return BeamsFile.model_validate({**content, "version": BEAMS_VERSION, "shared": shared})

    def _terms(self, lengths: Iterable[str]) -> dict[str, Any]:
        terms = {LENGTH_SCALE: (self.length_scale, "1", 1.0), TEMPERATURE: (self.temperature, "K", EXPANSION)}
        return {
            name: {
                "uncertainty": {"value": sigma, "unit": unit},
                "relative": {key: {"value": factor, "unit": "1" if unit == "1" else f"1/{unit}"} for key in lengths},
            }
            for name, (sigma, unit, factor) in terms.items()
            if sigma > 0.0
        }
