"""Both kinds of diode map on the same simulated grid of stops: the one of 1985 and the smooth one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev, polynomial
from posor_estimator.core.calibration.quantity import Quantity
from posor_estimator.core.kernels.spot_map import INSIDE, OUTSIDE_Y, ratios_of_positions, spot_position
from posor_estimator.core.sensors.spot_map import CurvesMap, TensorMap

if TYPE_CHECKING:
    import numpy.typing as npt
    from posor_estimator.core.types import FloatArray

STOPS = 15  # by 15, as in thesis 7.4.3
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
        kind="chebyshev",
        domain=quantity(np.array(BOX), "1"),
        x=quantity(tables[0], "m"),
        y=quantity(tables[1], "m"),
    )


def rooms(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return room for the derivatives with respect to the parameters and for the basis functions."""
    return np.zeros((2, parameters.size)), np.empty((4, parameters.size))


def mapped(spot_map: CurvesMap | TensorMap, x: FloatArray, y: FloatArray) -> FloatArray:
    parameters = spot_map.parameters[0]
    out, slope, room = np.empty((len(x), 2)), np.empty((2, 2)), rooms(parameters)
    for n, pair in enumerate(np.column_stack(ratios(x, y))):
        assert spot_position(spot_map.shape, spot_map.frame, parameters, pair, out[n], slope, *room) == INSIDE
    return out


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
        parameters, back = spot_map.parameters[0], np.empty((50, 2))
        ratios_of_positions(spot_map.shape, spot_map.frame, parameters, spot_map.domain.array, positions, back)
        out, slope, room = np.empty(2), np.empty((2, 2)), rooms(parameters)
        for pair, wanted in zip(back, positions, strict=True):
            spot_position(spot_map.shape, spot_map.frame, parameters, pair, out, slope, *room)
            assert np.max(np.abs(out - wanted)) < 1e-12


def test_beyond_the_outermost_curves_is_outside() -> None:
    spot_map = curves_map()
    parameters = spot_map.parameters[0]
    out, slope, room = np.empty(2), np.empty((2, 2)), rooms(parameters)
    pair = np.array([0.1, 0.93])
    outcome = spot_position(spot_map.shape, spot_map.frame, parameters, pair, out, slope, *room)
    assert outcome == OUTSIDE_Y
    assert out[1] > SPAN
