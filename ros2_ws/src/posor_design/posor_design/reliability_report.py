# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Minimal detectable biases and protection levels as tables and JSON."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.chain.fault_bounds import COVERAGE_FACTOR, INTEGRITY_RISK
from posor.reporting.report_table import ReportTable

if TYPE_CHECKING:
    from posor.uncertainty.protection_level import ArmReliability
    from posor.uncertainty.reliability import Reliability

AXES = ("x", "y", "z", "about X", "about Y", "about Z")  # axes of the base in the order of all arrays, (6,)
UNITS = ("µm",) * 3 + ("µrad",) * 3  # in which people read them
_SHIFT_COLUMNS = tuple(f"{axis} [{unit}]" for axis, unit in zip(AXES, UNITS, strict=True))
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
    )


def causes_table(reliability: Reliability) -> ReportTable:
    """Return the bound of each cause of faults, and the largest change of the pose that the test may miss."""
    effects = reliability.cause_effects()
    return ReportTable(
        "Causes of faults",
        ("cause", "kind", "bound", *_SHIFT_COLUMNS, "source of the bound"),
        [
            [
                cause.name,
                cause.kind,
                "unlimited" if cause.unlimited else f"{cause.bound:g} {cause.unit}",
                *map(_micro, effects[cause.name]),
                cause.source,
            ]
            for cause in reliability.hypotheses.causes
        ],
        "Largest change of the pose along and about each axis by a fault of one cause that the test of one scan misses "
        "and that does not exceed its bound (docs/integrity.md). ∞: not bounded.",
    )


def arm_table(arm: ArmReliability) -> ReportTable:
    """Return the change of the endpoint by each cause of each joint, the bound of the beams, and the level."""
    rows = [[joint, cause, *map(_micro, effect)] for joint, own in arm.effects.items() for cause, effect in own.items()]
    rows.append(["beams", "temperature", *map(_micro, arm.expansions)])
    rows.append(["all", "protection level", *map(_micro, arm.protection_level)])
    rows.append(["all", "set by", *(f"{joint}: {cause}" for joint, cause in arm.set_by)])
    angles = ", ".join(f"{name} {angle:g}" for name, angle in arm.angles.items())
    return ReportTable(
        "Protection level of the endpoint",
        ("joint", "cause", *_SHIFT_COLUMNS),
        rows,
        f"Endpoint at the angles {angles} rad, axes of the base. Protection level: the largest change by an undetected "
        "fault of one cause, the sum of the causes that are always there, the bound of the temperature of the beams, "
        f"and {COVERAGE_FACTOR:.3g} standard uncertainties (integrity risk {INTEGRITY_RISK:g} for one scan and axis). "
        "∞: not bounded.",
    )


def reliability_json(reliability: Reliability) -> dict[str, Any]:
    """Return the table by name, SI units; infinite: not detectable, not bounded."""
    return {
        "false_alarm": reliability.false_alarm,
        "missed_detection": reliability.missed_detection,
        "readings": [
            {
                "name": name,
                "redundancy_number": float(reliability.redundancy_numbers[i]),
                "minimal_detectable_bias": float(reliability.biases[i]),
                "undetected_shift": reliability.shifts[i].tolist(),
                "shift_per_metre": reliability.gains[i].tolist(),
            }
            for i, name in enumerate(reliability.names)
        ],
        "causes": {name: effect.tolist() for name, effect in reliability.cause_effects().items()},
    }


def arm_json(arm: ArmReliability) -> dict[str, Any]:
    """Return reliability and protection level of an arm by name, SI units; infinite: not bounded."""
    return {
        "angles": dict(arm.angles),
        "joints": {
            name: {
                **reliability_json(own),
                "endpoint_effects": {cause: effect.tolist() for cause, effect in arm.effects[name].items()},
            }
            for name, own in arm.joints.items()
        },
        "beam_temperature_bound": arm.expansions.tolist(),
        "protection_level": arm.protection_level.tolist(),
        "set_by": [f"{joint}: {cause}" for joint, cause in arm.set_by],
        "integrity_risk": INTEGRITY_RISK,
        "coverage_factor": COVERAGE_FACTOR,
    }


def _micro(value: float, infinite: str = "∞") -> str:
    return infinite if math.isinf(value) else f"{1e6 * value:.3g}"
