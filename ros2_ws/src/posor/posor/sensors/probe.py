# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""One non-contact probe, as gap probes and ring probes share it: where it looks from, and what its voltage means."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.polynomial import polynomial
from pydantic import model_validator

from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.plausible_range import PLACE, TEMPERATURE, PlausibleRange
from posor.calibration.quantity import ANY, Quantity, check_unit_vector, measured
from posor.errors import ScanError
from posor.model.fault import Fault
from posor.model.readings import GAP_VOLTAGES, fault_of_code
from posor.model.voltage import (
    CHANNEL,
    CHANNEL_DERIVATIVES,
    CHANNEL_PARAMETERS,
    MAX_COEFFICIENTS,
    NOT_FINITE,
    linearise_channels,
    voltages_of_gaps,
)
from posor.numerics.compiled import record_view
from posor.sensors.base import ReadingSource, RowSensor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.model.scan import Scan, Scans
    from posor.numerics.array_types import FloatArray, IntArray
    from posor.sensors.base import Sensor


_BY_SUPPLY = PlausibleRange(-1e-3, 1e-3, {"in um/V": 1e-6, "in mm/V": 1e-3})
_BY_TEMPERATURE = PlausibleRange(-1e-4, 1e-4, {"in um/K": 1e-6, "in mm/K": 1e-3})
_GAP = PlausibleRange(-0.1, 0.1, {"in um": 1e-6, "in mm": 1e-3, "in inches": 0.0254})


class SupplyCalibration(FrozenModel):
    """How the gap read changes with the supply voltage, and the supply at which the probe was linearised."""

    sensitivity: Annotated[Quantity, measured("m/V")]
    reference: Annotated[Quantity, measured("V")]

    @model_validator(mode="after")
    def _check_sensitivity(self) -> Self:
        _BY_SUPPLY.check("sensitivity", self.sensitivity)
        return self


class TemperatureCalibration(FrozenModel):
    """How the gap read changes with the plate's temperature, and the temperature of the linearisation."""

    sensitivity: Annotated[Quantity, measured("m/K")]
    reference: Annotated[Quantity, measured("K")]

    @model_validator(mode="after")
    def _check_both(self) -> Self:
        _BY_TEMPERATURE.check("sensitivity", self.sensitivity)
        TEMPERATURE.check("reference", self.reference)
        return self


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
        PLACE.check("tip", self.tip)
        check_unit_vector("axis", self.axis)
        low, high = self.range.array
        if not low < high:
            raise EntryError(f"range {self.range.value}", key=("range",), expected="[lowest, highest] voltage")
        if self.volts_to_gap.array.size > MAX_COEFFICIENTS:
            what = f"volts_to_gap has {self.volts_to_gap.array.size} coefficients"
            raise EntryError(what, key=("volts_to_gap",), expected=f"at most {MAX_COEFFICIENTS}")
        slope = polynomial.polyval(np.linspace(low, high, 257), polynomial.polyder(self.volts_to_gap.array))
        if not (np.all(slope > 0.0) or np.all(slope < 0.0)):
            what = f"volts_to_gap is not monotonic over the range {self.range.value} V"
            raise EntryError(what, key=("volts_to_gap",), expected="one gap for each voltage")
        for volts, gap in zip((low, high), polynomial.polyval([low, high], self.volts_to_gap.array), strict=True):
            if expected := _GAP.expected(float(gap), "m"):
                raise EntryError(f"volts_to_gap is {gap:g} m at {volts:g} V", key=("volts_to_gap",), expected=expected)
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
    """The voltage channels of some probes, taken from a sensor's parameter vector.

    Attributes:
        names: Of the probes.
        noises: Standard deviation of each voltage [V], shape (p,).
        records: Calibration of each channel, shape (p,), dtype CHANNEL.
        parameters: Where each channel parameter stands in the sensor's parameter vector, negative for none, shape (p,
            CHANNEL_PARAMETERS).

    """

    def __init__(self, probes: Sequence[ProbeCalibration], kind: str, sensor: Sensor) -> None:
        """Lay out the channels.

        ``probes``: calibration of the probes, for what is not a parameter. ``kind``: what messages call them, ``gap
        probe`` or ``ring probe``. ``sensor``: holds the parameters, see ``probe_parameters``.
        """
        self.names = tuple(probe.name for probe in probes)
        self._kind = kind
        ids = sensor.parameter_ids("volts_to_gap")
        order = ids.shape[1]
        self.parameters: IntArray = np.full((len(probes), CHANNEL_PARAMETERS), -1, dtype=np.int64)
        self.parameters[:, :order] = ids
        extra = ("zero_shifts", "supply", "temperature")
        self.parameters[:, MAX_COEFFICIENTS:] = np.column_stack([sensor.parameter_ids(name) for name in extra])
        values = sensor.parameter_values
        self.records = np.zeros(len(probes), dtype=CHANNEL)
        self.records["parameters"] = np.where(self.parameters >= 0, values[self.parameters], 0.0)
        self.records["order"] = order
        ranges = np.array([probe.range.array for probe in probes])
        self.records["lowest"], self.records["highest"] = ranges.T
        self.noises = self.records["noise"] = np.array([probe.noise.number for probe in probes])

    def sigmas(self, volts: FloatArray, scans: Scans, parameter_sigmas: FloatArray) -> FloatArray:
        """Return the gaps' standard uncertainties (n, p) [m] from those of the channels' parameters, of valid scans."""
        known = np.where(self.parameters >= 0, parameter_sigmas[self.parameters], 0.0)
        effects = [self._derivatives(volts[n], scans[n]) * known for n in range(len(volts))]
        sigmas: FloatArray = np.sqrt(np.sum(np.square(np.reshape(effects, (len(volts), *known.shape))), axis=2))
        return sigmas

    def encode(self, gaps: FloatArray, scans: Scans) -> FloatArray:
        """Return the voltages (n, p) of gaps (n, p) [m]; NaN beyond the calibrated range."""
        volts = np.empty(gaps.shape)
        supplies = np.require(scans.supply_voltages, float, ["C", "W"])
        temperatures = np.require(scans.temperatures, float, ["C", "W"])
        voltages_of_gaps(np.ascontiguousarray(gaps), supplies, temperatures, record_view(self.records), volts)
        return volts

    def explain(self, volts: FloatArray, scan: Scan, code: int) -> ScanError:
        """Return what a code means."""
        where = f"scan {scan.number}"
        fault = Fault(fault_of_code(GAP_VOLTAGES, code))
        if code < 0:
            what = f"{volts.size} {self._kind} voltages"
            return ScanError(what, fault=fault, where=where, expected=f"{len(self.names)}")
        probe, what_code = divmod(code - 1, 2)
        where = f"{where}, {self._kind} {self.names[probe]}"
        if what_code == NOT_FINITE - 1:
            return ScanError(f"voltage {volts[probe]}", fault=fault, where=where, expected="a finite voltage")
        channel = self.records[probe]
        what = f"{volts[probe] + channel['zero_shift']:.6g} V after the zero shift is outside the calibrated range"
        return ScanError(what, fault=fault, where=where, expected=f"{channel['lowest']:g} to {channel['highest']:g} V")

    def _derivatives(self, volts: FloatArray, scan: Scan) -> FloatArray:
        """Return d(gap)/d(channel parameter), shape (p, CHANNEL_PARAMETERS)."""
        out = np.zeros(len(self.names), dtype=CHANNEL_DERIVATIVES)
        arguments = np.require(volts, float, ["C", "W"]), scan.supply_voltage, scan.temperature
        linearise_channels(*arguments, record_view(self.records), record_view(out))
        derivatives: FloatArray = -out["parameters"]
        return derivatives

    def jacobian(self, volts: FloatArray, scan: Scan, size: int) -> FloatArray:
        """Return d(gap)/d(parameter) of each probe, shape (p, size of the parameter vector)."""
        out = np.zeros((len(self.names), size))
        for row, ids, derivatives in zip(out, self.parameters, self._derivatives(volts, scan), strict=True):
            row[ids[ids >= 0]] = derivatives[ids >= 0]
        return out


class ProbeSensor(RowSensor):
    """Probes with their linearisation; a subclass states what surface they see (``_layout``)."""

    # which probes, ``gap`` or ``ring``: part of the names of readings and of the field with the voltages
    KIND: ClassVar[Literal["gap", "ring"]]
    VOLTAGES: ClassVar[int]  # index of these voltages for the kernels

    def __init__(
        self, probes: Sequence[ProbeCalibration], surface: dict[str, FloatArray], surface_sigmas: dict[str, FloatArray]
    ) -> None:
        """Take the parameters of probes, and those of the surface they see with their standard uncertainties."""
        self._probes = probes
        values, sigmas = probe_parameters(probes)
        super().__init__({**values, **surface}, {**sigmas, **surface_sigmas})

    def _prepare(self) -> None:
        super()._prepare()
        self._channels = Channels(self._probes, f"{self.KIND} probe", self)

    def _voltages(self, scans: Scan | Scans) -> FloatArray:
        voltages: FloatArray = getattr(scans, f"{self.KIND}_voltages")
        return voltages

    @property
    def reading_names(self) -> tuple[str, ...]:
        """``gap <probe>`` or ``ring <probe>`` for each probe."""
        return tuple(f"{self.KIND} {probe.name}" for probe in self._probes)

    @property
    def reading_source(self) -> ReadingSource:
        """The voltages."""
        return ReadingSource(self.VOLTAGES, self._channels.parameters, self._channels.records)

    def selected_rows(self, scan: Scan) -> IntArray:  # noqa: ARG002  the same for every scan
        """Return all rows."""
        return np.arange(len(self._probes))

    def explain(self, scan: Scan, code: int) -> ScanError:
        """Return what a code of the voltages means."""
        return self._channels.explain(self._voltages(scan), scan, code)

    def encode(self, readings: FloatArray, scans: Scans) -> dict[str, FloatArray]:
        """Return the voltages of gaps; see ``RowSensor.encode``."""
        return {f"{self.KIND}_voltages": self._channels.encode(readings, scans)}

    def disturbed(self, scans: Scans, noise: np.random.Generator) -> dict[str, FloatArray]:
        """Return the voltages with noise."""
        voltages = self._voltages(scans)
        return {f"{self.KIND}_voltages": voltages + noise.normal(size=voltages.shape) * self._channels.noises}

    def _linearisation_jacobian(self, scan: Scan) -> FloatArray:
        return self._channels.jacobian(self._voltages(scan), scan, self._values.size)
