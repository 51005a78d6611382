"""Minimal detectable biases and protection levels as tables and JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.reporting.report_table import ReportTable
from posor.uncertainty.protection_level import COVERAGE_FACTOR, INTEGRITY_RISK, expansion_bound

if TYPE_CHECKING:
    from collections.abc import Iterable

    from posor.uncertainty.protection_level import ArmReliability
    from posor.uncertainty.reliability import Reliability

AXES = ("x", "y", "z", "about X", "about Y", "about Z")  # axes of the base in the order of all arrays, (6,)
_UNITS = ("µm",) * 3 + ("µrad",) * 3
_SHIFT_COLUMNS = tuple(f"{axis} [{unit}]" for axis, unit in zip(AXES, _UNITS, strict=True))
NOT_DETECTABLE = "not detectable"


def reliability_table(reliability: Reliability) -> ReportTable:
    """Return the minimal detectable bias of each reading, and the change of the pose by it."""
    readings = zip(
        reliability.names,
        reliability.redundancy_numbers,
        reliability.biases,
        reliability.shifts,
        reliability.gains,
        strict=True,
    )
    return ReportTable(
        "Minimal detectable biases",
        ("reading", "redundancy number", "detectable bias [µm]", *_SHIFT_COLUMNS),
        [
            [
                name,
                f"{redundancy:.3f}",
                _micro(bias, NOT_DETECTABLE),
                *(map(_micro, shift) if math.isfinite(bias) else (f"{_micro(1e-6 * part)} per µm" for part in gain)),
            ]
            for name, redundancy, bias, shift, gain in readings
        ],
        f"Minimal detectable bias of one reading: the test of one scan (false alarms {reliability.false_alarm:.3g}) "
        f"misses it with a probability of {reliability.missed_detection:g}; beside it the change of the pose that it "
        "causes (Baarda 1968). No other reading checks one that is not detectable: its change of the pose is for 1 µm.",
        left=1,
    )


def arm_table(arm: ArmReliability) -> ReportTable:
    """Return the change of the endpoint by each reading of each joint, the bound of the beams, and the level."""
    rows = [
        [joint, name, _micro(bias, NOT_DETECTABLE), *map(_micro, shift)]
        for joint, own in arm.joints.items()
        for name, bias, shift in zip(own.names, own.biases, arm.endpoint_shifts[joint], strict=True)
    ]
    rows.append(["beams", "temperature", "", *map(_micro, expansion_bound(arm.expansions))])
    rows.append(["all", "protection level", "", *map(_micro, arm.protection_level)])
    angles = ", ".join(f"{name} {angle:g}" for name, angle in arm.angles.items())
    return ReportTable(
        "Protection level of the endpoint",
        ("joint", "reading", "detectable bias [µm]", *_SHIFT_COLUMNS),
        rows,
        f"Endpoint at the angles {angles} rad, axes of the base. Protection level: the largest change by an undetected "
        f"bias of one reading, the bound of the temperature of the measuring beams, and {COVERAGE_FACTOR:.3g} standard "
        f"uncertainties (integrity risk {INTEGRITY_RISK:g} for one scan and axis). ∞: not bounded.",
        left=2,
    )


def reliability_json(reliability: Reliability) -> dict[str, Any]:
    """Return the table by name, SI units; null: not detectable, not bounded."""
    return {
        "false_alarm": reliability.false_alarm,
        "missed_detection": reliability.missed_detection,
        "readings": [
            {
                "name": name,
                "redundancy_number": float(reliability.redundancy_numbers[i]),
                "minimal_detectable_bias": _finite([reliability.biases[i]])[0],
                "undetected_shift": _finite(reliability.shifts[i]),
                "shift_per_metre": _finite(reliability.gains[i]),
            }
            for i, name in enumerate(reliability.names)
        ],
    }


def arm_json(arm: ArmReliability) -> dict[str, Any]:
    """Return reliability and protection level of an arm by name, SI units; null: not bounded."""
    return {
        "angles": dict(arm.angles),
        "joints": {
            name: {**reliability_json(own), "endpoint_shifts": [_finite(row) for row in arm.endpoint_shifts[name]]}
            for name, own in arm.joints.items()
        },
        "beam_temperature_bound": _finite(expansion_bound(arm.expansions)),
        "protection_level": _finite(arm.protection_level),
        "integrity_risk": INTEGRITY_RISK,
        "coverage_factor": COVERAGE_FACTOR,
    }


def _micro(value: float, infinite: str = "∞") -> str:
    return infinite if math.isinf(value) else f"{1e6 * value:.3g}"


def _finite(values: Iterable[float]) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]
