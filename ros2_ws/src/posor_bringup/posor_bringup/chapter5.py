"""The POSOR of chapter 5 as a model: what a unit of each perturbation of its error budgets does.

Dimensions as in tables 5.2 and 5.4: probes at (-c, 0), (0, a), (0, -b) with a = b = 1.5, c = 3 in; the light spots 3 in
apart along X and up to .5 in along Y, each .5 in from its diode's centre along both axes, the rays .05 in long. Every
number is a derivative of the measurement model, or a second difference of it where the thesis takes the square of an
angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
import pinocchio as pin
from posor_estimator.core.budget.first_order import sensitivities
from posor_estimator.core.budget.outputs import PlatePoint
from posor_estimator.core.budget.poses import pose_of_native, scan_at
from posor_estimator.core.calibration.model import Calibration, calibration_from
from posor_estimator.core.design_parts import INCH, Part, quantity
from posor_estimator.core.forward import readings_at
from posor_estimator.core.posor import Posor

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.budget.first_order import Sensitivities
    from posor_estimator.core.types import FloatArray

Axis = Literal["x", "y", "z"]

LEVER = 1.5
"""a and b [inch]."""
PROBE_RANGE = 0.05
"""Range of the probes [inch]: the largest difference of two gaps, and the gap itself where a probe axis leans."""
LEG_X, LEG_Y = 3.0, 0.5
"""From spot 2 to spot 1 [inch], along Y at most."""
SPOT = 0.5
"""Of each spot on its diode, along both axes [inch]."""
RAY = 0.05
"""Length of the rays [inch]."""
STEP = 1e-3
"""Angle of the second differences [rad]; they are exact to its square."""
POINTS: Mapping[str, tuple[float, float]] = {"l_0_0": (0.0, 0.0), "l_m1_1p5": (-1.0, 1.5), "l_0_1p5": (0.0, 1.5)}
"""Where the distance to the plate is judged [inch], by name."""
PROBES = ("gap probe_1", "gap probe_2", "gap probe_3")


@dataclass(frozen=True)
class Slopes:
    """How the plate leans before the probes.

    Attributes:
        across: Gap 3 less gap 2 [inch].
        along: Gap 1 less the mean of gaps 2 and 3 [inch].

    """

    across: float = 0.0
    along: float = 0.0


class Chapter5:
    """The model and its derivatives, in the units of the thesis: inch and radian.

    Judged quantities are ``alpha``, ``beta``, ``theta`` and the distances of ``POINTS``.

    Attributes:
        posor: The model; its readings have noise, 10 microinch of a gap, its parameters no uncertainty.
        pose: Where the derivatives are taken.

    """

    def __init__(self, slopes: Slopes, *, c: float = 3.0, leg_y: float = LEG_Y) -> None:
        """Build the model.

        Args:
            slopes: Where the derivatives are taken.
            c: Lever of probe 1 [inch].
            leg_y: From spot 2 to spot 1 along Y [inch].

        """
        self.posor = Posor(_calibration(c, leg_y))
        leans = -math.atan(slopes.across / (2.0 * LEVER)), math.atan(slopes.along / c)
        self.pose = pose_of_native((0.0, 0.0, PROBE_RANGE * INCH, *leans, 0.0))
        self._scan = scan_at(self.posor, self.pose)
        self._readings = self.posor.stack.reading_names
        self._parameters = self.posor.stack.parameter_names

    @cached_property
    def _found(self) -> Sensitivities:
        points = [PlatePoint(x * INCH, y * INCH) for x, y in POINTS.values()]
        return sensitivities(self.posor, self._scan, self.pose, points)

    @cached_property
    def _shifts(self) -> FloatArray:
        return self.posor.stack.residual_jacobian(self._scan, self.pose.rotation, self.pose.translation)

    @property
    def gaps(self) -> FloatArray:
        """The three gaps where the derivatives are taken [inch], shape (3,)."""
        return self._read({}, 0.0)[: len(PROBES)] / INCH

    def by_reading(self, judged: str, reading: str) -> float:
        """Return what an inch of a reading does to a judged quantity."""
        row, by_inch = self._place(judged)
        return by_inch * float(self._found.by_reading[row, self._readings.index(reading)])

    def by_parameter(self, judged: str, parameter: str) -> float:
        """Return what an inch of a parameter, such as ``GapProbes.tips[0,0]``, does to a judged quantity."""
        row, by_inch = self._place(judged)
        return by_inch * float(self._found.by_parameter[row, self._parameters.index(parameter)])

    def shift(self, reading: str, parameter: str) -> float:
        """Return what a parameter does to a reading, metre by metre or inch by inch alike."""
        return float(self._shifts[self._readings.index(reading), self._parameters.index(parameter)])

    def shift_by_angle(self, reading: str, parameter: str) -> float:
        """Return what a radian of a direction's component does to a reading [inch]."""
        return self.shift(reading, parameter) / INCH

    def shift_by_square(self, reading: str, turned: Mapping[str, Axis]) -> float:
        """Return what the square of an angle does to a reading [inch].

        Args:
            reading: The reading.
            turned: Which axes turn, each by the first parameter of its three (``GapProbes.axes[0,0]``), and about
                which axis of R.

        """
        before, still, after = (self._read(turned, angle) for angle in (-STEP, 0.0, STEP))
        second = (before + after - 2.0 * still) / STEP**2
        return float(second[self._readings.index(reading)]) / 2.0 / INCH

    def _read(self, turned: Mapping[str, Axis], angle: float) -> FloatArray:
        values = self.posor.stack.parameter_values
        for name, about in turned.items():
            at = self._parameters.index(name)
            values[at : at + 3] = pin.utils.rotate(about, angle) @ values[at : at + 3]
        stack = self.posor.stack.with_parameter_values(values)
        readings: FloatArray = readings_at(stack, self.pose.rotation[None], self.pose.translation[None])[0]
        return readings

    def _place(self, judged: str) -> tuple[int, float]:
        """Return a judged quantity's row, and by what its derivative by metre becomes one by inch."""
        if judged in POINTS:
            return 6 + list(POINTS).index(judged), 1.0
        return [output.name for output in self._found.outputs].index(judged), INCH


def _calibration(c: float, leg_y: float) -> Calibration:
    """Return the model as a calibration; its uncertainties play no part, the tables bring their own."""
    tips = ((-c, 0.0), (0.0, LEVER), (0.0, -LEVER))
    spots = ((0.5 * LEG_X, 0.5 * leg_y), (-0.5 * LEG_X, -0.5 * leg_y))
    flat = quantity([[-0.9, 0.9], [-0.9, 0.9]], "1")
    spot_map = {
        "kind": "polynomial",
        "center": quantity([0.0, 0.0], "1"),
        "domain": flat,
        "x": quantity([[0.0, 0.0], [INCH, 0.0]], "m"),
        "y": quantity([[0.0, INCH], [0.0, 0.0]], "m"),
    }
    probes: list[Part] = [
        {
            "name": f"probe_{i + 1}",
            "tip": quantity([x * INCH, y * INCH, 0.0], "m"),
            "axis": quantity([0.0, 0.0, 1.0], "1"),
            "volts_to_gap": quantity([0.0, 0.01 * INCH], "m/V^k"),
            "zero_shift": quantity(0.0, "V"),
            "noise": quantity(1e-3, "V"),
            "range": quantity([-5.0, 25.0], "V"),
        }
        for i, (x, y) in enumerate(tips)
    ]
    diodes: list[Part] = [
        {
            "name": f"diode_{i + 1}",
            "origin": quantity([(x - SPOT) * INCH, (y - SPOT) * INCH, (PROBE_RANGE - RAY) * INCH], "m"),
            "x_axis": quantity([1.0, 0.0, 0.0], "1"),
            "y_axis": quantity([0.0, 1.0, 0.0], "1"),
            "noise": quantity([1e-4, 1e-4], "1"),
            "minimum_sum": quantity(2e-5, "A"),
        }
        for i, (x, y) in enumerate(spots)
    ]
    sources: list[Part] = [
        {
            "name": f"source_{i + 1}",
            "origin": quantity([x * INCH, y * INCH, 0.0], "m"),
            "direction": quantity([0.0, 0.0, -1.0], "1"),
        }
        for i, (x, y) in enumerate(spots)
    ]
    return calibration_from(
        {
            "format": "posor_calibration",
            "version": 1,
            "name": "chapter 5",
            "provenance": {"source": "thesis, tables 5.2 and 5.4", "method": "nominal dimensions", "date": "1985"},
            "frames": {"parent": "receiving", "child": "target"},
            "sensors": [
                {
                    "type": "gap_probes",
                    "target_plane": {"point": quantity([0.0, 0.0, 0.0], "m"), "tilt": quantity([0.0, 0.0], "rad")},
                    "probes": probes,
                },
                {
                    "type": "diodes",
                    "diodes": diodes,
                    "light_sources": sources,
                    "map": "flat",
                    "maps": {"flat": [spot_map, spot_map]},
                },
            ],
        }
    )


def root_sum_square(*parts: float) -> float:
    """Return the root of the sum of squares."""
    return float(np.linalg.norm(parts))
