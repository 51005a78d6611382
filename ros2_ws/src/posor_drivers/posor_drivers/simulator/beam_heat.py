# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Temperatures of the measuring beams of a simulated arm, and what their thermometers read.

A beam has the temperature that the scenario states, or a constant one that is drawn within the spread and the shared
terms of the beams file. Its gradients, the errors of its coefficient of expansion and of its thermometer are drawn
once, within the uncertainties of the beams file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.chain.beam_entries import GradientFile
from posor.errors import CalibrationError, similar_name
from scipy.spatial.transform import Rotation

from posor_drivers.simulator.imperfections import RandomStream, shared_errors

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.chain.beam_entries import TemperatureFile
    from posor.chain.kinematic_chain import Chain
    from posor.chain.measuring_beam import MeasuringBeam
    from posor.numerics.array_types import FloatArray

    from posor_drivers.simulator.imperfections import Imperfections
    from posor_drivers.simulator.scenario import Scenario
    from posor_drivers.simulator.truth_model import TrueLink


@dataclass(frozen=True)
class BeamHeat:
    """Temperature of one beam at n ticks, from that at which the URDF holds."""

    means: FloatArray  # of the whole beam [K], (n,)
    across: FloatArray  # differences between opposite sides in two directions across the beam [K], (2,)
    excess: float  # relative error of the stated coefficient of expansion
    readings: FloatArray  # of the thermometer [K], (n,)

    def ends(self, beam: MeasuringBeam, true_link: TrueLink | None) -> tuple[FloatArray, FloatArray]:
        """Return the end of the beam without sag, in its start, (n, 3, 3), (n, 3) [m]; None: by ``beam``."""
        if true_link is not None:
            return true_link.warm_ends(self.means, self.across, self.excess)
        temperature, span = beam.entry.temperature, beam.T_start_end.translation
        strains = 0.0 if temperature is None else temperature.coefficient.number * (1.0 + self.excess) * self.means
        bend = (1.0 + self.excess) * sum(
            kelvin * effect for kelvin, effect in zip(self.across, beam.bends_per_kelvin(), strict=False)
        )
        shift, turn = np.split(np.zeros(6) + bend, 2)
        rotation = Rotation.from_rotvec(turn).as_matrix() @ beam.T_start_end.rotation
        count = len(self.means)
        return np.tile(rotation, (count, 1, 1)), np.multiply.outer(np.ones(count) + strains, span) + shift


def beam_heats(
    scenario: Scenario, chain: Chain, shares: FloatArray, imperfections: Imperfections, source: str
) -> dict[str, BeamHeat]:
    """Return the temperatures of the beams that have one, by name, at shares of a cycle (n,).

    ``source``: name of the scenario in errors. Raises CalibrationError: the scenario states the temperature of a beam
    without ``temperature`` in the beams file.
    """
    warm = {beam.name: beam for beam in chain.beams if beam.entry.temperature is not None}
    for name in scenario.temperatures:
        if name not in warm:
            expected = similar_name(name, warm, "a beam with 'temperature' in the beams file")
            where = f"{source}, key temperatures"
            raise CalibrationError(f"there is no temperature of a beam '{name}'", where=where, expected=expected)
    if not imperfections.temperature:
        return {}
    common = dict(zip(chain.shared, shared_errors(scenario.seed, chain.shared), strict=True))
    heats = {}
    for name, beam in warm.items():
        own, stated = beam.entry.temperature, scenario.temperatures.get(name)
        terms = [beam.shared_change(term, "temperature") for term in common]
        if own is not None and (stated or own.spread or own.gradient or any(terms)):
            deviations = None if stated is None else stated.deviations(shares)
            heats[name] = _drawn_heat(beam, own, deviations, common, scenario.seed, len(shares))
    return heats


def _drawn_heat(
    beam: MeasuringBeam,
    own: TemperatureFile,
    deviations: FloatArray | None,
    common: Mapping[str, float],
    seed: int,
    count: int,
) -> BeamHeat:
    """Return the temperature of a beam at ``count`` ticks; ``common``: errors of shared terms."""
    random = RandomStream(seed, "temperature", beam.name).generator()
    spread, along, across, across_too, reading, excess = random.normal(size=6)

    def shared(quantity: str) -> float:
        return sum(value * beam.shared_change(term, quantity) for term, value in common.items())

    if deviations is None:
        deviations = np.full(count, (own.spread.number if own.spread else 0.0) * spread + shared("temperature"))
    gradient, thermometer, coefficient = own.gradient or GradientFile(), own.thermometer, own.coefficient
    uncertainty = 0.0 if thermometer is None else thermometer.uncertainty.number
    return BeamHeat(
        means=deviations + gradient.along.number * along,
        across=gradient.across.number * np.array([across, across_too]),
        excess=excess * float(coefficient.sigmas) / (coefficient.number or 1.0) + shared("coefficient"),
        readings=deviations + uncertainty * reading + shared("thermometer"),
    )
