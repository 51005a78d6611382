# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arranged layouts: parts do not overlap, stay within the diameters, and measure the whole range."""

from __future__ import annotations

import math

import numpy as np
import pytest
from posor_design.layout_evaluation import evaluate, random_poses
from posor_design.layout_geometry import (
    DIODE_FRAME,
    EDGE,
    PROBE_LENGTH,
    PROBE_RADIUS,
    LayoutKind,
    Shares,
    arrange,
    layout_kinds,
)

from .layout_examples import example

KINDS = layout_kinds(example().changed(range={"rotation": 0.05}))
SHARES = (Shares(1.0, 0.3), Shares(0.7, 0.6))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_parts_stay_apart_and_inside(kind: LayoutKind) -> None:
    requirement = example().changed(range={"rotation": 0.05}, inside_diameter=0.02)
    found = [arrange(requirement, kind, diameter, shares) for diameter in (0.1, 0.15) for shares in SHARES]
    layouts = [layout for layout in found if layout is not None]
    assert layouts
    for layout in layouts:
        gap = layout.probe_circle * np.exp(1j * np.array(layout.gap_azimuths))
        outer = [layout.probe_circle + PROBE_RADIUS]
        if layout.theta_sensor == "bumpy_ring":
            outer.append(layout.ring_radius + PROBE_LENGTH)
        else:
            body = math.sqrt(2.0) * (layout.ring_size + DIODE_FRAME)
            diodes = layout.ring_radius * np.exp(1j * np.array(layout.diode_azimuths))
            assert np.min(np.abs(gap[:, None] - diodes)) >= PROBE_RADIUS + body - 1e-9
            assert layout.ring_radius - body >= 0.01 + EDGE - 1e-9
            outer.append(layout.ring_radius + body)
        assert max(outer) <= 0.5 * layout.outside_diameter - EDGE + 1e-9
        assert abs(layout.probe_circle - layout.ring_radius) >= PROBE_RADIUS
        assert np.min(np.abs(gap[:, None] - gap)[~np.eye(len(gap), dtype=bool)]) >= 2.0 * PROBE_RADIUS


@pytest.mark.parametrize(
    "kind",
    [LayoutKind("light_ring", 3, 4, gap_outside=True), LayoutKind("bumpy_ring", 8, 4, gap_outside=False)],
    ids=lambda kind: kind.name,
)
@pytest.mark.parametrize("motion", [(0.05e-3, 0.0, 0.0), (0.3e-3, 5e-3, 0.3e-3)])
def test_all_sensors_read_the_whole_range(kind: LayoutKind, motion: tuple[float, float, float]) -> None:
    gap, tilt, runout = motion
    requirement = example().changed(range={"gap": gap, "tilt": tilt, "runout": runout})
    layout = arrange(requirement, kind, 0.12, Shares(1.0, 0.6))
    assert layout is not None
    poses = random_poses(requirement, layout.gap, 200, np.random.default_rng(1))
    assert evaluate(requirement, kind, layout, poses).readable


def test_no_room_and_no_range_give_no_layout() -> None:
    (kind, *_) = layout_kinds(example())
    assert arrange(example(), kind, 0.03, Shares()) is None
    assert arrange(example().changed(inside_diameter=0.07), kind, 0.08, Shares()) is None
    assert arrange(example().changed(range={"gap": 3e-3}), kind, 0.08, Shares()) is None
    assert arrange(example().changed(range={"runout": 10e-3}), kind, 0.08, Shares()) is None


def test_bumps_are_counted_only_where_the_ring_moves_less_than_a_quarter_bump_in_a_scan() -> None:
    kind = LayoutKind("bumpy_ring", 4, 4, gap_outside=False)
    layout = arrange(example(), kind, 0.08, Shares())
    assert layout is not None
    fastest = 0.25 * 2.0 * math.pi / layout.marks * example().scan_rate.number
    assert arrange(example().changed(speed=0.99 * fastest), kind, 0.08, Shares()) is not None
    assert arrange(example().changed(speed=1.01 * fastest), kind, 0.08, Shares()) is None
