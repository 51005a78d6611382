# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plain functions that the files of rows call beside the design calculators: arithmetic, and the thesis' own rules."""

from __future__ import annotations

import math
import operator
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.calibration.calibration_file import load_calibration
from posor.uncertainty.air_index import ICE_POINT
from posor.uncertainty.interferometer import ZERO, AirQuantities, Input, Interferometer, correct_reading
from posor_calibration.map_basis import doubled_grid_errors
from posor_design.contact import hertz_contact
from posor_design.interferometry import air_effects
from scipy.constants import inch
from scipy.optimize import brentq

from posor_lab.harness.rig_files import calibration_path
from posor_lab.thesis_data import amount, data_path, read_table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor.numerics.array_types import FloatArray

_DEVIATIONS = "linearization_residuals_tables_7_3_to_7_5.csv"
_FITS = "error_budget_table_7_7_diode_fits.csv"
ARITHMETIC: dict[str, Callable[..., float]] = {  # operations on a list of values, by the only key of a mapping
    "arc_sine": math.asin,
    "difference": operator.sub,
    "largest": lambda *values: max(map(abs, values)),
    "log2": math.log2,
    "log10": math.log10,
    "magnitude": abs,
    "mean": lambda *values: sum(values) / len(values),
    "power": operator.pow,
    "product": lambda *factors: reduce(operator.mul, factors),
    "ratio": operator.truediv,
    "root_sum_square": math.hypot,
    "round": round,
    "total": lambda *parts: math.fsum(parts),
}
_DIODE_LENGTH = 0.5 * inch  # length over which fifteen curves map a diode, section 7.4.2


def kelvin(celsius: float) -> float:
    """Return a temperature [K]."""
    return ICE_POINT + celsius


def count_within(values: Sequence[float], limit: float) -> int:
    """Return how many values are at most a limit."""
    return sum(value <= limit for value in values)


def place_of_largest(places: Sequence[float], values: Sequence[float]) -> float:
    """Return the place of the largest value."""
    return places[int(np.argmax(values))]


def direction(loads: Sequence[float]) -> float:
    """Return 1 if the load rises from each bearing to the next, -1 if it falls, 0 if it does both."""
    signs = set(np.sign(np.diff(loads)))
    return float(signs.pop()) if len(signs) == 1 else 0.0


def eccentricity(gap: float, clearance: float) -> float:
    """Return the eccentricity ratio of a bearing with a smallest gap."""
    return 1.0 - gap / clearance


def gaps_of_air_for(clearance: float) -> FloatArray:
    """Return the gaps of AIR.FOR's loop, from the centred bearing to a twentieth of the clearance."""
    return np.asarray(clearance / np.arange(1, 21))


def linspace_to(start: float, stop: float, num: int, limit: float) -> FloatArray:
    """Return the numbers of ``numpy.linspace`` up to a limit."""
    numbers = np.linspace(start, stop, num)
    return np.asarray(numbers[numbers <= limit])


def half_axis_coefficient(angle: float, load: float, modulus: float) -> float:
    """Return the large half axis over the cube root of 3 P / (2 E* S), appendix 6B (CONTACT.FOR).

    P: load [N], E*: contact modulus [Pa], S: sum of the curvatures; S times the cosine of the angle: their difference.
    """
    curvature_sum = 800.0
    x, y = (0.5 * curvature_sum * (1.0 + sign * math.cos(angle)) for sign in (1.0, -1.0))
    half_axis = hertz_contact(load, x, y, modulus, 0.0, modulus, 0.0).large_half_axis
    return half_axis / math.cbrt(3.0 * load / (modulus * curvature_sum))


def temperature_of_humidity_effect(humidity_change: float, effect: float) -> float:
    """Return the temperature [C] at which a change of humidity changes the index of air by ``effect``."""

    def excess(celsius: float) -> float:
        air = air_effects(0.0, 0.0, humidity_change, temperature=kelvin(celsius), relative_humidity=0.3)
        return air.humidity_effect - effect

    return float(brentq(excess, 20.0, 80.0))


def compensation_change(length: float, first: float, second: float) -> float:
    """Return the change of a length [m] if the compensation factor of an interferometer changes, section 7.2."""
    air = AirQuantities(Input(293.15), Input(101325.0), Input(0.5), Input(450e-6))
    lengths = [
        correct_reading(Interferometer(Input(632.99e-9), 1.0 / each, air, 0.0, dead_path=ZERO), length).displacement
        for each in (first, second)
    ]
    return abs(lengths[1] - lengths[0])


def ratio_of_grid_errors(curves: int) -> float:
    """Return the error of a diode's doubled grid of curves over that of the grid, on a simulated diode (8.3.3)."""
    error = []
    for count in (curves, 2 * curves - 1):
        at = np.linspace(0.0, _DIODE_LENGTH, count)
        zero = np.zeros(count)
        cubic = 1e-3 * np.cos(at / (0.3 * inch))
        shapes = np.column_stack([zero, zero + 0.3 * inch, zero, cubic])
        error.append(float(np.sqrt(np.mean(doubled_grid_errors(shapes, at, np.linspace(-0.8, 0.8, 33)) ** 2))))
    return error[1] / error[0]


def target_plane_tilts() -> list[float]:
    """Return the inclinations of the target plane about X and Z [deg], from the constants of the listings (8.3.1)."""
    sensor: Any = load_calibration(calibration_path("section84")).sensors[0]
    return [math.degrees(angle) for angle in sorted(np.abs(sensor.target_plane.tilt.array))]


def printed_table(name: str, columns: Sequence[str]) -> list[dict[str, str]]:
    """Return the printed digits of a table of the thesis."""
    return read_table(data_path(name), columns)


def printed_column(name: str, column: str, unit: str) -> tuple[float, ...]:
    """Return a column of a table of the thesis in SI units."""
    return tuple(amount(unit) * float(row[column]) for row in printed_table(name, [column]))


def probe_polynomials() -> list[tuple[float, ...]]:
    """Return gap [m] over voltage [V] of each probe, constant first (table 7.10)."""
    names = ("A0_in", "A1_in_per_V", "A2_in_per_V2", "A3_in_per_V3", "A4_in_per_V4")
    table = printed_table("probe_linearization.csv", names)
    return [tuple(inch * float(row[name]) for name in names) for row in table]


def curve_column(axis: str, column: str) -> list[float]:
    """Return a column of tables 7.3 to 7.5 for a diode's axis: fifteen curves."""
    return [float(row[column]) for row in printed_table(_DEVIATIONS, ["axis", column]) if row["axis"] == axis]


def curve_deviations() -> list[dict[str, Any]]:
    """Return table 7.7, printed and as mean, highest and lowest deviation of the curves of tables 7.3 to 7.5 [uin]."""
    printed = {row["quantity"]: row for row in printed_table(_FITS, ["quantity", "1X_uin"])}
    return [
        {
            "axis": axis,
            "statistic": name,
            "order": order,
            "printed": printed[f"{name}_order{order}"][f"{axis}_uin"],
            "deviation": float(statistic(curve_column(axis, f"order{order}_uin"))),
        }
        for axis in ("1X", "1Y", "2X")
        for name, statistic in (("mean", np.mean), ("high", np.max), ("low", np.min))
        for order in ("7", "8", "9")
    ]
