# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Requirements and layouts that several tests of the design of a POSOR share."""

from __future__ import annotations

from functools import cache
from typing import Any

from posor_design.layout_evaluation import Candidate, evaluate, extreme_poses
from posor_design.layout_geometry import LayoutKind, Shares, arrange
from posor_design.layout_search import SearchResult
from posor_design.requirement import Requirement

RING_OF_LIGHTS = LayoutKind("light_ring", 2, 4, gap_outside=True)
BUMPS = LayoutKind("bumpy_ring", 4, 4, gap_outside=True)


def content(**changes: Any) -> dict[str, Any]:
    """Return the content of a requirement file: 20 urad, 2 um, 80 mm, full turn."""
    lengths = {name: {"value": 2.0, "unit": "um"} for name in ("x", "y", "gap")}
    angles = {name: {"value": 20e-6, "unit": "rad"} for name in ("alpha", "beta", "theta")}
    return {
        "format": "posor_requirement",
        "version": 1,
        "name": "example",
        "uncertainty": {**lengths, **angles},
        "range": {
            "gap": {"value": 0.1, "unit": "mm"},
            "tilt": {"value": 1e-3, "unit": "rad"},
            "runout": {"value": 0.1, "unit": "mm"},
            "rotation": {"value": 180, "unit": "deg"},
        },
        "outside_diameter": {"value": 80, "unit": "mm"},
        "scan_rate": {"value": 1000, "unit": "Hz"},
        "speed": {"value": 1, "unit": "rad/s"},
        **changes,
    }


@cache
def example() -> Requirement:
    return Requirement.model_validate(content())


@cache
def candidate(kind: LayoutKind = RING_OF_LIGHTS) -> Candidate:
    layout = arrange(example(), kind, 0.08, Shares(1.0, 0.4))
    assert layout is not None
    return evaluate(example(), kind, layout, extreme_poses(example(), layout.gap))


def result_of(requirement: Requirement, chosen: Candidate) -> SearchResult:
    causes = {chosen.kind: ("growth of gaps",)}
    return SearchResult(requirement, chosen, (chosen,), (chosen,), chosen, 1, "electronics", causes)
