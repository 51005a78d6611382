"""Simulation of the tests TWIS and GEN: readings for the measured motion, evaluated as in 1985.

Their input records are not in the scan. The motion is that of the machining centre in the printed result tables. How
the readings share it is taken from table 8.1: the plates come apart by the mean range of probes 2 and 3 in proportion
to alpha, and the light spots travel along Y in proportion to z. Zero shifts are exact: what a wrong shift does depends
on the voltages at the start, which are not printed. Inch and rad.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from posor_lab.replay_1985.end_of_beam import X1, X2, Y1, Y2, Z_LEVER, EndOfBeamProgram
from posor_lab.replay_1985.end_of_beam_results import read_end_of_beam
from posor_lab.thesis_budgets.diode_tables import BUDGET_FILE as DIODE_FILE
from posor_lab.thesis_budgets.motion_predictions import (
    READING_DISTANCE,
    READOUT,
    sensor_travel,
    spots_at,
    twist_stage_alpha,
)
from posor_lab.thesis_budgets.probe_tables import BUDGET_FILE as PROBE_FILE
from posor_lab.thesis_budgets.probe_tables import RANDOM
from posor_lab.thesis_data import data_path, read_table

if TYPE_CHECKING:
    from posor.numerics.array_types import FloatArray

    from posor_lab.replay_1985.end_of_beam_results import EndOfBeamTest

DRAWS = 4000
SEED = 1985
Z_SHARE = 1.822 / READING_DISTANCE
"""Share of the first of two readings in z of the machining centre, listing of TWIS."""
Y_ARM = 1.34
"""Lever of alpha in y of the machining centre, listing of GEN [inch]."""


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of the readings [inch].

    Attributes:
        gaps: Of probes 1 to 3, random rows of table 7.12, shape (3,).
        spots: Of X1, Y1, X2, Y2, repeatability rows of table 7.9, shape (4,).
        readout: Of each reading of the machining centre, section 8.2.

    """

    gaps: FloatArray
    spots: FloatArray
    readout: float = READOUT


@cache
def noise_of_1985() -> SensorNoise:
    """Return the noise that the budgets of chapter 7 state.

    Raises:
        DataFileError: A budget cannot be read.

    """
    probes = read_table(data_path(PROBE_FILE), ["kind", "value"])
    diodes = read_table(data_path(DIODE_FILE), ["group", "value"])
    gaps = [float(row["value"]) for row in probes if row["kind"] == RANDOM and row["value"]]
    spots = [float(row["value"]) for row in diodes if row["group"] == "repeatability"]
    return SensorNoise(np.array(gaps) * 1e-6, np.array(spots) * 1e-6)


def simulated_readings(test: EndOfBeamTest, program: EndOfBeamProgram) -> tuple[FloatArray, FloatArray]:
    """Return exact gaps (n, 3) and light spots (n, 4) of a test, gaps less those of step 1.

    Raises:
        DataFileError: A table of the thesis cannot be read.

    """
    alpha, z, y = read_end_of_beam(test).motion.T
    travel, sizes = sensor_travel(test), program.sizes
    apart = sum(travel.probes[1:]) / 2.0 * alpha / alpha[-1]
    middle = sum(travel.spots_y) / 2.0 * z / z[-1]
    beta = (y + apart) / sizes["lever_endpoint"]
    theta = -(z + middle) / Z_LEVER
    level = np.column_stack(
        [
            apart + sizes["c"] * np.tan(beta),
            apart + sizes["a"] * np.tan(alpha),
            apart - sizes["b"] * np.tan(alpha),
        ]
    )
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
    seed: int = SEED,
) -> FloatArray:
    """Return errors of alpha, z and y, POSOR less machining centre, less step 1, shape (draws, n, 3).

    Args:
        test: The test.
        noise: Of the readings; None: that of the budgets.
        program: The evaluation; None: that of the listings.
        draws: Number of simulated runs.
        seed: Seed of the draws.

    Raises:
        DataFileError: A table of the thesis cannot be read.

    """
    noise = noise_of_1985() if noise is None else noise
    program = EndOfBeamProgram() if program is None else program
    random = np.random.default_rng(seed)
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
