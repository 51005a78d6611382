"""Where the numbers of a calibration file stand in a stack's parameter vector."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.sensors.base import SensorCalibration
    from posor_estimator.core.types import FloatArray, IntArray

SensorKind = TypeVar("SensorKind", bound="SensorCalibration")


def the_sensor(calibration: Calibration, kind: type[SensorKind], what: str) -> tuple[int, SensorKind]:
    """Return the one sensor of a kind and its index among the calibration's sensors.

    Raises:
        FitError: There is none, or there are several.

    """
    found = [(i, sensor) for i, sensor in enumerate(calibration.sensors) if isinstance(sensor, kind)]
    if len(found) != 1:
        count = "no" if not found else str(len(found))
        what_is = f"calibration '{calibration.name}' has {count} sensors of the type {_type_of(kind)}"
        raise FitError(what_is, where=what, expected="one")
    return found[0]


def _type_of(kind: type[SensorCalibration]) -> str:
    return str(kind.model_fields["type"].annotation.__args__[0])  # type: ignore[union-attr]


def indices(calibration: Calibration, sensor: int, names: Sequence[str]) -> IntArray:
    """Return where parameters of one sensor, such as ``zero_shifts[1]``, stand in the stack's vector, shape (k,)."""
    known = calibration.sensors[sensor].build().parameter_names
    first = first_index(calibration, sensor)
    return np.array([first + known.index(name) for name in names], dtype=np.int64)


def first_index(calibration: Calibration, sensor: int) -> int:
    """Return where the parameters of one sensor begin in the stack's vector."""
    return sum(part.build().parameter_values.size for part in calibration.sensors[:sensor])


def changed(values: FloatArray, where: IntArray, new: FloatArray) -> FloatArray:
    """Return a copy of a parameter vector with some entries replaced."""
    out = values.copy()
    out[where] = new
    return out
