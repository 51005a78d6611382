# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The POSOR of chapter 5 as a model: effect of a unit of each perturbation of its error budgets.

``budgets`` of ``03_budgets.yaml`` calls the functions of this module for tables 5.2, 5.4, 7.9 and 7.12.

Dimensions of tables 5.2 and 5.4 [inch]: probes at (-c, 0), (0, a), (0, -b) with a = b = 1.5, c = 3; light spots 3 apart
along X and up to 0.5 along Y, each 0.5 from the centre of its diode along both axes; rays 0.05 long. Each number is a
derivative of the measurement model, or its second difference where the thesis takes the square of an angle.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pinocchio as pin
from posor.calibration.calibration_file import Calibration, calibration_from
from posor.calibration.design_parts import quantity_entry
from posor.calibration.yaml_document import parse_yaml
from posor.errors import DataFileError
from posor.estimation.forward import readings_at
from posor.estimation.posor import Posor
from posor.uncertainty.budget_poses import pose_from_native, scan_at
from posor.uncertainty.budget_quantities import PlatePoint
from posor.uncertainty.first_order import sensitivities
from scipy.constants import inch

from posor_lab.thesis_data import data_path

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.numerics.array_types import FloatArray
    from posor.uncertainty.first_order import Sensitivities

Axis = Literal["x", "y", "z"]

LEVER = 1.5  # a and b [inch]
PROBE_RANGE = 0.05  # range of the probes [inch]: largest difference of two gaps, and the gap where a probe axis leans
LEG_X, LEG_Y = 3.0, 0.5  # from spot 2 to spot 1 [inch]; along Y: at most
SPOT = 0.5  # position of each spot on its diode, along both axes [inch]
RAY = 0.05  # length of the rays [inch]
STEP = 1e-3  # angle of the second differences [rad]; their relative error is of the order of its square
POINTS: Mapping[str, tuple[float, float]] = {"l_0_0": (0.0, 0.0), "l_m1_1p5": (-1.0, 1.5), "l_0_1p5": (0.0, 1.5)}
"""Points [inch] at which the distance to the plate is an output, by name."""
PROBES = ("gap probe_1", "gap probe_2", "gap probe_3")
LEVERS: Mapping[str, tuple[str, float]] = {  # tip coordinate of each lever, and its sign
    "sigma_a": ("GapProbes.tips[1,1]", 1.0),
    "sigma_b": ("GapProbes.tips[2,1]", -1.0),
    "sigma_c": ("GapProbes.tips[0,0]", -1.0),
}
_TURNS: Mapping[str, Axis] = {"Xalpha": "x", "Ybeta": "y", "Ztheta": "z"}
"""Perturbations that turn a diode, and the axis about which it turns."""
_RAYS: Mapping[str, int] = {"Xlalpha": 0, "Ylbeta": 1}
"""Perturbations that lean a ray, and the component of its direction that they change."""


@dataclass(frozen=True)
class Slopes:
    """Inclination of the plate before the probes."""

    across: float = 0.0  # gap 3 less gap 2 [inch]
    along: float = 0.0  # gap 1 less the mean of gaps 2 and 3 [inch]


class Chapter5:
    """The model and its derivatives, in the units of the thesis: inch and radian.

    Outputs are ``alpha``, ``beta``, ``theta`` and the distances of ``POINTS``.
    """

    def __init__(self, slopes: Slopes, *, c: float = 3.0, leg_y: float = LEG_Y) -> None:
        """Build the model at slopes, with a lever ``c`` of probe 1 and ``leg_y`` between the spots along Y [inch]."""
        # the model; gaps have a noise of 10 microinch, parameters have no uncertainty
        self.posor = Posor(_calibration(c, leg_y))
        leans = -math.atan(slopes.across / (2.0 * LEVER)), math.atan(slopes.along / c)
        self.pose = pose_from_native((0.0, 0.0, PROBE_RANGE * inch, *leans, 0.0))  # pose of the derivatives
        self._scan = scan_at(self.posor, self.pose)
        self._readings = self.posor.stack.reading_names
        self._parameters = self.posor.stack.parameter_names

    @cached_property
    def _sensitivities(self) -> Sensitivities:
        points = [PlatePoint(x * inch, y * inch) for x, y in POINTS.values()]
        return sensitivities(self.posor, self._scan, self.pose, points)

    @cached_property
    def _residual_jacobian(self) -> FloatArray:
        return self.posor.stack.residual_jacobian(self._scan, self.pose.rotation, self.pose.translation)

    @property
    def gaps(self) -> FloatArray:
        """The three gaps at the pose of the derivatives [inch], shape (3,)."""
        return self._readings_with_turned_axes({}, 0.0)[: len(PROBES)] / inch

    def reading_sensitivity(self, output: str, reading: str) -> float:
        """Return the effect of an inch of a reading on an output."""
        row, unit = self._output_row(output)
        return unit * float(self._sensitivities.by_reading[row, self._readings.index(reading)])

    def parameter_sensitivity(self, output: str, parameter: str) -> float:
        """Return the effect of an inch of a parameter, such as ``GapProbes.tips[0,0]``, on an output."""
        row, unit = self._output_row(output)
        return unit * float(self._sensitivities.by_parameter[row, self._parameters.index(parameter)])

    def reading_shift(self, reading: str, parameter: str) -> float:
        """Return the effect of a parameter on a reading [m per unit of the parameter]."""
        return float(self._residual_jacobian[self._readings.index(reading), self._parameters.index(parameter)])

    def quadratic_shift(self, reading: str, turned_axes: Mapping[str, Axis]) -> float:
        """Return the effect of the square of an angle on a reading [inch].

        ``turned_axes``: axes that turn, each by the first of its three parameters (``GapProbes.axes[0,0]``), and the
        axis of R about which it turns.
        """
        before, nominal, after = (self._readings_with_turned_axes(turned_axes, angle) for angle in (-STEP, 0.0, STEP))
        second = (before + after - 2.0 * nominal) / STEP**2
        return float(second[self._readings.index(reading)]) / 2.0 / inch

    def _readings_with_turned_axes(self, turned_axes: Mapping[str, Axis], angle: float) -> FloatArray:
        values = self.posor.stack.parameter_values
        for name, about in turned_axes.items():
            first = self._parameters.index(name)
            values[first : first + 3] = pin.utils.rotate(about, angle) @ values[first : first + 3]
        stack = self.posor.stack.with_parameter_values(values)
        readings: FloatArray = readings_at(stack, self.pose.rotation[None], self.pose.translation[None])[0]
        return readings

    def _output_row(self, output: str) -> tuple[int, float]:
        """Return the row of an output, and the factor that turns its derivative by metre into one by inch."""
        if output in POINTS:
            return 6 + list(POINTS).index(output), 1.0
        return [known.name for known in self._sensitivities.outputs].index(output), inch


def _calibration(c: float, leg_y: float) -> Calibration:
    """Return the model as a calibration without uncertainties: these come from the tables."""
    path = data_path("chapter5_calibration.yaml")
    content: Any = parse_yaml(path.read_text(encoding="utf-8"), str(path))[1]
    probes, diodes = content["sensors"]
    spots = ((0.5 * LEG_X, 0.5 * leg_y), (-0.5 * LEG_X, -0.5 * leg_y))
    for parts, key, points in (
        (probes["probes"], "tip", [(-c, 0.0, 0.0), (0.0, LEVER, 0.0), (0.0, -LEVER, 0.0)]),
        (diodes["diodes"], "origin", [(x - SPOT, y - SPOT, PROBE_RANGE - RAY) for x, y in spots]),
        (diodes["light_sources"], "origin", [(x, y, 0.0) for x, y in spots]),
    ):
        for part, point in zip(parts, points, strict=True):
            part[key] = quantity_entry([inch * x for x in point], "m")
    return calibration_from(content)


def root_sum_square(*parts: float) -> float:
    """Return the root of the sum of squares."""
    return float(np.linalg.norm(parts))


@cache
def model_at(across: float = 0.0, along: float = 0.0, c: float = 3.0, leg_y: float = LEG_Y) -> Chapter5:
    """Return the model at slopes of the plate; see ``Slopes`` and ``Chapter5``."""
    return Chapter5(Slopes(across, along), c=c, leg_y=leg_y)


def gap_effect(output: str, perturbation: str) -> float:
    """Return the effect of an inch of a gap on an output; the perturbation ends with the number of the probe."""
    return model_at(PROBE_RANGE, PROBE_RANGE).reading_sensitivity(output, f"gap probe_{perturbation[-1]}")


@cache
def gaps_effect(output: str, slope: float = PROBE_RANGE, c: float = 3.0) -> float:
    """Return the effect of an inch of all three gaps on an output, at both slopes, with a lever of probe 1."""
    model = model_at(slope, slope, c)
    return root_sum_square(*(model.reading_sensitivity(output, probe) for probe in PROBES))


def lever_effect(output: str, lever: str, along: float = PROBE_RANGE) -> float:
    """Return the effect of an inch of a lever on an output, at a slope along X (``Slopes.along``)."""
    parameter, sign = LEVERS[lever]
    return sign * model_at(PROBE_RANGE, along).parameter_sensitivity(output, parameter)


@cache
def lean_shift(probe: int, axis: str) -> float:
    """Return the effect of the square of the angle of a probe axis about an axis on its gap [inch], plate level."""
    about: Any = axis
    return model_at().quadratic_shift(PROBES[probe - 1], {f"GapProbes.axes[{probe - 1},0]": about})


def leans_effect(output: str, axis: str) -> float:
    """Return the effect of the square of the angles of all three probe axes on an output."""
    return root_sum_square(*(gap_effect(output, f"{probe}") * lean_shift(probe, axis) for probe in (1, 2, 3)))


@cache
def spot_shift(axis: str, perturbation: str, group: str = "axes offset") -> float:
    """Return the effect of a unit of a perturbation, or of its square, on X or Y of the spot, in inch and radian.

    ``axis``: ``X`` or ``Y``. ``perturbation``: name in tables 5.4 and 7.9, such as ``sigma_Xalpha1``; without a number:
    of diode 1. ``group``: group of the row in table 7.9. A shift affects the diode (``axes offset``), its map
    (``linearisation``) or the reading (all others). Raises DataFileError: the perturbation is unknown.
    """
    kind, model = re.sub(r"[\d_]", "", perturbation.removeprefix("sigma_")), model_at()
    k = int((re.findall(r"\d", perturbation) or ["1"])[0]) - 1
    spot, x_axis, y_axis = f"spot {axis.lower()} diode_{k + 1}", f"Diodes.x_axes[{k},0]", f"Diodes.y_axes[{k},0]"
    if kind in _RAYS:
        return abs(model.reading_shift(spot, f"Diodes.source_directions[{k},{_RAYS[kind]}]") / inch)
    if kind in _TURNS:
        return model.quadratic_shift(spot, {x_axis: _TURNS[kind], y_axis: _TURNS[kind]})
    if kind == "Zgamma":  # each axis out of square to the other
        return root_sum_square(*(model.quadratic_shift(spot, {turned: "z"}) for turned in (x_axis, y_axis)))
    if kind not in {"X", "Y"}:
        raise DataFileError(f"perturbation 'sigma_{kind}' is unknown", expected="one of table 5.4")
    component = "XY".index(kind)
    if group == "axes offset":
        return abs(model.reading_shift(spot, f"Diodes.origins[{k},{component}]"))
    if group == "linearisation":
        return abs(model.reading_shift(spot, f"Diodes.maps[{k},{4 * component}]"))
    return float(axis == kind)


@cache
def theta_factor(axis: str) -> float:
    """Return the effect of an inch of X or Y of a spot on theta [rad].

    Each effect is taken where it is largest: X with the spots 0.5 in apart along Y, Y with the spots level.
    """
    model = model_at() if axis == "X" else model_at(leg_y=0.0)
    return abs(model.reading_sensitivity("theta", f"spot {axis.lower()} diode_1"))


def theta_effect(perturbation: str, group: str, by_x: float, by_y: float) -> float:
    """Return the effect of a perturbation of table 7.9 on theta by the effects of X and Y of a spot on theta."""
    return root_sum_square(by_x * spot_shift("X", perturbation, group), by_y * spot_shift("Y", perturbation, group))
