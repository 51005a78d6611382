# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Offset and rotation of the diodes against one another, from one light source.

A stage carries the same source over all diodes. Each diode sees it over its own field, and the stage tells how far the
fields are apart and how they are rotated. The first diode keeps its origin and its x axis, to which rotations refer;
zero and heading of the stage are fitted along. The stage counts as square. Source: thesis 7.4.4, equations 7.2 to 7.4,
where two positions of the light gave the offset; here any number of dwells, by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from posor.bags.recording import POINT
from posor.calibration.calibration_file import find_sensor
from posor.errors import FitError
from posor.sensors.diodes import DiodesCalibration
from pydantic import Field

from posor_calibration.calibration_parameters import FixedParameters, parameter_indices
from posor_calibration.diode_spots import (
    DwellSpots,
    SingleDiode,
    StageOptions,
    check_spot_motion,
    find_dwell_spots,
    vector_parameters,
)
from posor_calibration.fit_report import check_spread, describe_fit, enlarge_if_improbable, result_tables
from posor_calibration.least_squares import Fit, fit_parameters
from posor_calibration.procedure import Outcome, Procedure, Replacement, Table

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

NAME = "diode_axes"
MIN_DIODES = 2
SENSOR_NAMES = {"origin": "origins", "x_axis": "x_axes", "y_axis": "y_axes"}
"""Vectors of a diode: key in the file, and name among the sensor's parameters."""
ACROSS = 0.5  # components of a rotation axis' cross product above this lie across the rotated axis


class DiodeAxesOptions(StageOptions):
    """Options of ``diode_axes``."""

    reference: str = Field(default="", description="topic of the stage's point, axes near R's; empty: the only one")
    direction: Literal[1, -1] = Field(
        default=1, description="1: the reference moves as the light does; -1: as the diodes under the light"
    )
    expected_offset: float = Field(default=1e-4, gt=0.0, description="prior standard uncertainty of the offset [m]")
    expected_turn: float = Field(default=5e-3, gt=0.0, description="prior standard uncertainty of the axes [rad]")


class _Model:
    """Predicts spots from the unknowns: stage x, y, heading; y axis of the first diode; x, y, axes of the others."""

    def __init__(self, spots: DwellSpots, part: DiodesCalibration, options: DiodeAxesOptions) -> None:
        self.spots, self._part = spots, part
        self._moved = options.direction * spots.means.reference
        first, *others = spots.diodes
        self.names = ["stage x", "stage y", "stage heading", f"rotation of y axis of {first.name}"]
        self.units = ["m", "m", "rad", "rad"]
        for diode in others:
            self.names += [f"{what} of {diode.name}" for what in ("x", "y", "rotation of x axis", "rotation of y axis")]
            self.units += ["m", "m", "rad", "rad"]
        scale = {"m": options.expected_offset, "rad": options.expected_turn}
        self.scales = np.array([1e-3, 1e-3, *(scale[unit] for unit in self.units[2:])])
        self.start = np.zeros(len(self.names))
        offset = (first.spots - first.predict_spots({}, *self.poses(first, self.start))).mean(axis=0)
        calibration = part.diodes[first.index]
        self.start[:2] = (np.array([calibration.x_axis.array, calibration.y_axis.array]).T @ offset)[:2]
        for index, diode in enumerate(others):
            self.start[4 + 4 * index : 6 + 4 * index] = part.diodes[diode.index].origin.array[:2]

    def axis_unknowns(self, position: int) -> dict[str, int]:
        """Return which unknown rotates which axis of the diode at a position among those that see the light."""
        return {"y_axis": 3} if position == 0 else {"x_axis": 4 * position + 2, "y_axis": 4 * position + 3}

    def diode_vectors(self, position: int, unknowns: FloatArray) -> dict[str, FloatArray]:
        """Return the fitted vectors of a diode: origin [m] and axes."""
        calibration = self._part.diodes[self.spots.diodes[position].index]
        normal = np.cross(calibration.x_axis.array, calibration.y_axis.array)
        normal /= np.linalg.norm(normal)
        vectors = {}
        if position > 0:
            x, y = unknowns[4 * position : 4 * position + 2]
            vectors["origin"] = np.array([x, y, calibration.origin.array[2]])
        for name, index in self.axis_unknowns(position).items():
            axis, angle = getattr(calibration, name).array, unknowns[index]
            vectors[name] = np.cos(angle) * axis + np.sin(angle) * np.cross(normal, axis)
        return vectors

    def poses(self, diode: SingleDiode, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotations (m, 3, 3) and translations [m] (m, 3) at the dwells in which a diode sees the source."""
        x, y, heading = unknowns[:3]
        turn = np.array([[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]])
        moved = self._moved[diode.seen] @ turn.T + np.array([x, y, 0.0])
        return np.tile(np.eye(3), (len(moved), 1, 1)), moved

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        """Return the residuals of all spots, (n,)."""

        def predict(diode: SingleDiode) -> FloatArray:
            new: dict[str, float] = {}
            for name, vector in self.diode_vectors(self.spots.diodes.index(diode), unknowns).items():
                new.update(vector_parameters(SENSOR_NAMES[name], vector))
            return diode.predict_spots(new, *self.poses(diode, unknowns))

        return self.spots.residuals(predict)


def find_diode_axes(recording: Recording, calibration: Calibration, options: DiodeAxesOptions) -> Outcome:
    """Find offset and rotation of the diodes; raises as ``Procedure.identify``."""
    sensor, part = find_sensor(calibration, DiodesCalibration, NAME)
    track = recording.find_track(options.reference, POINT)
    spots = find_dwell_spots(recording, part, track, options, NAME)
    if len(spots.diodes) < MIN_DIODES:
        raise FitError(f"only {spots.diodes[0].name} sees the light", where=NAME, expected="at least two diodes")
    sources = sorted({int(source) for diode in spots.diodes for source in diode.sources})
    if len(sources) > 1:
        names = ", ".join(part.light_sources[source].name for source in sources)
        raise FitError(f"the diodes see {names}", where=NAME, expected="one and the same source")
    model = _Model(spots, part, options)
    for diode in spots.diodes:
        axes = part.diodes[diode.index]
        along = options.direction * spots.means.reference[diode.seen]
        moved = np.column_stack([along @ axes.x_axis.array, along @ axes.y_axis.array, along[:, 2]])
        check_spot_motion(diode, moved, track.source)
    numbers = _fitted_numbers(model, part)
    parameters = [f"{SENSOR_NAMES[n.vector]}[{n.diode},{n.component}]" for n in numbers]
    fixed = FixedParameters(calibration, parameter_indices(calibration, sensor, parameters))
    derivatives = spots.derivatives(lambda diode: model.poses(diode, model.start), calibration, sensor)
    found = fit_parameters(
        model.residuals,
        model.start,
        model.names,
        model.units,
        model.scales,
        fixed_effects=fixed.effects(derivatives),
        loss=options.loss,
        what=NAME,
    )
    check_spread(found, spots.names(), f"{NAME}, {recording.source}")
    found = enlarge_if_improbable(found) if options.loss == "linear" else found
    basis = np.zeros((len(numbers), len(found.names)))
    for row, number in enumerate(numbers):
        basis[row, number.unknown] = number.slope
    entries = tuple(f"sensors[{sensor}].diodes[{n.diode}].{n.vector}[{n.component}]" for n in numbers)
    count = len(found.names)
    return Outcome(
        method=f"one source seen by {len(spots.diodes)} diodes at {len(spots.means)} dwells "
        "(thesis 7.4.4, equations 7.2 to 7.4, by least squares)",
        fits={NAME: found},
        replacements=tuple(_replacements(found, model, part, sensor, numbers)),
        covariances=(fixed.joint_covariance(entries, found, basis),),
        tables=(_tabulate_offsets(found, model, part), *result_tables("diodes and stage", found, model.start, count)),
        warnings=spots.means.warnings + describe_fit(found, model.scales, count, spots.names()),
    )


@dataclass(frozen=True)
class _Number:
    """A number of the file that is fitted."""

    diode: int
    vector: str  # key of the vector within the diode
    component: int
    unknown: int  # the unknown that moves it
    slope: float  # d(number)/d(unknown)


def _fitted_numbers(model: _Model, part: DiodesCalibration) -> list[_Number]:
    """Return x and y of the origins, and the components that a rotation moves of the axes."""
    found = []
    for position, diode in enumerate(model.spots.diodes):
        own, k = part.diodes[diode.index], diode.index
        if position > 0:
            found += [_Number(k, "origin", i, 4 * position + i, 1.0) for i in range(2)]
        normal = np.cross(own.x_axis.array, own.y_axis.array)
        for name, unknown in model.axis_unknowns(position).items():
            slopes = np.cross(normal, getattr(own, name).array)
            found += [_Number(k, name, i, unknown, float(slopes[i])) for i in range(3) if abs(slopes[i]) > ACROSS]
    return found


def _replacements(
    found: Fit, model: _Model, part: DiodesCalibration, sensor: int, numbers: list[_Number]
) -> list[Replacement]:
    """Return the fitted vectors; components that are not fitted keep their uncertainty."""
    replacements = []
    for position, diode in enumerate(model.spots.diodes):
        for name, vector in model.diode_vectors(position, found.values).items():
            sigmas = getattr(part.diodes[diode.index], name).sigmas.copy()
            for number in numbers:
                if (number.diode, number.vector) == (diode.index, name):
                    sigmas[number.component] = abs(number.slope) * found.sigmas[number.unknown]
            key = f"sensors[{sensor}].diodes[{diode.index}].{name}"
            replacements.append(Replacement(key, vector.tolist(), sigmas.tolist()))
    return replacements


def _tabulate_offsets(found: Fit, model: _Model, part: DiodesCalibration) -> Table:
    first, *others = model.spots.diodes
    origin = part.diodes[first.index].origin.array
    rows = tuple(
        (f"{axis} from {first.name} to {diode.name}", float(found.values[k] - origin[i]), float(found.sigmas[k]))
        for position, diode in enumerate(others, 1)
        for i, axis in enumerate("xy")
        for k in (4 * position + i,)
    )
    return Table("offset of the diodes", ("offset", "found", "sigma"), ("", "m", "m"), rows)


PROCEDURE = Procedure(
    NAME, "offset and rotation of the diodes, from one source over all of them", DiodeAxesOptions, find_diode_axes
)
