"""Diodes one by one: what each sees, whatever the others do, through the sensor's own model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.calibrate.parameters import changed
from posor_estimator.core.kernels.rows import evaluate_all
from posor_estimator.core.stack import Stack
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.scan import Scans
    from posor_estimator.core.sensors.diodes import Diodes, DiodesCalibration
    from posor_estimator.core.types import BoolArray, FloatArray, IntArray


class OneDiode:
    """One diode of a sensor, and the scans in which it sees a light source.

    Attributes:
        index: Which diode.
        name: Its name.
        seen: Which scans it sees a source in, (n,) of truth values.
        sources: The source it sees in each of those, (m,).
        spots: Where, by the map of the calibration [m], (m, 2).
        variances: Of the spots, from the noise that the calibration states [m^2], (m, 2).

    """

    def __init__(self, calibration: DiodesCalibration, index: int, scans: Scans) -> None:
        """Take one diode out of a calibration, and its currents out of scans."""
        self.index = index
        self.name = calibration.diodes[index].name
        part = calibration.model_copy(
            update={
                "diodes": [calibration.diodes[index]],
                "maps": {calibration.map: [calibration.maps[calibration.map][index]]},
            }
        )
        self._sensor: Diodes = part.build()
        own = scans.with_fields({"diode_currents": scans.diode_currents[:, index : index + 1]})
        own = own.with_fields({"lit_sources": scans.lit_sources[:, index : index + 1]})
        codes, batch = Stack([self._sensor]).linearise(own)
        self.seen: BoolArray = codes[:, 0] == 0
        self.sources: IntArray = own.lit_sources[self.seen, 0]
        self.spots: FloatArray = batch.values[self.seen]
        self.variances: FloatArray = batch.variances[self.seen]
        self._chosen = batch.chosen[self.seen]
        self._start = self._sensor.parameter_values
        self._scans = own.chosen(np.flatnonzero(self.seen))
        self._whole = calibration

    def predict(self, new: Mapping[str, float], rotations: FloatArray, translations: FloatArray) -> FloatArray:
        """Return where the spots would be [m], (m, 2).

        Args:
            new: Parameters of the one diode's sensor that differ from the calibration, such as ``origins[0,1]``.
            rotations: R_R_T at the scans that the diode sees a source in, (m, 3, 3).
            translations: Origin of T in R there [m], (m, 3).

        """
        names = self._sensor.parameter_names
        where = np.array([names.index(name) for name in new], dtype=np.int64)
        values = changed(self._start, where, np.array([*new.values()]))
        pool = self._sensor.with_parameter_values(values).pool
        out = np.empty((len(rotations), 2))
        evaluate_all(pool.kinds, pool.rows, self._chosen, rotations, translations, out)
        return out

    def derivatives(self, rotations: FloatArray, translations: FloatArray) -> FloatArray:
        """Return d(spot - predicted spot)/d(parameter of the sensor with all its diodes), (m, 2, p).

        Args:
            rotations: R_R_T at the scans that the diode sees a source in, (m, 3, 3).
            translations: Origin of T in R there [m], (m, 3).

        """
        names = self._whole.build().parameter_names
        places = {name: i for i, name in enumerate(names)}
        of_diode = ("origins", "x_axes", "y_axes", "maps")
        own = [
            name.replace("[0,", f"[{self.index},") if name.startswith(of_diode) else name
            for name in self._sensor.parameter_names
        ]
        where = np.array([places[name] for name in own])
        out = np.zeros((len(rotations), 2, len(names)))
        for n, (rotation, translation) in enumerate(zip(rotations, translations, strict=True)):
            out[n][:, where] = self._sensor.residual_jacobian(self._scans[n], rotation, translation)
        return out

    def value(self, name: str) -> float:
        """Return a parameter of the one diode's sensor as the calibration has it."""
        return float(self._start[self._sensor.parameter_names.index(name)])


def diodes_that_see(calibration: DiodesCalibration, scans: Scans, what: str) -> list[OneDiode]:
    """Return the diodes that see a source in some scan.

    Raises:
        FitError: None does, or the scans have another number of diodes.

    """
    if scans.diode_currents.shape[1] != len(calibration.diodes):
        found = f"scans of {scans.diode_currents.shape[1]} diodes"
        raise FitError(found, where=what, expected=f"{len(calibration.diodes)}, as the calibration has")
    diodes = [OneDiode(calibration, index, scans) for index in range(len(calibration.diodes))]
    seeing = [diode for diode in diodes if diode.seen.any()]
    if not seeing:
        raise FitError("no diode sees a light source in any scan", where=what, expected="lit, calibrated diodes")
    return seeing


def ratios_of(currents: FloatArray) -> FloatArray:
    """Return the ratios (A - C)/(A + C), (B - D)/(B + D) of contact currents (..., 4), shape (..., 2)."""
    sums, differences = currents[..., :2] + currents[..., 2:], currents[..., :2] - currents[..., 2:]
    return np.asarray(differences / sums)
