# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Single diodes, and the spots that they see at the dwells of a stage that carries the light or the diodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor.errors import FitError
from posor.estimation.sensor_stack import Stack
from posor.model.reading_rows import evaluate_poses
from posor.model.scan import DIODES_ESTIMATED, SATURATED

from posor_calibration.calibration_parameters import first_parameter, replace_values
from posor_calibration.data_checks import check_axis, check_channels_vary, check_count, check_unit
from posor_calibration.dwells import DwellMeans, RestOptions, average_dwells
from posor_calibration.procedure import LossOption

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from posor.bags.recording import Recording, Track
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray, IntArray
    from posor.sensors.diodes import Diodes, DiodesCalibration

AXES = ("x", "y", "z")
MIN_DWELLS = 4
CLEAR_MOTION = 10.0  # travel of a spot over its noise above which it is compared with the reference's
OF_ONE_DIODE = ("origins", "x_axes", "y_axes", "maps")  # parameters of a diode sensor that each diode has for itself


class StageOptions(RestOptions):
    """Options of procedures with diodes and a stage that rests at dwells."""

    loss: LossOption = "linear"


class SingleDiode:
    """One diode of a sensor, evaluated by the sensor's own model, and the scans in which it sees a light source.

    Attributes:
        index: Of the diode.
        name: Of the diode.
        seen: Scans in which it sees a source, (n,).
        sources: The source in each of those, (m,).
        spots: Positions by the calibration's map [m], (m, 2).
        variances: Of the spots, from the stated noise [m^2], (m, 2).

    """

    def __init__(self, calibration: DiodesCalibration, index: int, scans: Scans) -> None:
        """Extract one diode from a calibration, and its currents from scans."""
        self.index = index
        self.name = calibration.diodes[index].name
        maps = {calibration.map: [calibration.maps[calibration.map][index]]}
        alone = calibration.model_copy(update={"diodes": [calibration.diodes[index]], "maps": maps})
        self._sensor: Diodes = alone.build()
        own = scans.with_fields({"diode_currents": scans.diode_currents[:, index : index + 1]})
        own = own.with_fields({"lit_sources": scans.lit_sources[:, index : index + 1]})
        readings = Stack([self._sensor]).linearise(own)
        self.seen: BoolArray = readings.valid
        self.sources: IntArray = own.lit_sources[self.seen, 0]
        self.spots: FloatArray = readings.values[self.seen]
        self.variances: FloatArray = readings.variances[self.seen]
        self._rows = readings.selected[self.seen]
        self._start = self._sensor.parameter_values
        self._scans = own.select(np.flatnonzero(self.seen))
        self._all_names = calibration.build().parameter_names

    def predict_spots(self, new: Mapping[str, float], rotations: FloatArray, translations: FloatArray) -> FloatArray:
        """Return the predicted spots [m], (m, 2), at the scans in which the diode sees a source.

        ``new`` gives new values of parameters of a sensor with this diode only: ``origins[0,1]``. ``rotations`` (m, 3,
        3) and ``translations`` [m] (m, 3) give T in R.
        """
        names = self._sensor.parameter_names
        where = np.array([names.index(name) for name in new], dtype=np.int64)
        values = replace_values(self._start, where, np.array([*new.values()]))
        rows = self._sensor.with_parameter_values(values).rows
        return evaluate_poses(rows, self._rows, rotations, translations)

    def derivatives(self, rotations: FloatArray, translations: FloatArray) -> FloatArray:
        """Return d(spot - predicted spot)/d(parameter of the sensor with all diodes), (m, 2, p); poses as above."""
        index_of = {name: i for i, name in enumerate(self._all_names)}
        own = [
            name.replace("[0,", f"[{self.index},") if name.startswith(OF_ONE_DIODE) else name
            for name in self._sensor.parameter_names
        ]
        where = np.array([index_of[name] for name in own])
        out = np.zeros((len(rotations), 2, len(index_of)))
        for n, (rotation, translation) in enumerate(zip(rotations, translations, strict=True)):
            out[n][:, where] = self._sensor.residual_jacobian(self._scans[n], rotation, translation)
        return out


def current_ratios(currents: FloatArray) -> FloatArray:
    """Return the ratios (A - C)/(A + C), (B - D)/(B + D) of contact currents (..., 4), (..., 2)."""
    sums, differences = currents[..., :2] + currents[..., 2:], currents[..., :2] - currents[..., 2:]
    return np.asarray(differences / sums)


@dataclass(frozen=True)
class DwellSpots:
    """The spots that each diode sees at the dwells of a stage."""

    means: DwellMeans  # (d,)
    diodes: list[SingleDiode]  # those that see a source at some dwell

    def sigmas(self, diode: SingleDiode) -> FloatArray:
        """Return the standard uncertainty of a diode's spots, of noise and reference together [m], (m, 2)."""
        noise = diode.variances / self.means.counts[diode.seen][:, None]
        return np.asarray(np.sqrt(noise + np.square(self.means.reference_sigmas[diode.seen, :2])))

    def residuals(self, predict: Callable[[SingleDiode], FloatArray]) -> FloatArray:
        """Return observed less predicted spots over their standard uncertainty, diode after diode, (n,)."""
        return np.concatenate([((diode.spots - predict(diode)) / self.sigmas(diode)).ravel() for diode in self.diodes])

    def derivatives(
        self, poses: Callable[[SingleDiode], tuple[FloatArray, FloatArray]], calibration: Calibration, sensor: int
    ) -> FloatArray:
        """Return d(residual)/d(parameter of the stack), (n, p); ``sensor`` is the index of the diode sensor.

        ``poses`` gives, for a diode, rotations (m, 3, 3) and translations [m] (m, 3) of T in R where it sees a source.
        """
        first = first_parameter(calibration, sensor)
        total = first_parameter(calibration, len(calibration.sensors))
        parts = []
        for diode in self.diodes:
            block = diode.derivatives(*poses(diode)) / self.sigmas(diode)[:, :, None]
            part = np.zeros((block.shape[0] * 2, total))
            part[:, first : first + block.shape[2]] = block.reshape(-1, block.shape[2])
            parts.append(part)
        return np.concatenate(parts)

    def names(self) -> list[str]:
        """Return the name of each residual."""
        return [
            f"spot {axis} of {diode.name} at dwell {dwell + 1}"
            for diode in self.diodes
            for dwell in np.flatnonzero(diode.seen)
            for axis in "xy"
        ]


def average_stage_dwells(recording: Recording, track: Track, least: int, options: RestOptions, what: str) -> DwellMeans:
    """Return the mean scans at ``least`` or more dwells of a stage, without substituted or saturated readings.

    Raises TrackError: the reference is unusable; FitError: there are too few dwells, or a channel is stuck.
    """
    scans = recording.without_status(DIODES_ESTIMATED | SATURATED).scans
    dwells = options.dwells(track)
    check_count(len(dwells), least, "dwells of the reference", f"{what}, {track.source}")
    check_channels_vary(scans, ("diode_currents",), recording.source)
    return average_dwells(scans, track, dwells, source=recording.source, kinds=("diode_currents",))


def find_dwell_spots(
    recording: Recording, part: DiodesCalibration, track: Track, options: StageOptions, what: str
) -> DwellSpots:
    """Return the spots at the dwells of a stage.

    Raises TrackError: the reference is unusable; FitError: there are too few dwells, or no diode sees a source.
    """
    means = average_stage_dwells(recording, track, MIN_DWELLS, options, what)
    count = means.scans.diode_currents.shape[1]
    if count != len(part.diodes):
        raise FitError(f"scans of {count} diodes", where=what, expected=f"{len(part.diodes)}, as in the calibration")
    diodes = [SingleDiode(part, index, means.scans) for index in range(len(part.diodes))]
    seeing = [diode for diode in diodes if diode.seen.any()]
    if not seeing:
        raise FitError("no diode sees a light source in any scan", where=what, expected="lit, calibrated diodes")
    return DwellSpots(means, seeing)


def check_spot_motion(diode: SingleDiode, moved: FloatArray, source: str) -> None:
    """Raise TrackError if the axes of the reference are swapped or its unit is wrong.

    ``moved`` [m] (m, 3) is the motion of the spots by the reference, along and across the diode's axes.
    """
    for axis in range(2):
        noise = float(np.sqrt(diode.variances[:, axis].max()))
        if np.ptp(diode.spots[:, axis]) > CLEAR_MOTION * noise:
            check_axis(diode.spots[:, axis], moved, axis, AXES, source)
            check_unit(diode.spots[:, axis], moved[:, axis], source, "m")


def vector_parameters(name: str, vector: Sequence[float] | FloatArray, row: int = 0) -> Mapping[str, float]:
    """Return a vector as parameters of a sensor: ``name[row,0]``, ``name[row,1]``, ..."""
    return {f"{name}[{row},{i}]": float(component) for i, component in enumerate(vector)}
