# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Scans of the independent truth for a calibration that is in memory, with the same calls as the estimator's model."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor.estimation.forward import empty_scans
from posor.estimation.sensor_stack import Stack
from posor.sensors.base import RowSensor

from posor_lab.independent.true_joint import TrueJoint

if TYPE_CHECKING:
    import numpy as np
    from posor.calibration.calibration_file import Calibration
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray, IntArray


class TruePosor:
    """POSORs that obey the independent model and differ from one calibration.

    The numbers of the calibration come from the product's reading of its file; those of an arm's files are read
    independently (``independent.true_arm``). The product states the amount of noise of each reading.
    """

    def __init__(self, calibration: Calibration) -> None:
        """Take the content of a calibration, its session applied."""
        self._joint = TrueJoint(calibration.model_dump(mode="json"))
        self._nominal = Stack([sensor.build() for sensor in calibration.sensors])

    def scans_at(
        self,
        stack: Stack,
        rotations: FloatArray,
        translations: FloatArray,
        stamps_ns: IntArray,
        *,
        supply_voltages: FloatArray | None = None,
        temperatures: FloatArray | None = None,
        noise: np.random.Generator | None = None,
    ) -> Scans:
        """Return the raw scans of n poses, as ``posor.estimation.forward.scans_at`` does.

        ``stack`` holds the true values of the parameters.
        """
        scans = empty_scans(stamps_ns)
        stated = {"supply_voltages": supply_voltages, "temperatures": temperatures}
        scans = scans.with_fields({name: values for name, values in stated.items() if values is not None})
        scans = scans.with_fields(self.joint(stack).readings(rotations, translations, supply_voltages, temperatures))
        return scans if noise is None else with_noise(scans, stack, noise)

    def joint(self, stack: Stack) -> TrueJoint:
        """Return the joint whose parameters have the values of ``stack``."""
        errors = stack.parameter_values - self._nominal.parameter_values
        return self._joint.with_errors(dict(zip(stack.parameter_names, errors.tolist(), strict=True)))


def with_noise(scans: Scans, stack: Stack, random: np.random.Generator) -> Scans:
    """Return scans with the noise that the product states for the readings of a stack."""
    for sensor in stack.sensors:
        if isinstance(sensor, RowSensor):
            scans = scans.with_fields(sensor.disturbed(scans, random))
    return scans
