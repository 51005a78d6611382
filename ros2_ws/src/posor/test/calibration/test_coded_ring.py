# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Light rings whose sources are spaced so that the lit ones are known: a slip contradicts the distance of the spots."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from posor.calibration.design_parts import coded_azimuths, slip_margins
from posor.calibration.designs import STANDOFF, design, sized_design
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.model.fault import Fault, State
from posor.model.native_coordinates import rotation_from_native
from posor.model.scan import Scans

INCH = 0.0254
RUNOUT = 0.5e-3
DIAMETERS_IN = (3.0, 4.0, 5.0, 6.0, 8.0, 10.5)
SIGMAS = 12.0
"""Least contradiction of a slip by the same number on both diodes, in standard uncertainties of the spots' distance."""


def ring(diameter_in: float | None) -> Posor:
    if diameter_in is None:
        return Posor(design("quad_light_ring"))
    frames = ("receiving", "target")
    return Posor(sized_design("quad_light_ring", diameter_in * INCH, frames=frames, title="ring"))


def one_scan_of_each_pair(posor: Posor) -> Scans:
    """Return a scan without noise of each pair of sources that is lit during one turn at a runout in any direction."""
    thetas, around = np.linspace(-math.pi, math.pi, 720, endpoint=False), 2.4 * np.arange(720)
    rotations = np.array([rotation_from_native(0.0, 0.0, theta) for theta in thetas])
    translations = np.column_stack([RUNOUT * np.cos(around), RUNOUT * np.sin(around), np.full(720, STANDOFF)])
    scans = scans_at(posor.stack, rotations, translations, np.arange(1, 721))
    assert np.isfinite(scans.diode_currents).all(), "a diode without a light source"
    _, firsts = np.unique(scans.lit_sources, axis=0, return_index=True)
    return Scans.of([scans[n] for n in firsts])


def slipped(posor: Posor, scans: Scans, slips: tuple[int, int]) -> Scans:
    sources = len(posor.calibration.sensors[1].model_dump()["light_sources"])
    return scans.with_fields({"lit_sources": (scans.lit_sources + np.array(slips)) % sources})


@pytest.mark.parametrize("diameter_in", [None, *DIAMETERS_IN])
def test_a_source_is_on_each_diode_at_every_theta_and_names_itself(diameter_in: float | None) -> None:
    posor = ring(diameter_in)
    assert np.all(posor.estimate_each(one_scan_of_each_pair(posor)).states == State.OK)


def source_distances(posor: Posor) -> tuple[np.ndarray, float]:
    """Return the distance of each two sources where their rays meet the diodes, and its standard uncertainty [m]."""
    content = posor.calibration.sensors[1].model_dump()
    origins, directions = (
        np.array([source[key]["value"] for source in content["light_sources"]]) for key in ("origin", "direction")
    )
    diode, depth = content["diodes"][0], 0.4e-3 + STANDOFF + 2e-3
    spots = (origins - directions * (depth / directions[:, 2:]))[:, :2]
    spot_map = content["maps"]["factory"][0]
    variances = (
        content["light_sources"][0]["origin"]["sigma"][0] ** 2,
        diode["origin"]["sigma"][0] ** 2,
        2.0 * np.max(spot_map["x"]["sigma"]) ** 2,
        (spot_map["x"]["value"][1][0] * diode["noise"]["value"][0]) ** 2,
    )
    return np.linalg.norm(spots[:, None] - spots, axis=2), math.sqrt(2.0 * sum(variances))


@pytest.mark.parametrize("diameter_in", [None, *DIAMETERS_IN])
def test_every_pair_has_a_distance_of_its_own_among_equal_slips(diameter_in: float | None) -> None:
    posor = ring(diameter_in)
    distances, sigma = source_distances(posor)
    count = len(distances)
    slips = np.arange(1, count)
    for first, second in one_scan_of_each_pair(posor).lit_sources.tolist():
        others = distances[(first + slips) % count, (second + slips) % count]
        assert np.abs(others - distances[first, second]).min() > SIGMAS * sigma


def test_slips_from_the_first_scan_on_are_lost_whatever_their_number() -> None:
    posor = ring(4.0)
    scans = one_scan_of_each_pair(posor)
    for slip in range(1, len(coded_azimuths(24))):
        for slips in ((slip, slip), (slip, 0), (0, slip)):
            found = posor.estimate_each(slipped(posor, scans.part(slip % 4, len(scans)), slips))
            assert np.all(found.states == State.LOST), slips
            assert np.all(found.faults & (Fault.RESIDUAL | Fault.NOT_CONVERGED | Fault.ILL_CONDITIONED)), slips


def test_margins_are_those_of_the_closest_angles() -> None:
    azimuths = (
        0.0,
        1.0,
        2.2,
        4.1,
    )  # the two sources two apart: 2.2, 3.1, 4.08, 3.18; next to each other: 2.18 and less
    rest = 2.0 * math.pi - 4.1
    assert slip_margins(azimuths) == pytest.approx((rest + 1.0 - 3.1, 2.2 - rest))
    even = tuple(2.0 * math.pi * i / 24 for i in range(24))
    assert slip_margins(even) == pytest.approx((0.0, 0.0), abs=1e-12)


def test_the_pitch_grows_steadily() -> None:
    for sources in (12, 36, 64):
        pitches = [later - earlier for earlier, later in pairwise(coded_azimuths(sources))]
        assert pitches == sorted(pitches)
        assert pitches[-1] < 1.19 * 2.0 * math.pi / sources
        assert pitches[0] > 0.81 * 2.0 * math.pi / sources
