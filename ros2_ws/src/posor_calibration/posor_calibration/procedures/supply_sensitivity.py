"""Sensitivity of the gaps to the supply voltage, from a supply that is varied while the target rests.

Source: thesis 7.5.3, table 7.11. Each level of the supply is a dwell.
"""

from __future__ import annotations

from posor_calibration.environment_sensitivity import Environment, make_procedure

PROCEDURE = make_procedure(
    Environment(
        procedure="supply_sensitivity",
        summary="change of the gaps with the supply voltage, from a supply that is varied while the target rests",
        title="supply voltage",
        short_title="supply",
        field="supply_voltages",
        part="supply",
        unit="V",
        source="table 7.11",
        still=0.01,
        least_dwell=0.2,
        span=0.2,
        variation=0.1,
    )
)
