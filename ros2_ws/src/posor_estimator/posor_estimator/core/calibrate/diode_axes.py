"""Where diodes sit beside one another: offset of their origins and turn of their axes, from one light source.

A stage carries one and the same source over all diodes. Each sees it over a field of its own; the stage says how far
the fields are apart and how they are turned. The first diode is where it was, its x axis is the reference of all turns:
what the stage's zero and its own heading are is found along with the rest. Source: thesis 7.4.4, equations 7.2 to 7.4,
where two positions of the light gave the offset; here any number of stops, by least squares.

The squareness of the stage is taken as it is; so are the maps of the diodes, and all else that the calibration says,
with their uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.checks import check_spread
from posor_estimator.core.calibrate.fit import Fit, Loss, fit
from posor_estimator.core.calibrate.parameters import indices, the_sensor
from posor_estimator.core.calibrate.procedure import Outcome, Procedure, Table
from posor_estimator.core.calibrate.recording import POINT
from posor_estimator.core.calibrate.replacement import Replacement
from posor_estimator.core.calibrate.reporting import correlation_table, fit_warnings, honest, parameter_table
from posor_estimator.core.calibrate.seen_spots import (
    SeenSpots,
    StopOptions,
    check_motion,
    components,
    seen_spots,
    turned_axis,
)
from posor_estimator.core.calibrate.stated import Taken
from posor_estimator.core.sensors.diodes import DiodesCalibration
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.one_diode import OneDiode
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

NAME = "diode_axes"


class DiodeAxesOptions(StopOptions):
    """Options of the diodes' offset."""

    reference: str = Field(default="", description="topic of the stage's point, axes near R's; empty: the only one")
    direction: Literal[1, -1] = Field(
        default=1, description="1: the reference moves as the light does; -1: as the diodes under the light"
    )
    expected_offset: float = Field(default=1e-4, gt=0.0, description="standard uncertainty of the offset so far [m]")
    expected_turn: float = Field(default=5e-3, gt=0.0, description="standard uncertainty of the axes so far [rad]")
    loss: Loss = Field(default="linear", description="of the fit; soft_l1 or huber survive outliers")


class _Model:
    """Predicts the spots from the unknowns: stage x, y, heading; then turns and offsets of the diodes."""

    def __init__(self, spots: SeenSpots, part: DiodesCalibration, options: DiodeAxesOptions) -> None:
        self.spots, self._part = spots, part
        self._moved = options.direction * spots.stops.reference
        first, *others = spots.diodes
        self.names = ["stage x", "stage y", "stage heading", f"turn of y axis of {first.name}"]
        self.units = ["m", "m", "rad", "rad"]
        for diode in others:
            self.names += [f"{what} of {diode.name}" for what in ("x", "y", "turn of x axis", "turn of y axis")]
            self.units += ["m", "m", "rad", "rad"]
        scale = {"m": options.expected_offset, "rad": options.expected_turn}
        self.scales = np.array([1e-3, 1e-3, *(scale[unit] for unit in self.units[2:])])
        self.start = np.zeros(len(self.names))
        start = first.spots - self._predict(first, self.start)
        frame = self._axes(first)
        self.start[:2] = (frame.T @ start.mean(axis=0))[:2]
        for index, diode in enumerate(others):
            self.start[4 + 4 * index : 6 + 4 * index] = part.diodes[diode.index].origin.array[:2]

    def _axes(self, diode: OneDiode) -> FloatArray:
        calibration = self._part.diodes[diode.index]
        return np.array([calibration.x_axis.array, calibration.y_axis.array])

    def parameters(self, diode: OneDiode, unknowns: FloatArray) -> dict[str, FloatArray]:
        """Return origin and axes of a diode."""
        calibration = self._part.diodes[diode.index]
        x_axis, y_axis = calibration.x_axis.array, calibration.y_axis.array
        normal = np.cross(x_axis, y_axis)
        normal /= np.linalg.norm(normal)
        at = self.spots.diodes.index(diode)
        if at == 0:
            return {"y_axes": turned_axis(y_axis, normal, unknowns[3])}
        x, y, turn_x, turn_y = unknowns[4 * at : 4 * at + 4]
        return {
            "origins": np.array([x, y, calibration.origin.array[2]]),
            "x_axes": turned_axis(x_axis, normal, turn_x),
            "y_axes": turned_axis(y_axis, normal, turn_y),
        }

    def poses(self, diode: OneDiode, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotations (m, 3, 3) and translations [m] (m, 3) at the stops that a diode sees the source at."""
        x, y, heading = unknowns[:3]
        turn = np.array([[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]])
        moved = self._moved[diode.seen] @ turn.T + np.array([x, y, 0.0])
        return np.tile(np.eye(3), (len(moved), 1, 1)), moved

    def _predict(self, diode: OneDiode, unknowns: FloatArray) -> FloatArray:
        new: dict[str, float] = {}
        if np.any(unknowns):
            for name, vector in self.parameters(diode, unknowns).items():
                new.update(components(name, vector))
        return diode.predict(new, *self.poses(diode, unknowns))

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        return self.spots.residuals(lambda diode: self._predict(diode, unknowns))


def find_diode_axes(recording: Recording, calibration: Calibration, options: DiodeAxesOptions) -> Outcome:
    """Find where the diodes sit beside one another; see ``DiodeAxesOptions``.

    Raises:
        FitError: Fewer than two diodes see the light, they do not see the same source, or the stops do not suffice.
        TrackError: The reference does not serve.

    """
    sensor, part = the_sensor(calibration, DiodesCalibration, NAME)
    spots = seen_spots(recording, part, options, options.reference, POINT, NAME)
    if len(spots.diodes) < 2:  # noqa: PLR2004
        raise FitError(f"only {spots.diodes[0].name} sees the light", where=NAME, expected="two diodes at least")
    sources = sorted({int(source) for diode in spots.diodes for source in diode.sources})
    if len(sources) > 1:
        names = ", ".join(part.light_sources[source].name for source in sources)
        raise FitError(f"the diodes see {names}", where=NAME, expected="one and the same source")
    model = _Model(spots, part, options)
    track = recording.track(options.reference, POINT)
    for diode in spots.diodes:
        axes = part.diodes[diode.index]
        along = options.direction * spots.stops.reference[diode.seen]
        moved = np.column_stack([along @ axes.x_axis.array, along @ axes.y_axis.array, along[:, 2]])
        check_motion(diode, moved, track.source)
    numbers = _numbers(model, part)
    taken = Taken(calibration, indices(calibration, sensor, [number.parameter for number in numbers]))
    derivatives = spots.derivatives(lambda diode: model.poses(diode, model.start), calibration, sensor)
    found = fit(
        model.residuals,
        model.start,
        model.names,
        model.units,
        model.scales,
        taken=taken.effects(derivatives),
        loss=options.loss,
        what=NAME,
    )
    check_spread(found, model.spots.names(), f"{NAME}, {recording.source}")
    found = found if options.loss != "linear" else honest(found)
    return _outcome(found, model, part, sensor, taken, numbers)


@dataclass(frozen=True)
class _Number:
    """A number of the file that is found.

    Attributes:
        entry: Its key from the diode on.
        diode: Which diode it is of.
        parameter: Its name among the sensor's parameters.
        unknown: Which unknown moves it.
        slope: By how much.

    """

    entry: str
    diode: int
    parameter: str
    unknown: int
    slope: float


def _numbers(model: _Model, part: DiodesCalibration) -> list[_Number]:
    """Return the numbers that are found: origins across, and what a turn moves of the axes."""
    found = []
    for at, diode in enumerate(model.spots.diodes):
        own, k = part.diodes[diode.index], diode.index
        if at > 0:
            found += [_Number(f"origin[{i}]", k, f"origins[{k},{i}]", 4 * at + i, 1.0) for i in range(2)]
        normal = np.cross(own.x_axis.array, own.y_axis.array)
        turns = {"y": 3} if at == 0 else {"x": 4 * at + 2, "y": 4 * at + 3}
        for axis, unknown in turns.items():
            moved = np.cross(normal, getattr(own, f"{axis}_axis").array)
            found += [
                _Number(f"{axis}_axis[{i}]", k, f"{axis}_axes[{k},{i}]", unknown, float(moved[i]))
                for i in range(3)
                if abs(moved[i]) > 0.5  # noqa: PLR2004  the component across the axis
            ]
    return found


def _outcome(
    found: Fit, model: _Model, part: DiodesCalibration, sensor: int, taken: Taken, numbers: list[_Number]
) -> Outcome:
    replacements: list[Replacement] = []
    for at, diode in enumerate(model.spots.diodes):
        key, own = f"sensors[{sensor}].diodes[{diode.index}]", part.diodes[diode.index]
        new = model.parameters(diode, found.values)
        turns = {"y_axis": 3} if at == 0 else {"x_axis": 4 * at + 2, "y_axis": 4 * at + 3}
        for name, index in turns.items():
            vector = new[f"{name[0]}_axes"]
            old = getattr(own, name)
            # A turn moves the components across the axis within the diode's plane; the others are as they were.
            across = np.abs(np.cross(np.cross(own.x_axis.array, own.y_axis.array), vector))
            sigma = np.where(across > 0.5, found.sigmas[index] * across, old.sigmas)  # noqa: PLR2004
            replacements.append(Replacement(f"{key}.{name}", vector.tolist(), sigma.tolist()))
        if at > 0:
            sigma = [*found.sigmas[4 * at : 4 * at + 2].tolist(), float(own.origin.sigmas[2])]
            replacements.append(Replacement(f"{key}.origin", new["origins"].tolist(), sigma))
    before = model.start.copy()
    basis = np.zeros((len(numbers), len(found.names)))
    for row, number in enumerate(numbers):
        basis[row, number.unknown] = number.slope
    entries = tuple(f"sensors[{sensor}].diodes[{number.diode}].{number.entry}" for number in numbers)
    first = model.spots.diodes[0]
    rows = tuple(
        (
            f"{axis} from {first.name} to {diode.name}",
            float(found.values[4 * at + i] - part.diodes[first.index].origin.array[i]),
            float(found.sigmas[4 * at + i]),
        )
        for at, diode in enumerate(model.spots.diodes)
        if at > 0
        for i, axis in enumerate("xy")
    )
    return Outcome(
        method=f"one source seen by {len(model.spots.diodes)} diodes at {len(model.spots.stops)} stops "
        "(thesis 7.4.4, equations 7.2 to 7.4, by least squares)",
        fits={NAME: found},
        replacements=tuple(replacements),
        covariances=(taken.joint(entries, found, basis),),
        tables=(
            Table("offset of the diodes", ("offset", "found", "sigma"), ("", "m", "m"), rows),
            parameter_table("diodes, and the stage", found, before, len(before)),
            correlation_table(found, len(before)),
        ),
        warnings=model.spots.stops.warnings + fit_warnings(found, model.scales, len(before), model.spots.names()),
    )


PROCEDURE = Procedure(
    NAME, "offset and turn of the diodes, from one source over all of them", DiodeAxesOptions, find_diode_axes
)
