"""Gap probes looking at a target plane: impedance, capacitance or any other probe with a voltage for a distance.

Source: thesis 5.3.1; voltage to gap, table 7.10; the tilt of the target plane, 8.3.1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import Field

from posor_estimator.calibration.file_model import FrozenModel
from posor_estimator.calibration.quantity import Quantity, measured
from posor_estimator.errors import CalibrationError, ScanError
from posor_estimator.model.reading_rows import GAP, ROW
from posor_estimator.model.readings import GAP_VOLTAGES
from posor_estimator.sensors.base import ReadingSource, RowSensor, SensorCalibration, no_parameters
from posor_estimator.sensors.probe import Channels, ProbeCalibration, probe_parameters

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from posor_estimator.calibration.session import Session
    from posor_estimator.model.scan import Scan, Scans
    from posor_estimator.numerics.array_types import FloatArray, IntArray


class TargetPlaneCalibration(FrozenModel):
    """The surface that the probes see, in the frame of the target plate T.

    ``tilt`` are two angles about the axes X and Y of T: the normal toward the probes is ``Rx(tilt[0]) Ry(tilt[1])
    (0, 0, -1)``. They turn with the target: at another theta the same surface leans another way.
    """

    point: Annotated[Quantity, measured("m", 3)]
    tilt: Annotated[Quantity, measured("rad", 2)]


class GapProbesCalibration(SensorCalibration):
    """Any number of probes that look at one target plane."""

    type: Literal["gap_probes"]
    target_plane: TargetPlaneCalibration
    probes: Annotated[list[ProbeCalibration], Field(min_length=1, max_length=8)]

    def build(self) -> GapProbes:
        """Return the sensor."""
        return GapProbes(self)

    def for_session(self, session: Session) -> Self:
        """Return the calibration with the session's zero shifts.

        Raises:
            CalibrationError: The session has another number of shifts than there are probes.

        """
        shifts = session.zero_shifts
        if shifts is None:
            return self
        if shifts.array.shape != (len(self.probes),):
            raise CalibrationError(
                f"{shifts.array.size} values",
                where="zero_shifts of the session",
                expected=f"{len(self.probes)}, one for each gap probe",
            )
        probes = [
            probe.model_copy(update={"zero_shift": Quantity(value=float(value), sigma=float(sigma), unit="V")})
            for probe, value, sigma in zip(self.probes, shifts.array, shifts.sigmas, strict=True)
        ]
        return self.model_copy(update={"probes": probes})


class GapProbes(RowSensor):
    """Gap probes with their linearisation."""

    def __init__(self, calibration: GapProbesCalibration) -> None:
        """Take the parameters out of a validated calibration."""
        values, sigmas = probe_parameters(calibration.probes)
        plane = calibration.target_plane
        self._names = tuple(probe.name for probe in calibration.probes)
        self._probes = calibration.probes
        super().__init__(
            {**values, "plane_point": plane.point.array, "plane_tilt": plane.tilt.array},
            {**sigmas, "plane_point": plane.point.sigmas, "plane_tilt": plane.tilt.sigmas},
        )

    def _prepare(self) -> None:
        super()._prepare()
        self._channels = Channels(self._probes, "gap probe", self)

    def _layout(self) -> NDArray[np.void]:
        rows = np.zeros(len(self._names), dtype=ROW)
        rows["kind"] = GAP
        of_row = no_parameters(len(rows))
        of_row["tip"], of_row["axis"] = self.parameter_ids("tips"), self.parameter_ids("axes")
        of_row["plane_point"], of_row["tilt"] = self.parameter_ids("plane_point"), self.parameter_ids("plane_tilt")
        self.row_parameters = of_row["parameters"]
        return rows

    @property
    def reading_names(self) -> tuple[str, ...]:
        """``gap <probe>`` for each probe."""
        return tuple(f"gap {name}" for name in self._names)

    @property
    def reading_source(self) -> ReadingSource:
        """The gap voltages."""
        return ReadingSource(GAP_VOLTAGES, self._channels.parameters, self._channels.records)

    def selected_rows(self, scan: Scan) -> IntArray:  # noqa: ARG002  the same for every scan
        """Return all rows."""
        return np.arange(len(self._names))

    def gap_sigmas(self, scans: Scans) -> FloatArray:
        """Return the standard uncertainties (n, p) [m] of the gaps of fit scans from their linearisation."""
        return self._channels.sigmas(scans.gap_voltages, scans, self._sigmas)

    def explain(self, scan: Scan, code: int) -> ScanError:
        """Return what a code of the voltages means."""
        return self._channels.explain(scan.gap_voltages, scan, code)

    def encode(self, readings: FloatArray, scans: Scans) -> dict[str, FloatArray]:
        """Return the voltages of gaps; see ``RowSensor.encode``."""
        return {"gap_voltages": self._channels.encode(readings, scans)}

    def disturbed(self, scans: Scans, noise: np.random.Generator) -> dict[str, FloatArray]:
        """Return the voltages with noise."""
        return {
            "gap_voltages": scans.gap_voltages + noise.normal(size=scans.gap_voltages.shape) * self._channels.noises
        }

    def _linearisation_jacobian(self, scan: Scan) -> FloatArray:
        return self._channels.jacobian(scan.gap_voltages, scan, self._values.size)
