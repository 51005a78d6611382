"""Gap probes one by one: their gaps through the sensor's own model, and where they stand in the file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.calibration.quantity import Quantity
from posor_estimator.core.sensors.gap_probes import GapProbesCalibration
from posor_estimator.core.stack import Stack
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.sensors.probe import ProbeCalibration
    from posor_estimator.core.types import BoolArray, FloatArray

ANYWHERE = [-1e6, 1e6]


def gap_probes_of(calibration: Calibration) -> tuple[int, GapProbesCalibration]:
    """Return the gap probes of a calibration, and which of its sensors they are.

    Raises:
        FitError: It has none.

    """
    for index, sensor in enumerate(calibration.sensors):
        if isinstance(sensor, GapProbesCalibration):
            return index, sensor
    raise FitError(
        f"calibration '{calibration.name}' has no gap probes",
        expected=f"a sensor of type gap_probes beside {', '.join(type(s).__name__ for s in calibration.sensors)}",
    )


class OneProbe:
    """One gap probe, linearised by the sensor's own model with coefficients that may be tried out.

    Attributes:
        calibration: As the file has it.
        key: Where it stands in the file.

    """

    def __init__(self, calibration: Calibration, probe: int) -> None:
        """Take one probe out of a calibration."""
        index, self._sensor = gap_probes_of(calibration)
        self._probe = probe
        self.calibration: ProbeCalibration = self._sensor.probes[probe]
        self.key = f"sensors[{index}].probes[{probe}]"

    @property
    def name(self) -> str:
        """What to call it in complaints."""
        return f"gap probe {self.calibration.name}"

    def volts(self, scans: Scans) -> FloatArray:
        """Return its voltages with the zero shift added [V], (n,)."""
        return np.asarray(scans.gap_voltages[:, self._probe] + self.calibration.zero_shift.number)

    def within(self, scans: Scans) -> BoolArray:
        """Return which voltages lie within the present range, (n,)."""
        low, high = self.calibration.range.array
        volts = self.volts(scans)
        return np.asarray((volts >= low) & (volts <= high))

    def gaps(self, scans: Scans, coefficients: FloatArray | None = None) -> FloatArray:
        """Return its gaps [m] at any voltage, (n,); coefficients (order + 1,), None: as calibrated."""
        return self._linearised(scans, coefficients)[0]

    def slopes(self, scans: Scans, coefficients: FloatArray | None = None) -> FloatArray:
        """Return how much its gap changes for a volt, without sign [m/V], (n,)."""
        return self._linearised(scans, coefficients)[1]

    def gap_sigmas(self, scans: Scans) -> FloatArray:
        """Return the standard uncertainty of its gaps from the present calibration [m], (n,)."""
        return self._linearised(scans, None)[2]

    def _linearised(self, scans: Scans, coefficients: FloatArray | None) -> tuple[FloatArray, FloatArray, FloatArray]:
        update = {
            "range": Quantity(value=ANYWHERE, unit="V"),
            "noise": Quantity(value=1.0, unit="V"),  # the variance is then the square of the slope
        }
        if coefficients is not None:
            update["volts_to_gap"] = Quantity(value=coefficients.tolist(), unit="m/V^k")
        alone = self._sensor.model_copy(update={"probes": [self.calibration.model_copy(update=update)]})
        own = scans.with_fields({"gap_voltages": scans.gap_voltages[:, [self._probe]]})
        codes, batch = Stack([alone.build()]).linearise(own)
        bad = np.flatnonzero(codes[:, 0])
        if bad.size:
            raise FitError(f"voltage {own.gap_voltages[bad[0], 0]} of scan {own.numbers[bad[0]]}", where=self.name)
        return batch.values[:, 0], np.sqrt(batch.variances[:, 0]), np.sqrt(batch.systematic[:, 0, 0])
