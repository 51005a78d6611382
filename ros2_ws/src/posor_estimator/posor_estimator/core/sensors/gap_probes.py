"""Gap probes looking at a target plane: impedance, capacitance or any other probe with a voltage for a distance.

Source: thesis 5.3.1; voltage to gap, table 7.10; the tilt of the target plane, 8.3.1.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from numpy.polynomial import polynomial
from pydantic import Field, model_validator

from posor_estimator.core.calibration.quantity import ANY, FrozenModel, Quantity, measured
from posor_estimator.core.fault import Fault
from posor_estimator.core.kernels import gap as kernel
from posor_estimator.core.kernels.solve import GAP
from posor_estimator.core.sensors.base import ROW_WIDTH, Linearised, Sensor, SensorCalibration
from posor_estimator.errors import CalibrationError, ScanError

if TYPE_CHECKING:
    from posor_estimator.core.calibration.session import Session
    from posor_estimator.core.scan import Scan
    from posor_estimator.core.types import FloatArray, IntArray


class TargetPlaneCalibration(FrozenModel):
    """The surface that the probes see, in the frame of the target plate T.

    ``tilt`` are two angles about the axes X and Y of T: the normal toward the probes is ``Rx(tilt[0]) Ry(tilt[1])
    (0, 0, -1)``. They turn with the target: at another theta the same surface leans another way.
    """

    point: Annotated[Quantity, measured("m", 3)]
    tilt: Annotated[Quantity, measured("rad", 2)]


class GapProbeCalibration(FrozenModel):
    """One probe: where its tip is, where it looks, and what its voltage means.

    ``volts_to_gap`` are the coefficients A_0, A_1, ... of ``gap = sum_k A_k (V + zero_shift)^k``, any order; ``range``
    is the calibrated span of ``V + zero_shift``, outside of which nothing is extrapolated.
    """

    name: str
    tip: Annotated[Quantity, measured("m", 3)]
    axis: Annotated[Quantity, measured("1", 3)]
    volts_to_gap: Annotated[Quantity, measured("m/V^k", ANY)]
    zero_shift: Annotated[Quantity, measured("V")]
    noise: Annotated[Quantity, measured("V")]
    range: Annotated[Quantity, measured("V", 2)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        length = float(np.linalg.norm(self.axis.array))
        if abs(length - 1.0) > 1e-6:  # noqa: PLR2004
            msg = f"axis {self.axis.value} has length {length:.9g}, expected a unit vector"
            raise ValueError(msg)
        low, high = self.range.array
        if not low < high:
            msg = f"range {self.range.value}, expected [lowest, highest] voltage"
            raise ValueError(msg)
        slope = polynomial.polyval(np.linspace(low, high, 257), polynomial.polyder(self.volts_to_gap.array))
        if not (np.all(slope > 0.0) or np.all(slope < 0.0)):
            msg = (
                f"volts_to_gap is not monotonic over the range {self.range.value} V, expected one gap for each voltage"
            )
            raise ValueError(msg)
        if not self.noise.number > 0.0:
            msg = f"noise {self.noise.value}, expected more than 0 V"
            raise ValueError(msg)
        return self


class GapProbesCalibration(SensorCalibration):
    """Any number of probes that look at one target plane."""

    type: Literal["gap_probes"]
    target_plane: TargetPlaneCalibration
    probes: Annotated[list[GapProbeCalibration], Field(min_length=1, max_length=8)]

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


def plane_normal(tilt: FloatArray) -> FloatArray:
    """Return the unit normal toward the probes, in T, of a plane tilted by ``tilt`` = (about X, about Y) [rad]."""
    sx, cx = math.sin(tilt[0]), math.cos(tilt[0])
    sy, cy = math.sin(tilt[1]), math.cos(tilt[1])
    return np.array([-sy, sx * cy, -cx * cy])


def plane_normal_jacobian(tilt: FloatArray) -> FloatArray:
    """Return the derivative of ``plane_normal`` with respect to the two angles, shape (3, 2)."""
    sx, cx = math.sin(tilt[0]), math.cos(tilt[0])
    sy, cy = math.sin(tilt[1]), math.cos(tilt[1])
    return np.array([[0.0, -cy], [cx * cy, -sx * sy], [sx * cy, cx * sy]])


class GapProbes(Sensor):
    """Gap probes with their linearisation: ``gap = sum_k A_k (V + zero_shift)^k``."""

    def __init__(self, calibration: GapProbesCalibration) -> None:
        """Take the parameters out of a validated calibration."""
        probes = calibration.probes
        self._names = tuple(probe.name for probe in probes)
        self._ranges = np.array([probe.range.array for probe in probes])
        self._noise = np.array([probe.noise.number for probe in probes])
        order = max(probe.volts_to_gap.array.size for probe in probes)
        plane = calibration.target_plane

        def padded(coefficients: FloatArray) -> FloatArray:
            return np.pad(coefficients, (0, order - coefficients.size))

        super().__init__(
            {
                "tips": np.array([p.tip.array for p in probes]),
                "axes": np.array([p.axis.array for p in probes]),
                "volts_to_gap": np.array([padded(p.volts_to_gap.array) for p in probes]),
                "zero_shifts": np.array([p.zero_shift.number for p in probes]),
                "plane_point": plane.point.array,
                "plane_tilt": plane.tilt.array,
            },
            {
                "tips": np.array([p.tip.sigmas for p in probes]),
                "axes": np.array([p.axis.sigmas for p in probes]),
                "volts_to_gap": np.array([padded(p.volts_to_gap.sigmas) for p in probes]),
                "zero_shifts": np.array([p.zero_shift.sigmas for p in probes]),
                "plane_point": plane.point.sigmas,
                "plane_tilt": plane.tilt.sigmas,
            },
        )

    def _prepare(self) -> None:
        p = self._parameters
        count = len(self._names)
        self._rows = np.zeros((count, ROW_WIDTH))
        self._rows[:, 0:3] = p["tips"]
        self._rows[:, 3:6] = p["axes"]
        self._rows[:, 6:9] = p["plane_point"]
        self._rows[:, 9:12] = plane_normal(p["plane_tilt"])
        self._kinds = np.full(count, GAP, dtype=np.int64)
        self._slopes = polynomial.polyder(p["volts_to_gap"].T).T

    @property
    def reading_names(self) -> tuple[str, ...]:
        """``gap <probe>`` for each probe."""
        return tuple(f"gap {name}" for name in self._names)

    @property
    def kinds(self) -> IntArray:
        """All rows are gaps."""
        return self._kinds

    def rows(self, scan: Scan) -> FloatArray:  # noqa: ARG002  the same for every scan
        """Return the geometry rows, shape (probes, ROW_WIDTH)."""
        return self._rows

    def _volts(self, scan: Scan) -> FloatArray:
        """Return the zero-shifted voltages [V]."""
        volts = scan.gap_voltages
        if volts.shape != (len(self._names),):
            raise ScanError(
                f"{volts.size} gap voltages",
                fault=Fault.BAD_READING,
                where=f"scan {scan.number}",
                expected=f"{len(self._names)}",
            )
        return np.asarray(volts + self._parameters["zero_shifts"])

    def linearise(self, scan: Scan) -> Linearised:
        """Return the gaps [m] and their variances [m^2]."""
        volts = self._volts(scan)
        for name, volt, (low, high) in zip(self._names, volts, self._ranges, strict=True):
            where = f"scan {scan.number}, gap probe {name}"
            if not math.isfinite(volt):
                raise ScanError(f"voltage {volt}", fault=Fault.BAD_READING, where=where, expected="a finite voltage")
            if not low <= volt <= high:
                raise ScanError(
                    f"{volt:.6g} V after the zero shift is outside the calibrated range",
                    fault=Fault.OUT_OF_RANGE,
                    where=where,
                    expected=f"{low:g} to {high:g} V",
                )
        gaps = polynomial.polyval(volts, self._parameters["volts_to_gap"].T, tensor=False)
        slopes = polynomial.polyval(volts, self._slopes.T, tensor=False)
        return Linearised(gaps, np.square(slopes * self._noise))

    def residual_jacobian(self, scan: Scan, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return d(gap read - gap predicted)/d(parameter), shape (probes, p)."""
        count = len(self._names)
        volts = self._volts(scan)
        geometry = np.empty(kernel.PARAMETERS)
        tilt = plane_normal_jacobian(self._parameters["plane_tilt"])
        out = np.zeros((count, self._sigmas.size))
        order = self._parameters["volts_to_gap"].shape[1]
        for i in range(count):
            kernel.gap_parameters(self._rows[i], rotation, translation, geometry)
            own = slice(3 * i, 3 * i + 3)
            out[i, self._slices["tips"]][own] = -geometry[0:3]
            out[i, self._slices["axes"]][own] = -geometry[3:6]
            out[i, self._slices["volts_to_gap"]][order * i : order * (i + 1)] = volts[i] ** np.arange(order)
            out[i, self._slices["zero_shifts"]][i] = polynomial.polyval(volts[i], self._slopes[i])
            out[i, self._slices["plane_point"]] = -geometry[6:9]
            out[i, self._slices["plane_tilt"]] = -geometry[9:12] @ tilt
        return out
