"""Supply voltage and temperature: the range in which a calibration is valid, and what they do where not measured.

A supply or temperature that is not measured deviates from the reference by an unknown amount, the same for all probes.
With the sensitivities s of the readings and the spread u of the deviation this adds ``u^2 s s'`` to the systematic
covariance of the readings (JCGM 100, F.1.2.3: effects common to several readings correlate them).
"""

from __future__ import annotations

import math
import sys
from typing import Any

from posor.numerics.compiled import in_place, inlined
from posor.numerics.vector import square

SUPPLY, TEMPERATURE = 0, 1
ANY_FINITE = (-sys.float_info.max, sys.float_info.max)
"""Range of a calibration that states none."""


@inlined
def environment_is_valid(settings: Any, scan: Any) -> bool:
    """Return whether supply and temperature are each in their range, or not measured (NaN)."""
    limits = settings.environment
    supply, temperature = scan.supply_voltage, scan.temperature
    return (math.isnan(supply) or limits[SUPPLY, 0] <= supply <= limits[SUPPLY, 1]) and (
        math.isnan(temperature) or limits[TEMPERATURE, 0] <= temperature <= limits[TEMPERATURE, 1]
    )


@inlined
def unmeasured(settings: Any, scan: Any) -> int:
    """Return which deviations are not measured and have a spread: 1 the supply, 2 the temperature, or their sum."""
    supply = math.isnan(scan.supply_voltage) and settings.spreads[SUPPLY] > 0.0
    temperature = math.isnan(scan.temperature) and settings.spreads[TEMPERATURE] > 0.0
    return (1 if supply else 0) + (2 if temperature else 0)


@in_place
def add_unmeasured(workspace: Any) -> None:
    """Add the effect of what ``workspace.unmeasured`` says to ``systematic_readings``."""
    m, by = workspace.reading_count, workspace.sensitivities
    for quantity in range(2):
        if workspace.unmeasured & 1 << quantity:
            variance = square(workspace.settings.spreads[quantity])
            for r in range(m):
                for q in range(m):
                    workspace.systematic_readings[r, q] += variance * by[r, quantity] * by[q, quantity]
