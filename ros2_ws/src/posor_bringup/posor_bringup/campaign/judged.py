"""What a campaign found, beside the truth: number by number of the calibration file."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import chebyshev
from posor_estimator.core.calibration.entries import entries_of

if TYPE_CHECKING:
    from posor_estimator.core.calibration.entries import Entry
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

    from posor_bringup.campaign.plant import Plant

WITHIN_95 = 1.959963984540054
_GROUPS = (("sensors[0].probes", "gap probe"), ("sensors[1].probes", "ring probe"))


@dataclass(frozen=True)
class Judged:
    """One number.

    Attributes:
        name: Its key in the calibration file, with the index.
        family: What it is one of.
        unit: Its unit.
        truth: What it truly is.
        before: What was known of it as built, and its standard uncertainty; NaN where it did not exist.
        estimate: What was found.
        sigma: Its stated standard uncertainty.
        procedure: That found it.

    """

    name: str
    family: str
    unit: str
    truth: float
    before: tuple[float, float]
    estimate: float
    sigma: float
    procedure: str

    @property
    def pull(self) -> float:
        """How far it is off, in its standard uncertainty."""
        return (self.estimate - self.truth) / self.sigma

    @property
    def inside(self) -> bool:
        """Whether the truth is within the stated 95 % interval."""
        return abs(self.pull) < WITHIN_95


def judged(plant: Plant, calibration: Calibration, *, last: bool = False) -> list[Judged]:
    """Return all numbers of a calibration that a procedure found.

    Args:
        plant: The truth.
        calibration: After some steps.
        last: Only those that the last procedure found.

    """
    truth = plant.truth()
    built = {
        entry.name: (float(entry.quantity.array[entry.index]), float(entry.quantity.sigmas[entry.index]))
        for entry in entries_of(plant.known)
        if entry is not None
    }
    maps = _map_truth(plant, calibration)
    origin: dict[str, str] = {}
    for record in calibration.fits:
        origin |= dict.fromkeys(record.replaced, record.procedure)
    wanted = calibration.fits[-1].replaced if last else list(origin)
    found = []
    for entry in entries_of(calibration):
        if entry is None:
            continue
        key = next((key for key in reversed(wanted) if entry.key == key or entry.key.startswith(f"{key}.")), None)
        sigma = float(entry.quantity.sigmas[entry.index])
        if key is None or not sigma > 0.0 or _is_along(entry):
            continue
        known = maps if ".maps." in entry.name else truth
        before = built.get(entry.name, (np.nan, np.nan)) if known is truth else (np.nan, np.nan)
        found.append(
            Judged(
                entry.name,
                family_of(entry.name),
                entry.quantity.unit.replace("^k", f"^{entry.index[-1]}" if entry.index else ""),
                known[entry.name],
                before,
                float(entry.quantity.array[entry.index]),
                sigma,
                origin[key],
            )
        )
    return found


def _is_along(entry: Entry) -> bool:
    """Return whether this is the long component of a direction, which follows from the other two."""
    array = entry.quantity.array
    return entry.quantity.unit == "1" and array.shape == (3,) and abs(float(array[entry.index])) > 0.5  # noqa: PLR2004


def family_of(name: str) -> str:
    """Return what a number of the file is one of: ``gap probe A_2``, ``diodes origin``."""
    group = next((words for start, words in _GROUPS if name.startswith(start)), None)
    parts = [part for part in re.sub(r"\[\d+\]", "", name).split(".")[1:] if part != "probes"]
    if parts[-1] == "volts_to_gap":
        return f"{group} A_{name[-2]}"
    if "maps" in parts:
        return "diode map"
    words = " ".join(parts).replace("_", " ")
    return words if group is None else f"{group} {words}"


def _map_truth(plant: Plant, calibration: Calibration) -> dict[str, float]:
    """Return the true coefficients of the diodes' maps, in the terms of the maps that were found."""
    sensor: Any = calibration.sensors[1]
    if not hasattr(sensor, "maps"):
        return {}
    built: Any = plant.known.sensors[1]
    true: Any = plant.first_day.sensors[1]
    names, values = list(true.parameter_names), true.parameter_values
    truth = {}
    for d, spot_map in enumerate(sensor.maps[sensor.map]):
        old = built.maps[built.map][d]
        size = len(old.x.array)
        start = names.index(f"maps[{d},0]")
        for axis, first in (("x", start), ("y", start + size**2)):
            coefficients = values[first : first + size**2].reshape(size, size)
            new = _in_terms_of(
                coefficients, old.domain.array, spot_map.domain.array, len(getattr(spot_map, axis).array)
            )
            for (i, j), value in np.ndenumerate(new):
                truth[f"sensors[1].maps.{sensor.map}[{d}].{axis}[{i}][{j}]"] = float(value)
    return truth


def _in_terms_of(coefficients: FloatArray, old: FloatArray, new: FloatArray, size: int) -> FloatArray:
    """Return a Chebyshev surface over one domain (2, 2) in the functions of another, (size, size)."""
    nodes = chebyshev.chebpts1(max(size, len(coefficients)))
    ratios = [new[axis].mean() + 0.5 * np.ptp(new[axis]) * nodes for axis in range(2)]
    scaled = [(ratios[axis] - old[axis].mean()) / (0.5 * np.ptp(old[axis])) for axis in range(2)]
    surface = chebyshev.chebgrid2d(scaled[0], scaled[1], coefficients)
    functions = np.linalg.pinv(chebyshev.chebvander(nodes, len(nodes) - 1))
    return np.asarray(functions @ surface @ functions.T)[:size, :size]
