# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The tests TWIS and GEN: the formulas of 1985, from gaps and light spots to the end of the beam, and their simulation.

The formulas are those of the listings of appendix 8A. The input records of both tests are not in the scan. The
simulated motion is that of the machining centre in the printed result tables. How the readings share it is taken from
table 8.1: the plates come apart by the mean range of probes 2 and 3 in proportion to alpha, and the light spots travel
along Y in proportion to z. Zero shifts are exact: what a wrong shift does depends on the voltages at the start, which
are not printed. Inch and rad, as in the listings. All results are increments against step 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from posor_lab.replay_1985.printed_results import read_end_of_beam
from posor_lab.thesis_budgets.budget_tables import DIODE_FILE, PROBE_FILE
from posor_lab.thesis_budgets.motion_predictions import (
    READING_DISTANCE,
    READOUT,
    dimensions,
    sensor_travel,
    spots_at,
    twist_stage_alpha,
)
from posor_lab.thesis_data import data_path, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.numerics.array_types import FloatArray

    from posor_lab.replay_1985.printed_results import EndOfBeamTest

Z_LEVER = 36.1
"""Lever of theta for z [inch], as the listing of GEN shows it; the text of 8.4 has 33.4 in for both levers."""
X1, Y1, X2, Y2 = range(4)  # columns of the light spots
DRAWS = 4000
SEED = 1985
Z_SHARE = 1.822 / READING_DISTANCE  # share of the first of two readings in z of the machining centre, listing of TWIS
Y_ARM = 1.34  # lever of alpha in y of the machining centre, listing of GEN [inch]


class EndOfBeamProgram:
    """The evaluation of 1985, for many draws at once; ``sizes``: dimensions by name (inch, rad)."""

    def __init__(self, sizes: Mapping[str, float] | None = None) -> None:
        """Take the dimensions; None: those of the listings."""
        self.sizes = dimensions() if sizes is None else sizes

    def attitude(self, gaps: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return alpha and beta [rad] of gaps (..., 3), listing ALBET."""
        a, b, c = (self.sizes[name] for name in "abc")
        one, two, three = np.moveaxis(gaps, -1, 0)
        return np.arctan((two - three) / (a + b)), np.arctan((one - (two * b + three * a) / (a + b)) / c)

    def distance(self, gaps: FloatArray, x: FloatArray | float, y: FloatArray | float) -> FloatArray:
        """Return the distance between the plates at a point, listing DIST."""
        alpha, beta = self.attitude(gaps)
        return np.asarray(gaps[..., 2] + (self.sizes["b"] + y) * np.tan(alpha) - x * np.tan(beta))

    def plate_distances(self, gaps: FloatArray, spots: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distances between the plates at the spots of diodes 1 and 2."""
        h = self.sizes["h_diodes"]
        one = self.distance(gaps, h - spots[..., X1], self.sizes["g1"] - spots[..., Y1])
        two = self.distance(gaps, h - spots[..., X2], self.sizes["g2"] - spots[..., Y2])
        return one, two

    def flatness(self, theta: FloatArray) -> FloatArray:
        """Return the terms that are added to the gaps at a theta, shape (..., 3)."""
        d1, d23 = self.sizes["flatness_D1"], self.sizes["flatness_D2_D3_listing"]
        return np.asarray(np.sin(theta)[..., None] * np.array([d1, d23, -d23]))

    def ray_shifts(self, changes: tuple[FloatArray, FloatArray], theta: FloatArray) -> FloatArray:
        """Return the shifts of the spots by leaning rays when the plate distances change, shape (..., 4)."""
        one = changes[0] * self.sizes["sigma1"]
        two = changes[1] * self.sizes["sigma2"]
        spin1, spin2 = self.sizes["rho1"] + theta, self.sizes["rho2_listing"] + theta
        return np.stack([one * np.cos(spin1), -one * np.sin(spin1), two * np.cos(spin2), two * np.sin(spin2)], axis=-1)

    def heading(self, spots: FloatArray, alpha: FloatArray | float = 0.0, beta: FloatArray | float = 0.0) -> FloatArray:
        """Return the direction from spot 2 to spot 1 [rad]; theta is its change."""
        along_y = (spots[..., Y1] - spots[..., Y2] - self.sizes["dYsep"]) * np.cos(alpha)
        along_x = (spots[..., X1] - spots[..., X2] - self.sizes["dXsep"]) * np.cos(beta)
        return np.asarray(np.arctan(along_y / along_x))

    def evaluate(self, gaps: FloatArray, spots: FloatArray) -> FloatArray:
        """Return alpha, z and y at each step, shape (draws, n, 3).

        ``gaps`` are linearised readings, (draws, n, 3), ``spots`` linearised X1, Y1, X2, Y2 of the spots, (draws, n,
        4).
        """
        alpha0, beta0 = self.attitude(gaps[:, 0])
        lengths0 = self.plate_distances(gaps[:, 0], spots[:, 0])
        distance0, heading0 = self.distance(gaps[:, 0], 0.0, 0.0), self.heading(spots[:, 0])
        middle0 = -(spots[:, 0, Y1] + spots[:, 0, Y2]) / 2.0
        results = np.zeros((*gaps.shape[:2], 3))
        theta = np.zeros(len(gaps))
        for n in range(1, gaps.shape[1]):
            level = gaps[:, n] + self.flatness(theta)  # theta of the previous step
            alpha, beta = (angle - start for angle, start in zip(self.attitude(level), (alpha0, beta0), strict=True))
            lengths = self.plate_distances(level, spots[:, n])
            changes = lengths[0] - lengths0[0], lengths[1] - lengths0[1]
            corrected = spots[:, n] + self.ray_shifts(changes, theta)
            theta = self.heading(corrected, alpha, beta) - heading0
            middle = -(corrected[:, Y1] + corrected[:, Y2]) / 2.0
            results[:, n, 0] = alpha
            results[:, n, 1] = middle - middle0 - Z_LEVER * theta
            results[:, n, 2] = self.sizes["lever_endpoint"] * beta - (self.distance(level, 0.0, 0.0) - distance0)
        return results


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of the readings [inch]."""

    gaps: FloatArray  # of probes 1 to 3, random rows of table 7.12, shape (3,)
    spots: FloatArray  # of X1, Y1, X2, Y2, repeatability rows of table 7.9, shape (4,)
    readout: float = READOUT  # of each reading of the machining centre, section 8.2


@cache
def noise_of_1985() -> SensorNoise:
    """Return the noise that the budgets of chapter 7 state. Raises DataFileError: a budget cannot be read."""
    probes = read_table(data_path(PROBE_FILE), ["kind", "value"])
    diodes = read_table(data_path(DIODE_FILE), ["group", "value"])
    gaps = [float(row["value"]) for row in probes if row["kind"] == "random" and row["value"]]
    spots = [float(row["value"]) for row in diodes if row["group"] == "repeatability"]
    return SensorNoise(np.array(gaps) * 1e-6, np.array(spots) * 1e-6)


def simulated_readings(test: EndOfBeamTest, program: EndOfBeamProgram) -> tuple[FloatArray, FloatArray]:
    """Return exact gaps (n, 3) and light spots (n, 4) of a test, gaps less those of step 1.

    Raises DataFileError: a table of the thesis cannot be read.
    """
    alpha, z, y = read_end_of_beam(test).motion.T
    travel, sizes = sensor_travel(test), program.sizes
    apart = sum(travel.probes[1:]) / 2.0 * alpha / alpha[-1]
    middle = sum(travel.spots_y) / 2.0 * z / z[-1]
    beta = (y + apart) / sizes["lever_endpoint"]
    theta = -(z + middle) / Z_LEVER
    at_probes = (sizes["c"] * np.tan(beta), sizes["a"] * np.tan(alpha), -sizes["b"] * np.tan(alpha))
    level = np.column_stack([apart + lift for lift in at_probes])
    start = np.array(spots_at(test, "start"))
    spots = np.tile(start, (len(alpha), 1))
    spots[:, [Y1, Y2]] += middle[:, None]
    along_y = (spots[:, Y1] - spots[:, Y2] - sizes["dYsep"]) * np.cos(alpha)
    along_x = along_y / np.tan(program.heading(start) + theta) / np.cos(beta) + sizes["dXsep"]
    spread = (along_x - (spots[:, X1] - spots[:, X2])) / 2.0
    spots[:, X1] += spread
    spots[:, X2] -= spread
    lengths = program.plate_distances(level, spots)
    spots = spots - program.ray_shifts((lengths[0] - lengths[0][0], lengths[1] - lengths[1][0]), theta)
    return level - program.flatness(theta), spots


def simulated_errors(
    test: EndOfBeamTest,
    *,
    noise: SensorNoise | None = None,
    program: EndOfBeamProgram | None = None,
    draws: int = DRAWS,
) -> FloatArray:
    """Return errors of alpha, z and y, POSOR less machining centre, less step 1, shape (draws, n, 3).

    ``noise`` of the readings: None, that of the budgets; ``program``: None, that of the listings.

    Raises DataFileError: a table of the thesis cannot be read.
    """
    noise, program, random = noise or noise_of_1985(), program or EndOfBeamProgram(), np.random.default_rng(SEED)
    gaps, spots = simulated_readings(test, program)
    shape = draws, len(gaps)
    results = program.evaluate(
        gaps + random.normal(scale=noise.gaps, size=(*shape, 3)),
        spots + random.normal(scale=noise.spots, size=(*shape, 4)),
    )
    first, second, side = random.normal(scale=noise.readout, size=(3, *shape))
    twist = (first - second) / READING_DISTANCE
    wobble = random.normal(scale=twist_stage_alpha() if noise.readout else 0.0, size=shape)
    measured = np.stack([twist + wobble, second + Z_SHARE * (first - second), side + Y_ARM * twist], axis=-1)
    errors = results - read_end_of_beam(test).motion - measured
    return np.asarray(errors - errors[:, :1])
