# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The POSOR of a campaign: its calibration as built, and its true parameters."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import yaml
from posor.calibration.calibration_file import Calibration, calibration_from
from posor.calibration.designs import design
from posor.calibration.edit import parse_key_path
from posor.calibration.parameter_entries import parameter_entries
from posor.estimation.posor import Posor
from posor_calibration.calibration_parameters import FreeParameters
from posor_drivers.simulator.imperfections import RandomStream

from posor_lab.true_scans import TruePosor

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from posor.estimation.sensor_stack import Stack
    from posor.numerics.array_types import FloatArray

PosorName = Literal["triad_diodes", "triad_bumpy_ring"]
POSORS: tuple[PosorName, ...] = ("triad_diodes", "triad_bumpy_ring")

AS_BUILT: Mapping[str, Mapping[str, Any]] = yaml.safe_load(
    Path(__file__).with_name("as_built.yaml").read_text(encoding="utf-8")
)
"""Standard uncertainties before any calibration, by group and quantity; other quantities are exact."""
DRIFT = 0.05  # standard deviation of the drift of the gap probes' zeros after the day of their linearisation [V]


def as_built_calibration(name: PosorName) -> Calibration:
    """Return the calibration of a design before any procedure."""
    calibration = design(name)
    content: dict[str, Any] = calibration.model_dump(mode="json", exclude_defaults=True)
    content["name"] = f"{name}_as_built"
    content["provenance"]["notes"] = ["uncertainties as the shop leaves them, before any calibration"]
    for key in {entry.key for entry in parameter_entries(calibration) if entry is not None}:
        group = next((group for group in AS_BUILT if key.startswith(group)), "")
        quantity = next((name for name in AS_BUILT.get(group, ()) if key.endswith(f".{name}")), None)
        # Only the diodes have maps and only rings have a ring: the name of the group tells the sensor.
        if quantity is not None:
            part: Any = content
            for step in parse_key_path(key):
                part = part[step]
            part["sigma"] = AS_BUILT[group][quantity]
    return calibration_from(content)


@dataclass(frozen=True)
class GroundTruth:
    """A POSOR with its true parameters."""

    name: PosorName  # name of its design
    seed: int  # seed of the draw
    as_built: Calibration  # calibration of the POSOR as built
    real: TruePosor  # reads the sensors, by the independent truth
    first_day: Stack  # its true sensors on the day on which its probes are linearised
    later: Stack  # the same after the drift of the probes' zeros

    @staticmethod
    def draw(name: PosorName, seed: int) -> GroundTruth:
        """Draw a POSOR from the uncertainties of its calibration as built, and its drift."""
        calibration = as_built_calibration(name)
        random = RandomStream(seed, "campaign", name, "truth").generator()
        free = FreeParameters(calibration)
        values = free.parameter_vector(free.start + free.sigmas * random.normal(size=len(free)))
        stack = Posor(calibration).stack
        shifts = [stack.parameter_names.index(f"GapProbes.zero_shifts[{k}]") for k in range(3)]
        drifted = values.copy()
        drifted[shifts] += DRIFT * random.normal(size=3)
        first_day, later = (stack.with_parameter_values(each) for each in (values, drifted))
        return GroundTruth(name, seed, calibration, TruePosor(calibration), first_day, later)

    def random(self, step: str) -> np.random.Generator:
        """Return the random numbers of one step."""
        return RandomStream(self.seed, "campaign", self.name, step).generator()

    def true_values(self) -> dict[str, float]:
        """Return the true value of each parameter of the calibration file, the zeros after the drift."""
        values: FloatArray = self.later.parameter_values
        return {
            entry.name: float(value)
            for entry, value in zip(parameter_entries(self.as_built), values, strict=True)
            if entry is not None
        }
