"""Sensitivity of the gaps to the supply voltage, from a supply that is varied while the target rests.

Source: thesis 7.5.3, table 7.11. Each level of the supply is a dwell.
"""

from __future__ import annotations

from functools import partial

from pydantic import Field

from posor_calibration.environment_sensitivity import Environment, EnvironmentOptions, find_sensitivity
from posor_calibration.procedure import Procedure

SUPPLY = Environment(
    procedure="supply_sensitivity",
    title="supply voltage",
    short_title="supply",
    field="supply_voltages",
    part="supply",
    unit="V",
    source="table 7.11",
)


class SupplySensitivityOptions(EnvironmentOptions):
    """Options of ``supply_sensitivity``."""

    still: float = Field(default=0.01, gt=0.0, description="the supply is constant within this [V]")
    least_dwell: float = Field(default=0.2, gt=0.0, description="shortest dwell at a level [s]")
    span: float = Field(default=0.2, gt=0.0, description="least span of the supply [V]")
    variation: float = Field(
        default=0.1, gt=0.0, description="standard uncertainty of the supply in use, for the table of its effect [V]"
    )
    reference: float | None = Field(
        default=None,
        description="supply at which the gaps are as linearised [V]; none: as calibrated, or the mean of the levels",
    )


PROCEDURE = Procedure(
    SUPPLY.procedure,
    "change of the gaps with the supply voltage, from a supply that is varied while the target rests",
    SupplySensitivityOptions,
    partial(find_sensitivity, environment=SUPPLY),
)
