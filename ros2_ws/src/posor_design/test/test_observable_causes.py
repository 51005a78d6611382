# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Causes that readings show: what each part of a design adds, at every theta."""

from __future__ import annotations

import pytest
from posor.calibration.calibration_file import calibration_from
from posor.calibration.designs import SizedDesignName, sized_design
from posor_design.observable_causes import unobservable_causes
from posor_design.requirement import LEAST_TARGET_TILT

ALWAYS = {"growth of gaps", "wedge of gaps"}  # equal to a motion of the target
GAPS = {f"reading: gap gap_{n}" for n in (1, 2, 3)}
RINGS = {f"reading: ring ring_{n}" for n in (1, 2, 3, 4)}
SPOTS = {f"light spot: diode_{n}" for n in (1, 2)}
GAIN = {"gain of the converter"}
EXPECTED: dict[SizedDesignName, set[str]] = {
    "triad_light_ring": ALWAYS | GAIN | GAPS | SPOTS,
    "quad_light_ring": ALWAYS | GAIN | SPOTS,
    "checked_light_ring": ALWAYS,
    "triad_bumpy_ring": ALWAYS | GAIN | GAPS | RINGS,
    "quad_bumpy_ring": ALWAYS | GAIN | RINGS,
    "checked_bumpy_ring": ALWAYS,
}


@pytest.mark.parametrize("name", EXPECTED)
def test_each_part_of_a_design_makes_causes_observable(name: SizedDesignName) -> None:
    calibration = sized_design(name, 0.2032, frames=("receiving", "target"), title=name)
    assert set(unobservable_causes(calibration)) == EXPECTED[name]


def test_a_small_tilt_of_the_target_hides_exchanged_gap_probes() -> None:
    content = sized_design("checked_light_ring", 0.1, frames=("receiving", "target"), title="x").model_dump(mode="json")
    for share, found in ((0.99, {*ALWAYS, "exchanged plugs of gap probes"}), (1.01, ALWAYS)):
        content["sensors"][0]["target_plane"]["tilt"]["value"] = [share * LEAST_TARGET_TILT, 0.0]
        assert set(unobservable_causes(calibration_from(content))) == found
