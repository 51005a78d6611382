# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Estimated parameters of a calibration file beside their true values, and the campaign step that measured each."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import chebyshev
from posor.calibration.parameter_entries import parameter_entries

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor.calibration.calibration_file import Calibration
    from posor.calibration.parameter_entries import ParameterEntry
    from posor.numerics.array_types import FloatArray

    from posor_lab.campaign.ground_truth import GroundTruth

QUANTILE_95 = 1.959963984540054
NOT_MEASURED = 0.95
"""A parameter is not measured if its final standard uncertainty is at least this share of the one as built."""
_GROUPS = (("sensors[0].probes", "gap probe"), ("sensors[1].probes", "ring probe"))


@dataclass(frozen=True)
class EstimatedParameter:
    """One number of a calibration file."""

    name: str  # key in the calibration file, with the index
    family: str  # family of similar parameters, see ``parameter_family``
    unit: str  # unit
    truth: float  # true value
    before: tuple[float, float]  # value and standard uncertainty as built; NaN: the parameter did not exist
    estimate: float  # estimated value
    sigma: float  # stated standard uncertainty
    procedure: str  # procedure that estimated it

    @property
    def normalised_error(self) -> float:
        """Error in units of the stated standard uncertainty."""
        return (self.estimate - self.truth) / self.sigma

    @property
    def inside(self) -> bool:
        """Whether the truth is within the stated 95 % interval."""
        return abs(self.normalised_error) < QUANTILE_95


def compare_with_truth(
    truth: GroundTruth, calibration: Calibration, *, last_procedure: bool = False
) -> list[EstimatedParameter]:
    """Return all parameters of a calibration that a procedure estimated; ``last_procedure``: the last one only."""
    true_values = truth.true_values()
    as_built = {entry.name: _value_and_sigma(entry) for entry in parameter_entries(truth.as_built) if entry is not None}
    true_maps = _true_map_coefficients(truth, calibration)
    procedure_of: dict[str, str] = {}
    for record in calibration.fits:
        procedure_of |= dict.fromkeys(record.replaced, record.procedure)
    keys = calibration.fits[-1].replaced if last_procedure else list(procedure_of)
    parameters = []
    for entry in parameter_entries(calibration):
        if entry is None:
            continue
        key = next((key for key in reversed(keys) if entry.key == key or entry.key.startswith(f"{key}.")), None)
        estimate, sigma = _value_and_sigma(entry)
        if key is None or not sigma > 0.0 or _is_dependent(entry):
            continue
        is_map = ".maps." in entry.name
        parameters.append(
            EstimatedParameter(
                entry.name,
                parameter_family(entry.name),
                entry.quantity.unit.replace("^k", f"^{entry.index[-1]}" if entry.index else ""),
                (true_maps if is_map else true_values)[entry.name],
                (np.nan, np.nan) if is_map else as_built.get(entry.name, (np.nan, np.nan)),
                estimate,
                sigma,
                procedure_of[key],
            )
        )
    return parameters


def _value_and_sigma(entry: ParameterEntry) -> tuple[float, float]:
    return float(entry.quantity.array[entry.index]), float(entry.quantity.sigmas[entry.index])


def _is_dependent(entry: ParameterEntry) -> bool:
    """Return whether this is the long component of a direction, which follows from the other two."""
    array = entry.quantity.array
    return entry.quantity.unit == "1" and array.shape == (3,) and abs(float(array[entry.index])) > 0.5  # noqa: PLR2004


def parameter_family(name: str) -> str:
    """Return the family of a parameter: ``gap probe A_2``, ``diodes origin``."""
    group = next((words for start, words in _GROUPS if name.startswith(start)), None)
    parts = [part for part in re.sub(r"\[\d+\]", "", name).split(".")[1:] if part != "probes"]
    if parts[-1] == "volts_to_gap":
        return f"{group} A_{name[-2]}"
    if "maps" in parts:
        return "diode map"
    words = " ".join(parts).replace("_", " ")
    return words if group is None else f"{group} {words}"


def _true_map_coefficients(truth: GroundTruth, calibration: Calibration) -> dict[str, float]:
    """Return the true coefficients of the diodes' maps, in the terms of the maps that were found."""
    sensor: Any = calibration.sensors[1]
    if not hasattr(sensor, "maps"):
        return {}
    as_built: Any = truth.as_built.sensors[1]
    true: Any = truth.first_day.sensors[1]
    names, values = list(true.parameter_names), true.parameter_values
    coefficients = {}
    for d, spot_map in enumerate(sensor.maps[sensor.map]):
        old = as_built.maps[as_built.map][d]
        size = len(old.x.array)
        start = names.index(f"maps[{d},0]")
        for axis, first in (("x", start), ("y", start + size**2)):
            surface = values[first : first + size**2].reshape(size, size)
            domains = old.domain.array, spot_map.domain.array
            converted = _change_domain(surface, *domains, len(getattr(spot_map, axis).array))
            for (i, j), value in np.ndenumerate(converted):
                coefficients[f"sensors[1].maps.{sensor.map}[{d}].{axis}[{i}][{j}]"] = float(value)
    return coefficients


def _change_domain(coefficients: FloatArray, old: FloatArray, new: FloatArray, size: int) -> FloatArray:
    """Return a Chebyshev surface over one domain (2, 2) as coefficients over another domain, (size, size)."""
    nodes = chebyshev.chebpts1(max(size, len(coefficients)))
    ratios = [new[axis].mean() + 0.5 * np.ptp(new[axis]) * nodes for axis in range(2)]
    scaled = [(ratios[axis] - old[axis].mean()) / (0.5 * np.ptp(old[axis])) for axis in range(2)]
    surface = chebyshev.chebgrid2d(scaled[0], scaled[1], coefficients)
    functions = np.linalg.pinv(chebyshev.chebvander(nodes, len(nodes) - 1))
    return np.asarray(functions @ surface @ functions.T)[:size, :size]


def measuring_steps(as_built: Calibration, after_steps: Sequence[Calibration]) -> dict[str, int]:
    """Return the index of the step that measured each parameter, by name; parameters not measured are left out.

    A fit states all its parameters again, so the last statement need not be a measurement: the measuring step is the
    one that lowered the standard uncertainty by the largest ratio, or gave one.
    """
    history = [
        {entry.name: _value_and_sigma(entry)[1] for entry in parameter_entries(calibration) if entry is not None}
        for calibration in (as_built, *after_steps)
    ]
    steps = {}
    for name, final in history[-1].items():
        sigmas = np.array([known.get(name, 0.0) for known in history])
        if not final > 0.0 or (sigmas[0] > 0.0 and final >= NOT_MEASURED * sigmas[0]):
            continue
        before = np.where(sigmas[:-1] > 0.0, sigmas[:-1], np.inf)  # 0: nothing was stated yet
        ratios = np.divide(before, sigmas[1:], out=np.zeros_like(before), where=sigmas[1:] > 0.0)
        steps[name] = int(np.argmax(ratios))
    return steps
