"""Sensitivity of the gaps to the temperature of the plate, from a room or chamber whose temperature changes.

The target rests on a spacer, as in the cap test of the thesis (7.5.3, which names the temperature as a cause of drift).
The growth of the spacer counts as sensitivity of the probe; a spacer of a material that hardly grows avoids this.
"""

from __future__ import annotations

from posor_calibration.environment_sensitivity import Environment, make_procedure

PROCEDURE = make_procedure(
    Environment(
        procedure="temperature_sensitivity",
        summary="change of the gaps with the temperature of the plate, from a temperature that varies while the target "
        "rests",
        title="temperature of the plate",
        short_title="temperature",
        field="temperatures",
        part="temperature",
        unit="K",
        source="7.5.3",
        still=0.1,
        least_dwell=60.0,
        span=2.0,
        variation=1.0,
    )
)
