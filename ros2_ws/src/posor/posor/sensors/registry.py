# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Find sensor types through the entry-point group ``posor.sensors``.

The value of an entry point is the sensor's calibration class (a ``SensorCalibration``); its name is the ``type`` that
calibration files use.
"""

from __future__ import annotations

from functools import cache, partial
from importlib.metadata import entry_points
from typing import get_args

from posor.errors import CalibrationError
from posor.plugins import load_class
from posor.sensors.base import SensorCalibration

GROUP = "posor.sensors"


@cache
def sensor_types() -> dict[str, type[SensorCalibration]]:
    """Return the calibration class of each installed sensor type.

    Raises CalibrationError: an installed entry point does not load, is not a sensor, does not declare its name as its
    ``type``, or has the name of another.
    """
    found: dict[str, type[SensorCalibration]] = {}
    for entry in entry_points(group=GROUP):
        where = f"sensor type '{entry.name}'"
        loaded = load_class(entry, SensorCalibration, partial(CalibrationError, where=where))
        declared = loaded.model_fields.get("type")
        if declared is None or get_args(declared.annotation) != (entry.name,):
            expected = f"the field type: Literal['{entry.name}'] in the class"
            raise CalibrationError("does not declare its name", where=where, expected=expected)
        if found.setdefault(entry.name, loaded) is not loaded:
            other = found[entry.name]
            what = f"is there twice, also as {other.__module__}:{other.__qualname__}"
            raise CalibrationError(what, where=where, expected="one package for each type")
    return found
