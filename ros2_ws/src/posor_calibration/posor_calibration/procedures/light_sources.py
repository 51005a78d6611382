# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Inclination of the light sources, from spots that move as the plates part.

A ray that is not square to the plates moves its spot in proportion to the distance; so does a stage that does not move
square to the receiving plate. At one position of the target the two are indistinguishable. Turned by 180 degrees, the
target takes the lean of its rays along while the stage's stays: half of the difference is the rays' lean, half of the
sum is the stage's. Any turns, sources and diodes can be used here. The seat of the target after a turn is unknown: the
spots of each source on each diode at each turn have a zero of their own. Source: thesis table 7.8, equations 7.5 to
7.8.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.bags.recording import POINT, POSE, unpack_poses
from posor.calibration.calibration_file import find_sensor
from posor.errors import FitError, TrackError
from posor.model.native_coordinates import native_from_rotation, rotation_from_native
from posor.sensors.diodes import DiodesCalibration
from pydantic import Field

from posor_calibration.calibration_parameters import FixedParameters, parameter_indices
from posor_calibration.diode_spots import DwellSpots, SingleDiode, StageOptions, find_dwell_spots, vector_parameters
from posor_calibration.fit_report import check_spread, describe_fit, enlarge_if_improbable, result_tables
from posor_calibration.least_squares import fit_parameters
from posor_calibration.procedure import Outcome, Procedure, Replacement

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

NAME = "light_sources"
SAME_SEAT = 0.02  # turns of the target closer than this [rad] are the same seat
LONGEST_TRAVEL = 2.0  # travel over the width across diodes and light sources
LEAST_MOTION = 20.0  # motion of a spot by ``expected_lean`` over the travel, in its standard uncertainties


class LightSourcesOptions(StageOptions):
    """Options of ``light_sources``."""

    reference: str = Field(
        default="", description="topic of the stage: pose, or point if the target was not turned; empty: the only one"
    )
    expected_lean: float = Field(default=5e-3, gt=0.0, description="prior standard uncertainty of the rays [rad]")
    stage_sigma: float | None = Field(
        default=None,
        gt=0.0,
        description="standard uncertainty of the stage's squareness [rad]; required where the target was not turned",
    )


class _Model:
    """Predicts the spots from the unknowns: leans of the rays, the two leans of the stage, then zeros of the spots."""

    def __init__(self, spots: DwellSpots, part: DiodesCalibration, options: LightSourcesOptions) -> None:
        self.spots, self._part, self._stage_sigma = spots, part, options.stage_sigma
        values = spots.means.reference
        self._moved = values[:, :3]
        rotations = unpack_poses(values)[0] if values.shape[1] == POSE else np.tile(np.eye(3), (len(values), 1, 1))
        thetas = np.unwrap([native_from_rotation(rotation)[2] for rotation in rotations])
        seats = np.round((thetas - thetas[0]) / SAME_SEAT).astype(np.int64)
        self._rotations = np.array([rotation_from_native(0.0, 0.0, theta) for theta in thetas])
        self.turned = bool(np.ptp([native_from_rotation(rotation)[2] for rotation in self._rotations]) > SAME_SEAT)
        self.sources = sorted({int(source) for diode in spots.diodes for source in diode.sources})
        pairs = {d.index: list(zip(d.sources.tolist(), seats[d.seen].tolist(), strict=True)) for d in spots.diodes}
        groups = sorted({(index, *pair) for index, own in pairs.items() for pair in own})
        self._groups = {index: np.array([groups.index((index, *p)) for p in own]) for index, own in pairs.items()}
        leans = [f"lean along {axis} of {part.light_sources[s].name}" for s in self.sources for axis in "XY"]
        zeros = [f"zero {axis} of the spots {index + 1}" for index in range(len(groups)) for axis in "xy"]
        self.count = len(leans)
        self.names = [*leans, "lean of the stage along X", "lean of the stage along Y", *zeros]
        self.units = ["rad"] * (self.count + 2) + ["m"] * len(zeros)
        self.scales = np.array([options.expected_lean] * (self.count + 2) + [1e-3] * len(zeros))
        self.start = np.zeros(len(self.names))
        for diode in spots.diodes:
            off = diode.spots - self._predict_moved(diode, self.start)
            for group in np.unique(self._groups[diode.index]):
                at = self.count + 2 + 2 * int(group)
                self.start[at : at + 2] = off[self._groups[diode.index] == group].mean(axis=0)

    def direction(self, source: int, unknowns: FloatArray) -> FloatArray:
        """Return the direction of a ray in T, unit, (3,): the former one, leaning more along X and Y of T."""
        at = 2 * self.sources.index(source)
        former = self._part.light_sources[source].direction.array
        leaning = former + abs(former[2]) * np.array([unknowns[at], unknowns[at + 1], 0.0])
        return np.asarray(leaning / np.linalg.norm(leaning))

    def poses(self, diode: SingleDiode, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotations (m, 3, 3) and translations [m] (m, 3) at the dwells in which a diode sees a source."""
        along = np.array([[1.0, 0.0, unknowns[self.count]], [0.0, 1.0, unknowns[self.count + 1]], [0.0, 0.0, 1.0]])
        return self._rotations[diode.seen], self._moved[diode.seen] @ along.T

    def _predict_moved(self, diode: SingleDiode, unknowns: FloatArray) -> FloatArray:
        """Return the predicted spots but for their zeros [m], (m, 2)."""
        new: dict[str, float] = {}
        for source in np.unique(diode.sources).tolist():
            new.update(vector_parameters("source_directions", self.direction(source, unknowns), source))
        return diode.predict_spots(new, *self.poses(diode, unknowns))

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        """Return the residuals of the spots, then the leans of the stage over their prior standard uncertainty."""
        zeros = unknowns[self.count + 2 :].reshape(-1, 2)
        spots = self.spots.residuals(
            lambda diode: self._predict_moved(diode, unknowns) + zeros[self._groups[diode.index]]
        )
        if self._stage_sigma is None:
            return spots
        return np.concatenate([spots, unknowns[self.count : self.count + 2] / self._stage_sigma])


def find_light_sources(recording: Recording, calibration: Calibration, options: LightSourcesOptions) -> Outcome:
    """Find the leans of the rays; raises as ``Procedure.identify``."""
    sensor, part = find_sensor(calibration, DiodesCalibration, NAME)
    poses = [topic for topic, track in recording.tracks.items() if track.values.shape[1] == POSE]
    is_pose = options.reference in poses if options.reference else bool(poses)
    track = recording.find_track(options.reference, POSE if is_pose else POINT)
    spots = find_dwell_spots(recording, part, track, options, NAME)
    model = _Model(spots, part, options)
    travel = float(np.ptp(spots.means.reference[:, 2]))
    _check_travel(travel, part, f"{NAME}, {recording.source}")
    resolved = max(float(spots.sigmas(diode).min()) for diode in spots.diodes)
    if travel * options.expected_lean < LEAST_MOTION * resolved:
        raise FitError(
            f"the stage travels {travel:.3g} m along Z, which moves the spots of leaning rays by only "
            f"{travel * options.expected_lean / resolved:.2g} sigmas",
            where=NAME,
            expected=f"at least {LEAST_MOTION * resolved / options.expected_lean:.2g} m",
        )
    if options.stage_sigma is None and not model.turned:
        raise FitError(
            "the target was not turned, so the leans of rays and stage cannot be separated",
            where=NAME,
            expected="dwells at 180 degrees too, or stage_sigma: how square the stage moves",
        )
    leans = [f"source_directions[{source},{i}]" for source in model.sources for i in range(2)]
    fixed = FixedParameters(calibration, parameter_indices(calibration, sensor, leans))
    derivatives = spots.derivatives(lambda diode: model.poses(diode, model.start), calibration, sensor)
    prior = np.zeros((0 if options.stage_sigma is None else 2, derivatives.shape[1]))
    found = fit_parameters(
        model.residuals,
        model.start,
        model.names,
        model.units,
        model.scales,
        fixed_effects=fixed.effects(np.vstack([derivatives, prior])),
        loss=options.loss,
        what=NAME,
    )
    readings = [*spots.names(), "stage along X", "stage along Y"]
    check_spread(found, readings, f"{NAME}, {recording.source}")
    found = enlarge_if_improbable(found) if options.loss == "linear" else found
    keys = [f"sensors[{sensor}].light_sources[{source}].direction" for source in model.sources]
    shown = model.count + 2
    return Outcome(
        method=f"spots of {len(keys)} sources at {len(spots.means)} dwells along {travel:.3g} m of Z, at "
        f"{'two turns' if model.turned else 'one position'} of the target (thesis equations 7.5 to 7.8, least squares)",
        fits={NAME: found},
        replacements=tuple(
            Replacement(
                key,
                model.direction(source, found.values).tolist(),
                [*found.sigmas[2 * i : 2 * i + 2].tolist(), float(part.light_sources[source].direction.sigmas[2])],
            )
            for i, (key, source) in enumerate(zip(keys, model.sources, strict=True))
        ),
        covariances=(fixed.joint_covariance(tuple(f"{key}[{i}]" for key in keys for i in range(2)), found),),
        tables=result_tables("leans, of rays against the former ones", found, np.zeros(shown), shown),
        warnings=spots.means.warnings + describe_fit(found, model.scales, model.count, readings),
    )


def _check_travel(travel: float, part: DiodesCalibration, where: str) -> None:
    """Raise TrackError for a travel [m] that no such POSOR allows: the spots do not reveal its unit."""
    origins = [*(diode.origin for diode in part.diodes), *(source.origin for source in part.light_sources)]
    places = np.array([origin.array[:2] for origin in origins])
    width = float(np.max(np.linalg.norm(places[:, None] - places, axis=2)))
    if travel > LONGEST_TRAVEL * width:
        raise TrackError(
            f"the stage travels {travel:.3g} m along Z, between diodes and light sources that lie within {width:.3g} m",
            where=where,
            expected=f"metres, at most {LONGEST_TRAVEL * width:.3g}",
        )


PROCEDURE = Procedure(
    NAME,
    "inclination of the light sources, from a travel along Z and a reversal",
    LightSourcesOptions,
    find_light_sources,
)
