"""The design calculators that ``posor design`` offers.

A calculator is a function. Each argument has a type of ``units.py``, or is a tuple of them; an argument with a default
may be left out. The result is a frozen dataclass with fields of the same types. The first line of the docstring is the
summary, and a line that begins with ``Source:`` names the equation or the section.

A calculator refuses what it cannot compute, such as a length of 1e30 in: ``load_calculator`` is the place of this rule.
"""

from __future__ import annotations

import math
from functools import cache, wraps
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.errors import ParameterError, PosorError

if TYPE_CHECKING:
    from collections.abc import Callable

_FUNCTIONS: dict[str, tuple[str, ...]] = {
    "air_bearing": ("aerostatic_bearing",),
    "ball_bearings": ("ball_load", "bearing_scaling", "bearing_friction"),
    "calibration_geometry": ("axis_offsets", "light_source_angles", "probe_spacing"),
    "contact": ("hertz_contact", "ball_race_contact"),
    "distance_sensors": ("fibre_lever", "capacitance_probe", "probe_area", "linearity"),
    "error_chain": ("endpoint_error", "position_bits", "straight_linkage"),
    "gimbals": ("gimbal_motion", "gimbal_torques", "wire_gimbal", "shortest_wires"),
    "inertial_sensors": ("inertial_limits", "inertial_drift", "fibre_gyroscope"),
    "interferometry": ("air_effects", "straightness_optics"),
    "joint_loads": ("joint_moment", "bearing_pair", "gear_drive", "chain_drive"),
    "machine_metrology": (
        "straightness",
        "straightness_runs",
        "alignment",
        "abbe_error",
        "thermal_growth",
        "probe_zero",
    ),
    "measuring_beams": ("beam_frequencies", "beam_sag", "sag_correction"),
    "sensor_noise": ("diode_noise", "converter_resolution", "angle_resolution"),
    "structures": ("cantilever_beam", "cantilever_for_stress", "cantilever_for_stiffness", "cantilever_frequencies"),
    "torsion": ("beam_torsion", "disc_inertia", "shaft_stress"),
    "yoke_gimbals": ("yoke_friction", "dither_acceleration"),
}
"""Names of the calculators by module."""

CALCULATORS = {
    function.replace("_", "-"): (module, function) for module, names in _FUNCTIONS.items() for function in names
}
"""Module and function of each calculator by the name that ``posor design`` gives it."""


@cache
def load_calculator(name: str) -> Callable[..., Any]:
    """Import the function of a calculator; it raises a ParameterError where its numbers exceed the floating point."""
    module, function = CALCULATORS[name]
    calculate: Callable[..., Any] = getattr(import_module(f"posor_design.{module}"), function)

    @wraps(calculate)
    def checked(*arguments: Any, **named: Any) -> Any:
        try:
            with np.errstate(over="raise", divide="raise", invalid="raise"):
                result = calculate(*arguments, **named)
        except PosorError:
            raise
        # A ValueError: math, numpy.linalg and scipy.optimize report by it that a number or a matrix is degenerate.
        except (ArithmeticError, ValueError) as error:
            raise _no_solution(name) from error
        if not all(map(_is_finite, vars(result).values())):
            raise _no_solution(name)
        return result

    return checked


def _no_solution(name: str) -> ParameterError:
    return ParameterError(
        "no solution for these arguments",
        where=f"design {name}",
        expected="quantities of a usual size; check the units",
    )


def _is_finite(value: Any) -> bool:
    """Return whether all numbers of a field are finite."""
    if isinstance(value, tuple):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)
