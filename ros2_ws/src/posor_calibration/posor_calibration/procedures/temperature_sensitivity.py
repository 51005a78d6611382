"""Sensitivity of the gaps to the temperature of the plate, from a room or chamber whose temperature changes.

The target rests on a spacer, as in the cap test of the thesis (7.5.3, which names the temperature as a cause of drift).
What the spacer grows by counts as sensitivity of the probe; a spacer of a material that hardly grows avoids this.
"""

from __future__ import annotations

from functools import partial

from pydantic import Field

from posor_calibration.environment_sensitivity import Environment, EnvironmentOptions, find_sensitivity
from posor_calibration.procedure import Procedure

TEMPERATURE = Environment(
    procedure="temperature_sensitivity",
    title="temperature of the plate",
    short_title="temperature",
    field="temperatures",
    part="temperature",
    unit="K",
    source="7.5.3",
)


class TemperatureSensitivityOptions(EnvironmentOptions):
    """Options of ``temperature_sensitivity``."""

    still: float = Field(default=0.1, gt=0.0, description="the temperature is constant within this [K]")
    least_dwell: float = Field(default=60.0, gt=0.0, description="shortest dwell at a level [s]")
    span: float = Field(default=2.0, gt=0.0, description="least span of the temperature [K]")
    variation: float = Field(
        default=1.0,
        gt=0.0,
        description="standard uncertainty of the temperature in use, for the table of its effect [K]",
    )
    reference: float | None = Field(
        default=None,
        description="temperature at which the gaps are as linearised [K]; none: as calibrated, or the mean of the "
        "levels",
    )


PROCEDURE = Procedure(
    TEMPERATURE.procedure,
    "change of the gaps with the temperature of the plate, from a temperature that varies while the target rests",
    TemperatureSensitivityOptions,
    partial(find_sensitivity, environment=TEMPERATURE),
)
