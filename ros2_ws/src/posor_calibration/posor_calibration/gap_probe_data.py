# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Single gap probes, evaluated by the sensor's own model, and their reference gaps at dwells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from posor.bags.recording import POINT, POSE, SCALAR, unpack_poses
from posor.calibration.calibration_file import find_sensor
from posor.calibration.quantity import Quantity
from posor.errors import FitError
from posor.estimation.forward import empty_scans, readings_at
from posor.estimation.sensor_stack import Stack
from posor.model.scan import PROBES_ESTIMATED, SATURATED
from posor.sensors.gap_probes import GapProbesCalibration
from pydantic import Field

from posor_calibration.data_checks import check_axis, check_channels_move, check_count, check_unit
from posor_calibration.dwells import DwellOptions, average_recording

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import BoolArray, FloatArray
    from posor.sensors.gap_probes import GapProbes
    from posor.sensors.probe import ProbeCalibration

    from posor_calibration.dwells import DwellMeans

MICRO = 1e6
MIN_DWELLS = 6
AXES = ("x", "y", "z")
UNLIMITED = Quantity(value=[-1e6, 1e6], unit="V")
_COLUMNS = {"scalar": SCALAR, "point": POINT, "pose": POSE}


@dataclass(frozen=True)
class SingleProbe:
    """One gap probe of a sensor."""

    calibration: ProbeCalibration
    index: int
    key: str  # where it stands in the file
    sensor: GapProbesCalibration

    @property
    def name(self) -> str:
        """Name for messages."""
        return f"gap probe {self.calibration.name}"

    def shifted_volts(self, scans: Scans) -> FloatArray:
        """Return its voltages with the zero shift added [V], (n,)."""
        return np.asarray(scans.gap_voltages[:, self.index] + self.calibration.zero_shift.number)

    def in_range(self, scans: Scans) -> BoolArray:
        """Return which voltages are in the calibrated range, (n,)."""
        low, high = self.calibration.range.array
        volts = self.shifted_volts(scans)
        return np.asarray((volts >= low) & (volts <= high))

    def gaps(
        self,
        scans: Scans,
        coefficients: FloatArray | None = None,
        *,
        without: Literal["supply", "temperature"] | None = None,
    ) -> FloatArray:
        """Return its gaps [m] at any voltage (n,), by its own polynomial or other ``coefficients`` (order + 1,).

        ``without`` names a quantity on which the gaps shall not depend.
        """
        update = _use_coefficients(coefficients) | ({} if without is None else {without: None})
        return self._linearise(scans, update)[0]

    def slopes(self, scans: Scans, coefficients: FloatArray | None = None) -> FloatArray:
        """Return the absolute slope of its gap over the voltage [m/V], (n,)."""
        return self._linearise(scans, _use_coefficients(coefficients))[1]

    def environment_effects(self, scans: Scans) -> FloatArray:
        """Return the effect of a standard deviation of each supply and temperature number on its gaps [m], (n, q)."""
        columns, present_gaps = [], self.gaps(scans)
        for part in ("supply", "temperature"):
            present = getattr(self.calibration, part)
            for name in type(present).model_fields if present is not None else ():
                known: Quantity = getattr(present, name)
                if known.sigma:
                    shifted = Quantity(value=known.number + known.sigmas.item(), unit=known.unit)
                    moved = self._linearise(scans, {part: present.model_copy(update={name: shifted})})[0]
                    columns.append(moved - present_gaps)
        return np.column_stack(columns) if columns else np.zeros((len(scans), 0))

    def evaluate_polynomial(
        self, volts: FloatArray, polynomial: Quantity | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the gap by a polynomial (None: its own) and its standard uncertainty in the estimator [m], (n,) each.

        ``volts`` [V] (n,) include the zero shift.
        """
        scans = empty_scans(np.zeros(len(volts), dtype=np.int64))
        scans = scans.with_fields({"gap_voltages": np.tile(volts[:, None], (1, len(self.sensor.probes)))})
        update: dict[str, Any] = {"zero_shift": Quantity(value=0.0, unit="V"), "supply": None, "temperature": None}
        update |= {} if polynomial is None else {"volts_to_gap": polynomial}
        return self._linearise(scans, update)[0], self._build(update).gap_sigmas(self._own(scans))[:, 0]

    def _build(self, update: dict[str, Any]) -> GapProbes:
        """Return a sensor of this probe only, with some parts replaced and an unlimited range."""
        # With a noise of 1 V the variance of a gap is the square of its slope.
        unbounded = {"range": UNLIMITED, "noise": Quantity(value=1.0, unit="V")}
        probe = self.calibration.model_copy(update=unbounded | update)
        return self.sensor.model_copy(update={"probes": [probe]}).build()

    def _own(self, scans: Scans) -> Scans:
        return scans.with_fields({"gap_voltages": scans.gap_voltages[:, [self.index]]})

    def _linearise(self, scans: Scans, update: dict[str, Any]) -> tuple[FloatArray, FloatArray]:
        """Return gaps [m] and absolute slopes [m/V], (n,) each."""
        own = self._own(scans)
        readings = Stack([self._build(update)]).linearise(own)
        bad = np.flatnonzero(~readings.valid)
        if bad.size:
            what = f"voltage {own.gap_voltages[bad[0], 0]} of scan {own.numbers[bad[0]]}"
            raise FitError(what, where=self.name, expected="a finite voltage")
        return readings.values[:, 0], np.sqrt(readings.variances[:, 0])


def _use_coefficients(coefficients: FloatArray | None) -> dict[str, Any]:
    return {} if coefficients is None else {"volts_to_gap": Quantity(value=coefficients.tolist(), unit="m/V^k")}


def list_probes(calibration: Calibration) -> list[SingleProbe]:
    """Return all gap probes of a calibration; raise FitError if it has none."""
    at, sensor = find_sensor(calibration, GapProbesCalibration, "gap probes")
    return [
        SingleProbe(probe, index, f"sensors[{at}].probes[{index}]", sensor) for index, probe in enumerate(sensor.probes)
    ]


class GapReferenceOptions(DwellOptions):
    """Options of a procedure whose reference measures gaps."""

    kind: Literal["scalar", "point", "pose"] = Field(
        default="scalar",
        description="what the reference measures: the travel of the target toward or away from all probes alike "
        "(scalar), a point with this travel along one axis (point), or the target's pose in the receiving frame (pose)",
    )
    axis: Literal["x", "y", "z"] = Field(default="z", description="of a point: the axis along which the gaps change")
    direction: Literal[1, -1] = Field(
        default=1, description="of scalar and point: 1 where the reference grows with the gaps, -1 where it falls"
    )
    uncalibrated: bool = Field(
        default=False,
        description="the probes have no calibration yet: do not compare unit and sign of the reference with it",
    )


@dataclass(frozen=True)
class GapData:
    """Readings of one probe and reference gaps at dwells."""

    scans: Scans  # means, (d,)
    reference: FloatArray  # gaps up to a constant [m], (d,)
    reference_sigmas: FloatArray  # [m], (d,)
    volt_sigmas: FloatArray  # [V], (d,)

    def select(self, which: BoolArray) -> GapData:
        """Return some of the dwells."""
        return GapData(
            self.scans.select(which), self.reference[which], self.reference_sigmas[which], self.volt_sigmas[which]
        )


def read_gap_data(
    recording: Recording, calibration: Calibration, options: GapReferenceOptions, where: str
) -> tuple[DwellMeans, list[tuple[SingleProbe, GapData]]]:
    """Return the dwell means of a recording, and the data of each probe.

    Scans whose probe voltages were substituted or saturated are left out. Where the reference is a pose, the geometry
    of the calibration converts it into gaps. Raises FitError: there are too few dwells, or a channel is stuck;
    TrackError: the reference is unusable, has another unit or sign, or moves along another axis.
    """
    track = recording.find_track(options.reference, _COLUMNS[options.kind])
    found = average_recording(recording.without_status(PROBES_ESTIMATED | SATURATED), track, options)
    check_count(len(found), MIN_DWELLS, "dwells of the reference with scans", where)
    probes = list_probes(calibration)
    return found, [(probe, _match_gap_data(probe, found, calibration, options, recording.source)) for probe in probes]


def _match_gap_data(
    probe: SingleProbe, means: DwellMeans, calibration: Calibration, options: GapReferenceOptions, source: str
) -> GapData:
    """Return the data of one probe, after checking that reference and readings belong together."""
    volts = probe.shifted_volts(means.scans)
    spreads = means.sigmas("gap_voltages")[:, probe.index]
    volt_sigmas = np.where(np.isfinite(spreads), spreads, probe.calibration.noise.number)
    check_channels_move((probe.name,), volts[:, None], spreads[:, None], means.reference, source)
    if options.kind == "point":
        check_axis(volts, means.reference, AXES.index(options.axis), AXES, source)
    if options.kind == "pose":
        stack = Stack([sensor.build() for sensor in calibration.sensors])
        column = stack.reading_names.index(f"gap {probe.calibration.name}")
        gaps = readings_at(stack, *unpack_poses(means.reference))[:, column]
        # The plane hardly moves across: a gap is as uncertain as the pose along Z.
        sigmas = means.reference_sigmas[:, AXES.index("z")]
    else:
        column = AXES.index(options.axis) if options.kind == "point" else 0
        gaps, sigmas = options.direction * means.reference[:, column], means.reference_sigmas[:, column]
    usable = probe.in_range(means.scans)
    if not options.uncalibrated and np.count_nonzero(usable) > 1:
        present = probe.gaps(means.scans.select(usable))
        check_unit(present, gaps[usable], f"{source}, reference of {probe.name}", "metres")
    return GapData(means.scans, gaps, sigmas, volt_sigmas)
