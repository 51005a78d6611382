"""Gap probes one by one: their gaps through the sensor's own model, and where they stand in the file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from posor_estimator.core.calibrate.parameters import the_sensor
from posor_estimator.core.calibration.quantity import Quantity
from posor_estimator.core.forward import empty_scans
from posor_estimator.core.sensors.gap_probes import GapProbesCalibration
from posor_estimator.core.stack import Stack
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.sensors.probe import ProbeCalibration
    from posor_estimator.core.types import BoolArray, FloatArray

ANYWHERE = [-1e6, 1e6]


@dataclass(frozen=True)
class OneProbe:
    """One gap probe, linearised by the sensor's own model with coefficients that may be tried out.

    Attributes:
        calibration: As the file has it.
        index: Its place among the probes.
        key: Where it stands in the file.
        sensor: The sensor that it is part of.

    """

    calibration: ProbeCalibration
    index: int
    key: str
    sensor: GapProbesCalibration

    @staticmethod
    def all_of(calibration: Calibration) -> list[OneProbe]:
        """Return all gap probes of a calibration.

        Raises:
            FitError: It has none.

        """
        at, sensor = the_sensor(calibration, GapProbesCalibration, "gap probes")
        return [
            OneProbe(probe, index, f"sensors[{at}].probes[{index}]", sensor)
            for index, probe in enumerate(sensor.probes)
        ]

    @property
    def name(self) -> str:
        """What to call it in complaints."""
        return f"gap probe {self.calibration.name}"

    def volts(self, scans: Scans) -> FloatArray:
        """Return its voltages with the zero shift added [V], (n,)."""
        return np.asarray(scans.gap_voltages[:, self.index] + self.calibration.zero_shift.number)

    def within(self, scans: Scans) -> BoolArray:
        """Return which voltages lie within the present range, (n,)."""
        low, high = self.calibration.range.array
        volts = self.volts(scans)
        return np.asarray((volts >= low) & (volts <= high))

    def gaps(self, scans: Scans, coefficients: FloatArray | None = None) -> FloatArray:
        """Return its gaps [m] at any voltage, (n,); coefficients (order + 1,), None: as calibrated."""
        return self._linearised(scans, _tried(coefficients))[0]

    def slopes(self, scans: Scans, coefficients: FloatArray | None = None) -> FloatArray:
        """Return how much its gap changes for a volt, without sign [m/V], (n,)."""
        return self._linearised(scans, _tried(coefficients))[1]

    def gaps_without_supply(self, scans: Scans) -> FloatArray:
        """Return its gaps [m] as they would be if it did not depend on the supply voltage, (n,)."""
        return self._linearised(scans, {"supply": None})[0]

    def effects(self, scans: Scans) -> FloatArray:
        """Return what a standard deviation of each number of supply and temperature does to its gaps [m], (n, q)."""
        columns = []
        for part in ("supply", "temperature"):
            now = getattr(self.calibration, part)
            for name in type(now).model_fields if now is not None else ():
                known: Quantity = getattr(now, name)
                if known.sigma:
                    moved = Quantity(value=known.number + known.sigmas.item(), unit=known.unit)
                    tried = self._linearised(scans, {part: now.model_copy(update={name: moved})})[0]
                    columns.append(tried - self.gaps(scans))
        return np.column_stack(columns) if columns else np.zeros((len(scans), 0))

    def polynomial_at(self, volts: FloatArray, tried: Quantity | None = None) -> tuple[FloatArray, FloatArray]:
        """Return a polynomial and its standard uncertainty as the estimator counts it [m], (n,) each.

        Args:
            volts: With the zero shift added [V], (n,).
            tried: Coefficients; None: as calibrated.

        """
        scans = empty_scans(np.zeros(len(volts), dtype=np.int64))
        scans = scans.with_fields({"gap_voltages": np.tile(volts[:, None], (1, len(self.sensor.probes)))})
        alone: dict[str, Quantity | None] = {
            "zero_shift": Quantity(value=0.0, unit="V"),
            "supply": None,
            "temperature": None,
        }
        gaps, _, sigmas = self._linearised(scans, alone | ({} if tried is None else {"volts_to_gap": tried}))
        return gaps, sigmas

    def _linearised(self, scans: Scans, update: dict[str, Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return gaps [m], slopes [m/V] and the gaps' standard uncertainty by the calibration [m], (n,) each."""
        anywhere = {
            "range": Quantity(value=ANYWHERE, unit="V"),
            "noise": Quantity(value=1.0, unit="V"),  # the variance is then the square of the slope
        }
        probe = self.calibration.model_copy(update=anywhere | update)
        alone = self.sensor.model_copy(update={"probes": [probe]})
        own = scans.with_fields({"gap_voltages": scans.gap_voltages[:, [self.index]]})
        sensor = alone.build()
        codes, batch = Stack([sensor]).linearise(own)
        bad = np.flatnonzero(codes[:, 0])
        if bad.size:
            raise FitError(
                f"voltage {own.gap_voltages[bad[0], 0]} of scan {own.numbers[bad[0]]}",
                where=self.name,
                expected="a finite voltage",
            )
        return batch.values[:, 0], np.sqrt(batch.variances[:, 0]), sensor.gap_sigmas(own)[:, 0]


def _tried(coefficients: FloatArray | None) -> dict[str, Any]:
    if coefficients is None:
        return {}
    return {"volts_to_gap": Quantity(value=coefficients.tolist(), unit="m/V^k")}
