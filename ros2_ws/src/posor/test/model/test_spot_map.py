# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Both kinds of diode map on the same simulated grid of stops: the one of 1985 and the smooth one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numpy.polynomial import chebyshev, polynomial
from posor.calibration.quantity import Quantity
from posor.model.diode import DIODE, SPOT_POSITION
from posor.model.spot_map import INSIDE, OUTSIDE_Y, position_of_ratios, ratios_of_positions
from posor.numerics.array_types import FloatArray
from posor.numerics.compiled import record_view
from posor.sensors.diode_map import CurvesMap, TensorMap

STOPS = 15  # by 15, as in thesis 7.4.2
ORDER = 9
SPAN = 6e-3
BOX = [[-0.95, 0.95], [-0.95, 0.95]]


def ratios(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A made-up diode: pincushion and a skew, some percent of the span."""
    u, v = x / SPAN, y / SPAN
    return 0.9 * u * (1.0 - 0.06 * v**2 - 0.04 * u**2) + 0.01 * v, 0.9 * v * (1.0 - 0.05 * u**2 - 0.03 * v**2)


def quantity(value: npt.ArrayLike, unit: str) -> Quantity:
    return Quantity(value=np.asarray(value).tolist(), unit=unit)


def curves_map() -> CurvesMap:
    """Polynomials along each line of stops, as the source fitted them."""
    at = np.linspace(-SPAN, SPAN, STOPS)
    x_curves = [polynomial.polyfit(ratios(at, np.full(STOPS, y))[0], at, ORDER) for y in at]
    y_curves = [polynomial.polyfit(ratios(np.full(STOPS, x), at)[1], at, ORDER) for x in at]
    return CurvesMap(
        kind="curves",
        domain=quantity(np.array(BOX), "1"),
        x_curves=quantity(np.array(x_curves), "m"),
        x_curves_at=quantity(at, "m"),
        y_curves=quantity(np.array(y_curves), "m"),
        y_curves_at=quantity(at, "m"),
    )


def smooth_map() -> TensorMap:
    """One least-squares fit to all stops at once."""
    at = np.linspace(-SPAN, SPAN, STOPS)
    x, y = (grid.ravel() for grid in np.meshgrid(at, at))
    u, v = ratios(x, y)
    basis = chebyshev.chebvander2d(u / BOX[0][1], v / BOX[0][1], [ORDER - 2, ORDER - 2])
    tables = [np.linalg.lstsq(basis, p, rcond=None)[0].reshape(ORDER - 1, ORDER - 1) for p in (x, y)]
    return TensorMap(
        kind="chebyshev", domain=quantity(np.array(BOX), "1"), x=quantity(tables[0], "m"), y=quantity(tables[1], "m")
    )


def diode_with(spot_map: CurvesMap | TensorMap) -> npt.NDArray[np.void]:
    diode = np.zeros(1, dtype=DIODE)
    diode["domain"][0] = spot_map.domain.array
    diode["center"][0], diode["scale"][0] = spot_map.center_and_scale
    diode["map_kind"], diode["map_lengths"][0] = spot_map.map_kind, spot_map.map_lengths
    return diode


def find_position(spot_map: CurvesMap | TensorMap, pair: npt.ArrayLike) -> tuple[int, FloatArray]:
    parameters, spot = spot_map.parameters[0], np.zeros(1, dtype=SPOT_POSITION)
    spot["ratios"][0] = pair
    work = np.zeros((2, parameters.size))
    outcome = position_of_ratios(record_view(diode_with(spot_map)), parameters, record_view(spot), work)
    return outcome, spot["position"][0]


def mapped(spot_map: CurvesMap | TensorMap, x: FloatArray, y: FloatArray) -> FloatArray:
    found = [find_position(spot_map, pair) for pair in np.column_stack(ratios(x, y))]
    assert {outcome for outcome, _ in found} == {INSIDE}
    return np.array([position for _, position in found])


def test_both_maps_hold_between_the_stops_and_the_smooth_one_is_better() -> None:
    random = np.random.default_rng(3)
    x, y = random.uniform(-0.98 * SPAN, 0.98 * SPAN, (2, 400))
    errors = {}
    for spot_map in (curves_map(), smooth_map()):
        off = mapped(spot_map, x, y) - np.column_stack([x, y])
        errors[spot_map.kind] = float(np.sqrt(np.mean(np.square(off))))
    assert errors["curves"] < 1e-6
    assert errors["chebyshev"] < 0.2 * errors["curves"]


def test_the_way_back_from_a_position_to_the_ratios() -> None:
    random = np.random.default_rng(4)
    positions = random.uniform(-0.95 * SPAN, 0.95 * SPAN, (50, 2))
    for spot_map in (curves_map(), smooth_map()):
        parameters, spots = spot_map.parameters[0], np.zeros(50, dtype=SPOT_POSITION)
        work = np.zeros((2, parameters.size))
        ratios_of_positions(record_view(diode_with(spot_map)), parameters, positions, record_view(spots), work)
        for pair, wanted in zip(spots["ratios"], positions, strict=True):
            assert np.max(np.abs(find_position(spot_map, pair)[1] - wanted)) < 1e-12


def test_beyond_the_outermost_curves_is_outside() -> None:
    outcome, position = find_position(curves_map(), [0.1, 0.93])
    assert outcome == OUTSIDE_Y
    assert position[1] > SPAN
