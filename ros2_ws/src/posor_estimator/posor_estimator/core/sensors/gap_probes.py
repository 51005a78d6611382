"""Gap probes looking at a target plane: impedance, capacitance or any other probe with a voltage for a distance.

Source: thesis 5.3.1; voltage to gap, table 7.10; the tilt of the target plane, 8.3.1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import Field

from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.core.calibration.quantity import Quantity, measured
from posor_estimator.core.kernels import gap as kernel
from posor_estimator.core.kernels.readout import GAP_VOLTAGES
from posor_estimator.core.kernels.rows import GAP
from posor_estimator.core.sensors.base import Batch, Readout, RowSensor, SensorCalibration
from posor_estimator.core.sensors.probe import Channels, ProbeCalibration, probe_parameters
from posor_estimator.errors import CalibrationError, ScanError

if TYPE_CHECKING:
    from posor_estimator.core.calibration.session import Session
    from posor_estimator.core.scan import Scan, Scans
    from posor_estimator.core.types import FloatArray, IntArray


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
        channel = ("volts_to_gap", "zero_shifts", "supply", "temperature")
        ids = np.column_stack([self._ids(name) for name in channel])
        self._channels = Channels(self._probes, "gap probe", ids, self._values)

    def _layout(self) -> tuple[IntArray, IntArray, FloatArray]:
        count = len(self._names)
        ids = np.full((count, kernel.PARAMETERS), -1, dtype=np.int64)
        ids[:, 0:3] = self._ids("tips")
        ids[:, 3:6] = self._ids("axes")
        ids[:, 6:9] = self._ids("plane_point")
        ids[:, 9:11] = self._ids("plane_tilt")
        return np.full(count, GAP, dtype=np.int64), ids, np.zeros(ids.shape)

    @property
    def reading_names(self) -> tuple[str, ...]:
        """``gap <probe>`` for each probe."""
        return tuple(f"gap {name}" for name in self._names)

    def readout(self) -> Readout:
        """Return how the compiled kernels linearise the voltages."""
        return Readout(GAP_VOLTAGES, self._channels.numbers, self._channels.ids)

    def _chosen(self, scan: Scan) -> IntArray:  # noqa: ARG002  the same for every scan
        return np.arange(len(self._names))

    def linearise(self, scans: Scans, batch: Batch, first: int, offset: int) -> IntArray:
        """Write the gaps [m]; see ``Sensor.linearise``."""
        batch.chosen[:, first : first + len(self._names)] = offset + np.arange(len(self._names))
        return self._channels.linearise(scans.gap_voltages, scans, batch, first)

    def gap_sigmas(self, scans: Scans) -> FloatArray:
        """Return the standard uncertainties (n, p) [m] of the gaps of fit scans from their linearisation."""
        return self._channels.sigmas(scans.gap_voltages, scans, self._sigmas)

    def explain(self, scan: Scan, code: int) -> ScanError:
        """Return what a code of ``linearise`` means."""
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
