"""The design calculators that ``posor design`` offers.

A calculator is a function. Each argument has a type of ``units.py``, or is a tuple of them; an argument with a default
may be left out. The result is a frozen dataclass with fields of the same types. The first line of the docstring is the
summary, and a line that begins with ``Source:`` names the equation or the section.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

_FUNCTIONS: dict[str, tuple[str, ...]] = {
    "air_bearing": (),
    "calibration_geometry": ("axis_offsets", "light_source_angles", "probe_spacing"),
    "contact": (),
    "distance_sensors": ("fibre_lever", "capacitance_probe", "probe_area", "linearity"),
    "gimbals": (),
    "interferometry": ("air_effects", "straightness_optics"),
    "machine_metrology": (
        "straightness",
        "straightness_runs",
        "alignment",
        "abbe_error",
        "thermal_growth",
        "probe_zero",
    ),
    "measuring_beams": (),
    "sensor_noise": ("diode_noise", "converter_resolution", "angle_resolution"),
    "structures": (),
}
"""Names of the calculators by module."""

CALCULATORS = {
    function.replace("_", "-"): (module, function) for module, names in _FUNCTIONS.items() for function in names
}
"""Module and function of each calculator by the name that ``posor design`` gives it."""


def load_calculator(name: str) -> Callable[..., Any]:
    """Import the function of a calculator."""
    module, function = CALCULATORS[name]
    loaded: Callable[..., Any] = getattr(import_module(f"posor_estimator.design.{module}"), function)
    return loaded
