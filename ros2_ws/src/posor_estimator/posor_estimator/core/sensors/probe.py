"""One non-contact probe, as gap probes and ring probes share it: where it looks from, and what its voltage means."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from numpy.polynomial import polynomial
from pydantic import model_validator

from posor_estimator.core.calibration.entry import EntryError
from posor_estimator.core.calibration.part import FrozenModel
from posor_estimator.core.calibration.quantity import ANY, Quantity, check_unit_vector, measured
from posor_estimator.core.fault import Fault
from posor_estimator.core.kernels import voltage
from posor_estimator.core.kernels.readout import WRONG_COUNT
from posor_estimator.errors import ScanError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.scan import Scan, Scans
    from posor_estimator.core.sensors.base import Batch
    from posor_estimator.core.types import FloatArray, IntArray


class SupplyCalibration(FrozenModel):
    """How the gap read changes with the supply voltage, and the supply at which the probe was linearised."""

    sensitivity: Annotated[Quantity, measured("m/V")]
    reference: Annotated[Quantity, measured("V")]


class TemperatureCalibration(FrozenModel):
    """How the gap read changes with the plate's temperature, and the temperature of the linearisation."""

    sensitivity: Annotated[Quantity, measured("m/K")]
    reference: Annotated[Quantity, measured("K")]


class ProbeCalibration(FrozenModel):
    """One probe: where its tip is, where it looks, and what its voltage means.

    ``volts_to_gap`` are the coefficients A_0, A_1, ... of ``gap = sum_k A_k (V + zero_shift)^k``, any order; ``range``
    is the calibrated span of ``V + zero_shift``, outside of which nothing is extrapolated; ``noise`` is the standard
    deviation of one averaged voltage.
    """

    name: str
    tip: Annotated[Quantity, measured("m", 3)]
    axis: Annotated[Quantity, measured("1", 3)]
    volts_to_gap: Annotated[Quantity, measured("m/V^k", ANY)]
    zero_shift: Annotated[Quantity, measured("V")]
    noise: Annotated[Quantity, measured("V")]
    range: Annotated[Quantity, measured("V", 2)]
    supply: SupplyCalibration | None = None
    temperature: TemperatureCalibration | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        check_unit_vector("axis", self.axis)
        low, high = self.range.array
        if not low < high:
            raise EntryError(f"range {self.range.value}", key=("range",), expected="[lowest, highest] voltage")
        slope = polynomial.polyval(np.linspace(low, high, 257), polynomial.polyder(self.volts_to_gap.array))
        if not (np.all(slope > 0.0) or np.all(slope < 0.0)):
            what = f"volts_to_gap is not monotonic over the range {self.range.value} V"
            raise EntryError(what, key=("volts_to_gap",), expected="one gap for each voltage")
        if not self.noise.number > 0.0:
            raise EntryError(f"noise {self.noise.value}", key=("noise",), expected="more than 0 V")
        return self


def probe_parameters(probes: Sequence[ProbeCalibration]) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return values and standard uncertainties of what is calibrated of some probes, as named arrays."""
    order = max(probe.volts_to_gap.array.size for probe in probes)

    def of(attribute: str) -> dict[str, FloatArray]:
        def get(quantity: Quantity) -> FloatArray:
            return np.asarray(getattr(quantity, attribute))

        def padded(quantity: Quantity) -> FloatArray:
            return np.pad(get(quantity), (0, order - quantity.array.size))

        def pair(part: SupplyCalibration | TemperatureCalibration | None) -> FloatArray:
            return np.zeros(2) if part is None else np.array([get(part.sensitivity), get(part.reference)], dtype=float)

        return {
            "tips": np.array([get(p.tip) for p in probes]),
            "axes": np.array([get(p.axis) for p in probes]),
            "volts_to_gap": np.array([padded(p.volts_to_gap) for p in probes]),
            "zero_shifts": np.array([get(p.zero_shift) for p in probes]),
            "supply": np.array([pair(p.supply) for p in probes]),
            "temperature": np.array([pair(p.temperature) for p in probes]),
        }

    return of("array"), of("sigmas")


class Channels:
    """The voltage channels of some probes, taken out of a sensor's parameter vector.

    Attributes:
        names: Of the probes.
        noises: Standard deviation of each voltage [V], shape (p,).
        numbers: Of each channel, see ``kernels.voltage``, shape (p, n + 8).
        ids: Where each channel parameter stands in the sensor's parameter vector, shape (p, n + 5).

    """

    def __init__(self, probes: Sequence[ProbeCalibration], kind: str, ids: IntArray, values: FloatArray) -> None:
        """Lay out the channels.

        Args:
            probes: Calibration of the probes, for what is not a parameter.
            kind: What to call them in complaints, ``gap probe`` or ``ring probe``.
            ids: See the class.
            values: The sensor's parameter vector.

        """
        self.names = tuple(probe.name for probe in probes)
        self.ids = ids
        self._kind = kind
        ranges = np.array([probe.range.array for probe in probes])
        self.noises = np.array([probe.noise.number for probe in probes])
        self.numbers = np.column_stack([values[ids], ranges, self.noises])

    def linearise(self, volts: FloatArray, scans: Scans, batch: Batch, first: int) -> IntArray:
        """Linearise the voltages (n, p) of all scans into the batch from reading ``first`` on.

        Returns:
            For each scan zero or a code for ``explain``, shape (n,).

        """
        codes = np.full(len(scans), WRONG_COUNT, dtype=np.int64)
        if volts.shape[1] != len(self.names):
            return codes
        voltage.linearise_all(
            volts,
            scans.supply_voltages,
            scans.temperatures,
            self.numbers,
            batch.values,
            batch.variances,
            first,
            codes,
        )
        return codes

    def sigmas(self, volts: FloatArray, scans: Scans, parameter_sigmas: FloatArray) -> FloatArray:
        """Return the gaps' standard uncertainties (n, p) [m] from those of the channels' parameters, of fit scans."""
        out = np.empty(volts.shape)
        voltage.gap_sigmas(
            volts, scans.supply_voltages, scans.temperatures, self.numbers, parameter_sigmas[self.ids], out
        )
        return out

    def encode(self, gaps: FloatArray, scans: Scans) -> FloatArray:
        """Return the voltages (n, p) of gaps (n, p) [m]; NaN beyond the calibrated range."""
        volts = np.empty(gaps.shape)
        voltage.voltages_of_gaps(
            np.ascontiguousarray(gaps), scans.supply_voltages, scans.temperatures, self.numbers, volts
        )
        return volts

    def explain(self, volts: FloatArray, scan: Scan, code: int) -> ScanError:
        """Return what a code means."""
        where = f"scan {scan.number}"
        if code < 0:
            return ScanError(
                f"{volts.size} {self._kind} voltages",
                fault=Fault.BAD_READING,
                where=where,
                expected=f"{len(self.names)}",
            )
        probe, what = divmod(code - 1, 2)
        where = f"{where}, {self._kind} {self.names[probe]}"
        if what == voltage.NOT_FINITE - 1:
            return ScanError(
                f"voltage {volts[probe]}", fault=Fault.BAD_READING, where=where, expected="a finite voltage"
            )
        shift, low, high = self.numbers[probe, [-voltage.COLUMNS, -3, -2]]
        return ScanError(
            f"{volts[probe] + shift:.6g} V after the zero shift is outside the calibrated range",
            fault=Fault.OUT_OF_RANGE,
            where=where,
            expected=f"{low:g} to {high:g} V",
        )

    def jacobian(self, volts: FloatArray, scan: Scan, size: int) -> FloatArray:
        """Return d(gap)/d(parameter) of each probe, shape (p, size of the parameter vector)."""
        derivatives = np.empty(self.ids.shape)
        voltage.gap_derivatives(volts, scan.supply_voltage, scan.temperature, self.numbers, derivatives)
        out = np.zeros((len(self.names), size))
        np.put_along_axis(out, self.ids, derivatives, axis=1)
        return out
