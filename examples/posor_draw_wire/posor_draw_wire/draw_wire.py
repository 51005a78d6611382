# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Draw wires (string potentiometers): the lengths of wires between the receiving plate R and the target plate T.

Wire i is drawn out of its housing at the anchor ``a_i``, a point in R, and hooked to the attachment ``b_i``, a point in
T. At the pose ``T_R_T``, which takes a point ``p`` of T to ``rotation @ p + translation`` in R, it is as long as

    L_i = |rotation @ b_i + translation - a_i|    [m]

and its potentiometer gives a voltage with ``L_i = A_0 + A_1 V_i``.

Where the raw readings come from: a scan has no field of its own for draw wires, so they use ``ring_voltages`` [V], the
second set of analogue inputs of ``posor_msgs/RawScan``, wire after wire in the calibration file's order. The same POSOR
can therefore not have a bumpy ring, which reads that field too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from posor.calibration.file_model import EntryError, FrozenModel
from posor.calibration.quantity import Quantity, measured
from posor.errors import ScanError
from posor.model.fault import Fault
from posor.sensors.base import PlainReadings, PlainSensor, SensorCalibration
from pydantic import Field, model_validator

if TYPE_CHECKING:
    from posor.model.scan import Scan
    from posor.numerics.array_types import FloatArray


class WireCalibration(FrozenModel):
    """One wire.

    ``anchor`` is in R and ``attachment`` in T; ``volts_to_length`` are A_0 [m] and A_1 [m/V]; ``noise`` is the standard
    deviation of one averaged voltage; ``range`` is the calibrated span of the voltage, beyond which nothing is
    extrapolated: a wire that has snapped flies back into its housing and reads below it.
    """

    name: str
    anchor: Annotated[Quantity, measured("m", 3)]
    attachment: Annotated[Quantity, measured("m", 3)]
    volts_to_length: Annotated[Quantity, measured("m/V^k", 2)]
    noise: Annotated[Quantity, measured("V")]
    range: Annotated[Quantity, measured("V", 2)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.volts_to_length.array[1] == 0.0:
            what = f"volts_to_length {self.volts_to_length.value}"
            raise EntryError(what, key=("volts_to_length",), expected="a slope A_1 other than 0 m/V")
        if not self.noise.number > 0.0:
            raise EntryError(f"noise {self.noise.value}", key=("noise",), expected="more than 0 V")
        low, high = self.range.array
        if not low < high:
            raise EntryError(f"range {self.range.value}", key=("range",), expected="[lowest, highest] voltage")
        return self


class DrawWireCalibration(SensorCalibration):
    """The part of a calibration file that describes draw wires: what the entry point ``draw_wire`` names."""

    type: Literal["draw_wire"]
    wires: Annotated[list[WireCalibration], Field(min_length=1, max_length=8)]

    def build(self) -> DrawWires:
        """Return the sensor."""
        return DrawWires(self)


class DrawWires(PlainSensor):
    """Draw wires with their linearisation; one reading, the length [m], for each wire.

    The parameters, in the order of the parameter vector: ``anchors`` (n, 3) in R [m], ``attachments`` (n, 3) in T [m],
    ``volts_to_length`` (n, 2) [m, m/V].
    """

    def __init__(self, calibration: DrawWireCalibration) -> None:
        """Take the parameters and their standard uncertainties out of a validated calibration."""
        wires = calibration.wires
        self._names = tuple(wire.name for wire in wires)
        self._noises = np.array([wire.noise.number for wire in wires])
        self._ranges = np.array([wire.range.array for wire in wires])
        super().__init__(
            {
                "anchors": np.array([wire.anchor.array for wire in wires]),
                "attachments": np.array([wire.attachment.array for wire in wires]),
                "volts_to_length": np.array([wire.volts_to_length.array for wire in wires]),
            },
            {
                "anchors": np.array([wire.anchor.sigmas for wire in wires]),
                "attachments": np.array([wire.attachment.sigmas for wire in wires]),
                "volts_to_length": np.array([wire.volts_to_length.sigmas for wire in wires]),
            },
        )

    @property
    def reading_names(self) -> tuple[str, ...]:
        """``length <wire>`` for each wire."""
        return tuple(f"length {name}" for name in self._names)

    def read(self, scan: Scan) -> PlainReadings:
        """Return the lengths [m], their variances [m^2] and derivatives with respect to the parameters.

        With V the voltages: ``dL_i/dA_0 = 1``, ``dL_i/dA_1 = V_i``, and the noise of a voltage comes through the slope.

        Raises:
            ScanError: The scan has another number of voltages than there are wires, or a voltage is not finite or
                outside its calibrated range.

        """
        volts = scan.ring_voltages
        self._check(scan.number, volts)
        offset, slope = self._array("volts_to_length").T
        jacobian = np.zeros((volts.size, self._values.size))
        wire = np.arange(volts.size)
        by_offset, by_slope = self.parameter_ids("volts_to_length").T
        jacobian[wire, by_offset] = 1.0
        jacobian[wire, by_slope] = volts
        return PlainReadings(offset + slope * volts, np.square(slope * self._noises), jacobian)

    def _check(self, number: int, volts: FloatArray) -> None:
        """Raise the sentence on the first thing that is wrong with a scan's voltages."""
        where, count = f"scan {number}", len(self._names)
        if volts.size != count:
            what = f"{volts.size} draw wire voltages"
            raise ScanError(what, fault=Fault.BAD_READING, where=where, expected=f"{count}")
        for name, volt, (low, high) in zip(self._names, volts, self._ranges, strict=True):
            wire = f"{where}, draw wire {name}"
            if not np.isfinite(volt):
                what = f"voltage {volt}"
                raise ScanError(what, fault=Fault.BAD_READING, where=wire, expected="a finite voltage")
            if not low <= volt <= high:
                what = f"{volt:.6g} V is outside the calibrated range"
                raise ScanError(what, fault=Fault.OUT_OF_RANGE, where=wire, expected=f"{low:g} to {high:g} V")

    def _drawn(self, rotation: FloatArray, translation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the wires' lengths [m], shape (n,), and unit directions away from the anchors in R, shape (n, 3)."""
        spans = self._array("attachments") @ rotation.T + translation - self._array("anchors")
        lengths = np.linalg.norm(spans, axis=1)
        return lengths, spans / lengths[:, None]

    def predict(self, rotation: FloatArray, translation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the lengths [m] at ``T_R_T`` and their derivatives with respect to its local tangent, shape (n, 6).

        The tangent is pinocchio's: ``T_R_T * exp6((v, w))`` moves T by v [m] and turns it by w [rad], both in the axes
        of T. An attachment then moves by ``v + w x b``, and a wire with the unit direction ``u_T`` in the axes of T
        grows by ``u_T . (v + w x b) = u_T . v + (b x u_T) . w``.
        """
        lengths, directions = self._drawn(rotation, translation)
        in_target = directions @ rotation
        return lengths, np.hstack([in_target, np.cross(self._array("attachments"), in_target)])

    def predict_jacobian(self, rotation: FloatArray, translation: FloatArray) -> FloatArray:
        """Return the derivatives of the lengths with respect to the parameters at ``T_R_T``, shape (n, p).

        A wire grows by ``-u`` as its anchor moves in R, and by ``u_T`` as its attachment moves in T; the
        linearisation's parameters have no part in the prediction.
        """
        lengths, directions = self._drawn(rotation, translation)
        jacobian = np.zeros((lengths.size, self._values.size))
        wire = np.arange(lengths.size)[:, None]
        jacobian[wire, self.parameter_ids("anchors")] = -directions
        jacobian[wire, self.parameter_ids("attachments")] = directions @ rotation
        return jacobian
