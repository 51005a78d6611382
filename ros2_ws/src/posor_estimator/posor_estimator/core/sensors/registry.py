"""Find sensor types through the entry-point group ``posor_estimator.sensors``.

The value of an entry point is the sensor's calibration class (a ``SensorCalibration``); its name is the ``type`` that
calibration files use.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points

from posor_estimator.core.sensors.base import SensorCalibration
from posor_estimator.errors import CalibrationError

GROUP = "posor_estimator.sensors"


@cache
def sensor_types() -> dict[str, type[SensorCalibration]]:
    """Return the calibration class of each installed sensor type.

    Raises:
        CalibrationError: An installed entry point does not load, or is not a sensor.

    """
    found: dict[str, type[SensorCalibration]] = {}
    for entry in entry_points(group=GROUP):
        where = f"sensor type '{entry.name}' ({entry.value})"
        try:
            loaded = entry.load()
        except (ImportError, AttributeError) as error:
            raise CalibrationError(f"cannot be loaded: {error}", where=where) from error
        if not (isinstance(loaded, type) and issubclass(loaded, SensorCalibration)):
            raise CalibrationError("is not a sensor", where=where, expected="a subclass of SensorCalibration")
        found[entry.name] = loaded
    return found
