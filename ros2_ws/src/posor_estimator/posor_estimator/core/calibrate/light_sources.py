"""Inclination of the light sources: how their rays lean, from spots that move as the plates part.

A ray that is not square to the plates moves its spot in proportion to the distance. So does a stage that does not move
square to the receiving plate: along one position of the target the two cannot be told apart. Turned by 180 degrees, the
target takes its rays' lean with it while the stage's stays: half of the difference is the rays', half of the sum the
stage's. Any turns will do here, and any number of sources and diodes. Source: thesis table 7.8, equations 7.5 to 7.8.

How the target is seated after a turn is not known: each diode's spots of each source at each turn have a zero of their
own, and only how they move counts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.checks import check_spread
from posor_estimator.core.calibrate.fit import Fit, Loss, fit
from posor_estimator.core.calibrate.parameters import indices, the_sensor
from posor_estimator.core.calibrate.procedure import Outcome, Procedure
from posor_estimator.core.calibrate.recording import POINT, POSE, Recording, poses_of
from posor_estimator.core.calibrate.replacement import Replacement
from posor_estimator.core.calibrate.reporting import correlation_table, fit_warnings, honest, parameter_table
from posor_estimator.core.calibrate.seen_spots import SeenSpots, StopOptions, components, seen_spots
from posor_estimator.core.calibrate.stated import Taken
from posor_estimator.core.native import native_from_rotation, rotation_from_native
from posor_estimator.core.sensors.diodes import DiodesCalibration
from posor_estimator.errors import FitError, TrackError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.one_diode import OneDiode
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

NAME = "light_sources"
SAME_TURN = 0.02
"""Turns of the target closer than this [rad] are one seat of it."""
LONGEST_TRAVEL = 2.0
"""Of the width over which the diodes and light sources are spread."""
LEAST_TRAVEL = 20.0
"""Standard uncertainties of a spot that a lean of ``expected_lean`` has to move it by over the travel of the stage."""


class LightSourcesOptions(StopOptions):
    """Options of the light sources' inclination."""

    reference: str = Field(
        default="", description="topic of the stage: pose, or point if the target was not turned; empty: the only one"
    )
    expected_lean: float = Field(default=5e-3, gt=0.0, description="standard uncertainty of the rays so far [rad]")
    stage_sigma: float | None = Field(
        default=None,
        gt=0.0,
        description="how square the stage moves to the receiving plate [rad]; needed where the target was not turned",
    )
    loss: Loss = Field(default="linear", description="of the fit; soft_l1 or huber survive outliers")


class _Model:
    """Predicts the spots from the unknowns: rays' leans, the stage's two leans, then zeros of the spots."""

    def __init__(self, spots: SeenSpots, part: DiodesCalibration, options: LightSourcesOptions) -> None:
        self.spots, self._part = spots, part
        values = spots.stops.reference
        self._moved = values[:, :3]
        rotations = poses_of(values)[0] if values.shape[1] == POSE else np.tile(np.eye(3), (len(values), 1, 1))
        thetas = np.unwrap([native_from_rotation(rotation)[2] for rotation in rotations])
        seats = np.round((thetas - thetas[0]) / SAME_TURN).astype(np.int64)
        self._rotations = np.array([rotation_from_native(0.0, 0.0, theta) for theta in thetas])
        self.sources = sorted({int(source) for diode in spots.diodes for source in diode.sources})
        groups = sorted(
            {
                (d.index, int(s), int(seat))
                for d in spots.diodes
                for s, seat in zip(d.sources, seats[d.seen], strict=True)
            }
        )
        self._groups = {
            diode.index: np.array(
                [
                    groups.index((diode.index, int(s), int(seat)))
                    for s, seat in zip(diode.sources, seats[diode.seen], strict=True)
                ],
                dtype=np.int64,
            )
            for diode in spots.diodes
        }
        leans = [f"lean along {axis} of {part.light_sources[s].name}" for s in self.sources for axis in "XY"]
        self.names = [*leans, "lean of the stage along X", "lean of the stage along Y"]
        self.count = len(leans)
        zeros = [f"zero {axis} of the spots {index + 1}" for index in range(len(groups)) for axis in "xy"]
        self.names += zeros
        self.units = ["rad"] * (self.count + 2) + ["m"] * len(zeros)
        self.scales = np.array([options.expected_lean] * (self.count + 2) + [1e-3] * len(zeros))
        self.start = np.zeros(len(self.names))
        self._prior = options.stage_sigma
        for diode in spots.diodes:
            off = diode.spots - self._seen(diode, self.start)
            for group in np.unique(self._groups[diode.index]):
                at = self.count + 2 + 2 * int(group)
                self.start[at : at + 2] = off[self._groups[diode.index] == group].mean(axis=0)

    def direction(self, source: int, unknowns: FloatArray) -> FloatArray:
        """Return the direction of a ray in T, unit, (3,): as it was, leaning more along X and Y of T."""
        at = 2 * self.sources.index(source)
        was = self._part.light_sources[source].direction.array
        leaning = was + abs(was[2]) * np.array([unknowns[at], unknowns[at + 1], 0.0])
        return np.asarray(leaning / np.linalg.norm(leaning))

    def poses(self, diode: OneDiode, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotations (m, 3, 3) and translations [m] (m, 3) at the stops that a diode sees a source at."""
        along = np.array([[1.0, 0.0, unknowns[self.count]], [0.0, 1.0, unknowns[self.count + 1]], [0.0, 0.0, 1.0]])
        return self._rotations[diode.seen], self._moved[diode.seen] @ along.T

    def _seen(self, diode: OneDiode, unknowns: FloatArray) -> FloatArray:
        new: dict[str, float] = {}
        for source in np.unique(diode.sources):
            new.update(components(f"source_directions#{source}", self.direction(int(source), unknowns)))
        return diode.predict(new, *self.poses(diode, unknowns))

    def _predict(self, diode: OneDiode, unknowns: FloatArray) -> FloatArray:
        zeros = unknowns[self.count + 2 :].reshape(-1, 2)
        return self._seen(diode, unknowns) + zeros[self._groups[diode.index]]

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        """Return the spots' residuals, and the stage's lean over what is known of it."""
        spots = self.spots.residuals(lambda diode: self._predict(diode, unknowns))
        if self._prior is None:
            return spots
        return np.concatenate([spots, unknowns[self.count : self.count + 2] / self._prior])

    def readings(self) -> list[str]:
        """Return what to call each residual."""
        return [*self.spots.names(), "stage along X", "stage along Y"]

    def turned(self) -> bool:
        """Return whether some ray was seen at two turns."""
        theta = np.array([native_from_rotation(rotation)[2] for rotation in self._rotations])
        return bool(np.ptp(theta) > SAME_TURN)


def find_light_sources(recording: Recording, calibration: Calibration, options: LightSourcesOptions) -> Outcome:
    """Find how the rays lean; see ``LightSourcesOptions``.

    Raises:
        FitError: The stops do not tell the leans; without a turn, those of the rays from that of the stage.
        TrackError: The reference does not serve.

    """
    sensor, part = the_sensor(calibration, DiodesCalibration, NAME)
    poses = [topic for topic, track in recording.tracks.items() if track.values.shape[1] == POSE]
    is_pose = options.reference in poses if options.reference else bool(poses)
    spots = seen_spots(recording, part, options, options.reference, POSE if is_pose else POINT, NAME)
    model = _Model(spots, part, options)
    travel = float(np.ptp(spots.stops.reference[:, 2]))
    _check_travel(travel, part, f"{NAME}, {recording.source}")
    resolved = max(float(spots.sigmas(diode).min()) for diode in spots.diodes)
    if travel * options.expected_lean < LEAST_TRAVEL * resolved:
        raise FitError(
            f"the stage travels {travel:.3g} m along Z, which moves the spots of leaning rays by no more than "
            f"{travel * options.expected_lean / resolved:.2g} sigmas",
            where=NAME,
            expected=f"at least {LEAST_TRAVEL * resolved / options.expected_lean:.2g} m",
        )
    if options.stage_sigma is None and not model.turned():
        raise FitError(
            "the target was not turned, so that the rays' lean and the stage's are one",
            where=NAME,
            expected="stops at 180 degrees too, or stage_sigma: how square the stage moves",
        )
    leans = [f"source_directions[{source},{i}]" for source in model.sources for i in range(2)]
    taken = Taken(calibration, indices(calibration, sensor, leans))
    derivatives = spots.derivatives(lambda diode: model.poses(diode, model.start), calibration, sensor)
    prior = np.zeros((0 if options.stage_sigma is None else 2, derivatives.shape[1]))
    found = fit(
        model.residuals,
        model.start,
        model.names,
        model.units,
        model.scales,
        taken=taken.effects(np.vstack([derivatives, prior])),
        loss=options.loss,
        what=NAME,
    )
    check_spread(found, model.readings(), f"{NAME}, {recording.source}")
    found = found if options.loss != "linear" else honest(found)
    return _outcome(found, model, part, sensor, taken)


def _check_travel(travel: float, part: DiodesCalibration, where: str) -> None:
    """Refuse a travel [m] that no bench for such a POSOR has: nothing in the spots themselves tells its unit.

    Raises:
        TrackError: It is that long.

    """
    origins = [*(diode.origin for diode in part.diodes), *(source.origin for source in part.light_sources)]
    places = np.array([origin.array[:2] for origin in origins])
    width = float(np.max(np.linalg.norm(places[:, None] - places, axis=2)))
    if travel > LONGEST_TRAVEL * width:
        raise TrackError(
            f"the stage travels {travel:.3g} m along Z, between diodes and light sources that lie within {width:.3g} m",
            where=where,
            expected=f"metres, at most {LONGEST_TRAVEL * width:.3g}",
        )


def _outcome(found: Fit, model: _Model, part: DiodesCalibration, sensor: int, taken: Taken) -> Outcome:
    keys = [f"sensors[{sensor}].light_sources[{source}].direction" for source in model.sources]
    replacements = []
    for index, (key, source) in enumerate(zip(keys, model.sources, strict=True)):
        sigmas = [
            *found.sigmas[2 * index : 2 * index + 2].tolist(),
            float(part.light_sources[source].direction.sigmas[2]),
        ]
        replacements.append(Replacement(key, model.direction(source, found.values).tolist(), sigmas))
    entries = tuple(f"{key}[{i}]" for key in keys for i in range(2))
    shown = model.count + 2
    travel = float(np.ptp(model.spots.stops.reference[:, 2]))
    thetas = "two turns of the target" if model.turned() else "one position of the target"
    return Outcome(
        method=f"spots of {len(model.sources)} sources at {len(model.spots.stops)} stops along {travel:.3g} m of Z, "
        f"at {thetas} (thesis equations 7.5 to 7.8, by least squares)",
        fits={NAME: found},
        replacements=tuple(replacements),
        covariances=(taken.joint(entries, found),),
        tables=(
            parameter_table("leans, of rays against what they were", found, np.zeros(shown), shown),
            correlation_table(found, shown),
        ),
        warnings=model.spots.stops.warnings + fit_warnings(found, model.scales, model.count, model.readings()),
    )


PROCEDURE = Procedure(
    NAME,
    "inclination of the light sources, from a travel along Z and a reversal",
    LightSourcesOptions,
    find_light_sources,
)
