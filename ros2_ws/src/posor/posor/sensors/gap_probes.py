# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Gap probes looking at a target plane: impedance, capacitance or any other probe with a voltage for a distance.

Source: thesis 5.3.1; voltage to gap, table 7.10; the tilt of the target plane, 8.3.1.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from posor.calibration.file_model import EntryError, FrozenModel, format_value
from posor.calibration.plausible_range import PLACE
from posor.calibration.quantity import Quantity, check_positive, measured
from posor.errors import CalibrationError
from posor.model.reading_rows import GAP, ROW
from posor.model.readings import GAP_VOLTAGES
from posor.sensors.base import SensorCalibration, no_parameters
from posor.sensors.probe import ProbeCalibration, ProbeSensor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from posor.calibration.session import Session
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray, IntArray


LEAST_AXIS_Z = 0.5  # Z of the axis of a probe that looks at the target plane


class TargetPlaneCalibration(FrozenModel):
    """The surface that the probes see, in the frame of the target plate T.

    ``tilt`` are two angles about the axes X and Y of T: the normal toward the probes is ``Rx(tilt[0]) Ry(tilt[1])
    (0, 0, -1)``. They turn with the target: at another theta the same surface leans another way.
    """

    point: Annotated[Quantity, measured("m", 3)]
    tilt: Annotated[Quantity, measured("rad", 2)]

    @model_validator(mode="after")
    def _check_point(self) -> Self:
        PLACE.check("point", self.point)
        return self


class ReferenceVoltage(FrozenModel):
    """A known voltage that the converter of the probes reads in each scan, so that its gain is corrected.

    ``voltage`` with its standard uncertainty; ``noise`` of a reading; ``limit``: largest deviation of the gain from one
    that is corrected, beyond it there is no pose; ``spread``: standard uncertainty of the gain in scans without a
    reading.
    """

    voltage: Annotated[Quantity, measured("V")]
    noise: Annotated[Quantity, measured("V")]
    limit: Annotated[Quantity, measured("1")]
    spread: Annotated[Quantity, measured("1")]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        check_positive("voltage", self.voltage)
        check_positive("noise", self.noise, or_zero=True)
        check_positive("limit", self.limit, below=1.0)
        check_positive("spread", self.spread, or_zero=True)
        return self

    @property
    def relative_sigma(self) -> float:
        """Relative standard uncertainty of the gain by one reading."""
        return math.hypot(float(self.voltage.sigmas), self.noise.number) / self.voltage.number


class GapProbesCalibration(SensorCalibration):
    """Any number of probes that look at one target plane.

    ``reference``: known voltage of the converter that reads all probes, gap and ring; missing: the converter has none.
    """

    type: Literal["gap_probes"]
    target_plane: TargetPlaneCalibration
    probes: Annotated[list[ProbeCalibration], Field(min_length=1, max_length=8)]
    reference: ReferenceVoltage | None = None

    @model_validator(mode="after")
    def _check_axes(self) -> Self:
        for n, probe in enumerate(self.probes):
            if probe.axis.array[2] < LEAST_AXIS_Z:
                expected = "the direction from the probe to the target, about [0.0, 0.0, 1.0]"
                raise EntryError(f"axis {format_value(probe.axis.value)}", key=("probes", n, "axis"), expected=expected)
        return self

    def build(self) -> GapProbes:
        """Return the sensor."""
        return GapProbes(self)

    def for_session(self, session: Session) -> Self:
        """Return the calibration with the session's zero shifts.

        Raises CalibrationError: the session has another number of shifts than there are probes.
        """
        shifts = session.zero_shifts
        if shifts is None:
            return self
        if shifts.array.shape != (len(self.probes),):
            expected = f"{len(self.probes)}, one for each gap probe"
            raise CalibrationError(f"{shifts.array.size} values", where="zero_shifts of the session", expected=expected)
        probes = [
            probe.model_copy(update={"zero_shift": Quantity(value=float(value), sigma=float(sigma), unit="V")})
            for probe, value, sigma in zip(self.probes, shifts.array, shifts.sigmas, strict=True)
        ]
        return self.model_copy(update={"probes": probes})


class GapProbes(ProbeSensor):
    """Gap probes and the target plane that they see."""

    KIND, VOLTAGES = "gap", GAP_VOLTAGES

    def __init__(self, calibration: GapProbesCalibration) -> None:
        """Take the parameters out of a validated calibration."""
        plane, self._reference = calibration.target_plane, calibration.reference
        super().__init__(
            calibration.probes,
            {"plane_point": plane.point.array, "plane_tilt": plane.tilt.array},
            {"plane_point": plane.point.sigmas, "plane_tilt": plane.tilt.sigmas},
        )

    def _layout(self) -> tuple[NDArray[np.void], IntArray]:
        rows = np.zeros(len(self._probes), dtype=ROW)
        rows["kind"] = GAP
        of_row = no_parameters(len(rows))
        of_row["tip"], of_row["axis"] = self.parameter_ids("tips"), self.parameter_ids("axes")
        of_row["plane_point"], of_row["tilt"] = self.parameter_ids("plane_point"), self.parameter_ids("plane_tilt")
        return rows, of_row["parameters"]

    def encode(self, readings: FloatArray, scans: Scans) -> dict[str, FloatArray]:
        """Return the voltages of gaps and the known voltage; see ``RowSensor.encode``."""
        fields = super().encode(readings, scans)
        if self._reference is not None:
            fields["reference_voltages"] = np.full(len(readings), self._reference.voltage.number)
        return fields

    def disturbed(self, scans: Scans, noise: np.random.Generator) -> dict[str, FloatArray]:
        """Return the voltages with noise, that of the known voltage too."""
        fields = super().disturbed(scans, noise)
        if self._reference is not None:
            random = noise.normal(size=len(scans))
            fields["reference_voltages"] = scans.reference_voltages + random * self._reference.noise.number
        return fields

    def gap_sigmas(self, scans: Scans) -> FloatArray:
        """Return the standard uncertainties (n, p) [m] of the gaps of fit scans from their linearisation."""
        return self._channels.sigmas(scans.gap_voltages, scans, self._sigmas)
