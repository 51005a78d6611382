# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Sensitivity of the gaps to supply voltage or temperature, from a recording in which it varies and the target rests.

Each level of the quantity is a dwell. A slow drift counts as many short dwells. Source of the procedure for the supply:
thesis 7.5.3, table 7.11. For the temperature of a room or chamber the target rests on a spacer, as in the cap test of
the thesis (7.5.3, which names the temperature as a cause of drift). The growth of the spacer counts as sensitivity of
the probe; a spacer of a material that hardly grows avoids this.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from posor.bags.recording import Track
from posor.calibration.calibration_file import find_sensor
from posor.errors import FitError
from posor.model.scan import PROBES_ESTIMATED, SATURATED
from posor.sensors.gap_probes import GapProbesCalibration
from pydantic import Field, create_model

from posor_calibration.calibration_parameters import FixedParameters, first_parameter, parameter_indices
from posor_calibration.data_checks import check_channels_vary, check_count
from posor_calibration.dwells import RestOptions, Settle, average_dwells
from posor_calibration.fit_report import describe_enlargement, describe_rejected, enlarge_if_improbable
from posor_calibration.gap_probe_data import MICRO, SingleProbe, list_probes
from posor_calibration.least_squares import Fit, fit_linear
from posor_calibration.procedure import Figure, LossOption, Outcome, Part, Procedure, Table

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray
    from posor.sensors.probe import SupplyCalibration, TemperatureCalibration

    from posor_calibration.dwells import DwellMeans

MIN_LEVELS = 4


@dataclass(frozen=True)
class Environment:
    """A quantity of the environment on which the gaps depend."""

    procedure: str
    summary: str  # of the procedure
    title: str  # for messages: ``supply voltage``
    short_title: str
    field: Literal["supply_voltages", "temperatures"]  # of the scans
    part: Literal["supply", "temperature"]  # of a probe in the file
    unit: str
    source: str  # section or table of the thesis
    still: float  # default of the option, as the next ones
    least_dwell: float
    span: float
    variation: float

    def values(self, scans: Any) -> FloatArray:
        """Return the quantity in each scan, (n,)."""
        values: FloatArray = getattr(scans, self.field)
        return values


class EnvironmentOptions(RestOptions):
    """Options that the procedures share; each states ``still`` and those without a default in its unit."""

    settle: Settle = 0.05
    span: float
    variation: float
    reference: float | None
    reference_sigma: float = Field(
        default=0.0, ge=0.0, description="standard uncertainty of ``reference``, in its unit"
    )
    loss: LossOption = "linear"


def make_procedure(environment: Environment) -> Procedure[EnvironmentOptions]:
    """Return the procedure for a quantity, with its unit in the options."""
    name, unit = environment.short_title, environment.unit

    def option(default: float, description: str) -> tuple[type, Any]:
        return float, Field(default=default, gt=0.0, description=description)

    variation = f"standard uncertainty of the {name} in use, for the table of its effect [{unit}]"
    reference = f"{name} at which the gaps are as linearised [{unit}]; none: as calibrated"
    options = create_model(
        EnvironmentOptions.__name__,
        __base__=EnvironmentOptions,
        still=option(environment.still, f"the {name} is constant within this [{unit}]"),
        least_dwell=option(environment.least_dwell, "shortest dwell at a level [s]"),
        span=option(environment.span, f"least span of the {name} [{unit}]"),
        variation=option(environment.variation, variation),
        reference=(float | None, Field(default=None, description=reference)),
    )
    identify = partial(find_sensitivity, environment=environment)
    return Procedure(environment.procedure, environment.summary, options, identify)


def find_sensitivity(
    recording: Recording, calibration: Calibration, options: EnvironmentOptions, environment: Environment
) -> Outcome:
    """Fit the slope of each probe's gap over the quantity; raises as ``Procedure.identify``."""
    levels = _average_levels(recording, options, environment)
    values = environment.values(levels.scans)
    probes = list_probes(calibration)
    at, _ = find_sensor(calibration, GapProbesCalibration, environment.procedure)
    names = [f"{environment.part}[{probe.index},{i}]" for probe in probes for i in range(2)]
    fixed = FixedParameters(calibration, parameter_indices(calibration, at, names))
    fits, warnings = {}, levels.warnings
    for probe in probes:
        name, effects = probe.name, fixed.effects(_gap_derivatives(calibration, at, probe, levels))
        fits[name] = _fit_probe(probe, levels, options, environment, effects)
        if options.loss != "linear":
            warnings += describe_rejected(fits[name].outliers(), [f"level {n + 1}" for n in range(len(levels))], name)
        warnings += describe_enlargement(fits[name], name)
    return Outcome(
        method=f"straight line through {len(levels)} levels of the {environment.short_title}, {values.min():.4g} to "
        f"{values.max():.4g} {environment.unit}, target at rest (thesis {environment.source})",
        fits=fits,
        parts=tuple(
            Part(f"{probe.key}.{environment.part}", _file_entry(probe, fits[probe.name], options, environment))
            for probe in probes
        ),
        covariances=tuple(
            fixed.joint_covariance((f"{probe.key}.{environment.part}.sensitivity",), fits[probe.name])
            for probe in probes
        ),
        tables=(_tabulate(probes, fits, options, environment),),
        warnings=warnings,
        figures=tuple(
            Figure(
                f"{probe.name}: gap over {environment.title}",
                f"{environment.short_title} [{environment.unit}]",
                "gap less its mean [µm]",
                {"levels": (values, MICRO * (gaps - gaps.mean()))},
            )
            for probe in probes
            for gaps in (probe.gaps(levels.scans, without=environment.part),)
        ),
    )


def _average_levels(recording: Recording, options: EnvironmentOptions, environment: Environment) -> DwellMeans:
    """Return the mean scans at each level; raise FitError if the quantity was not measured or not varied enough."""
    title, source = environment.title, recording.source
    scans = recording.without_status(PROBES_ESTIMATED | SATURATED).scans
    known = np.asarray(np.isfinite(environment.values(scans)))
    if not known.any():
        raise FitError(f"the {title} was not measured", where=source, expected="scans that hold it")
    scans = scans.select(known)
    check_channels_vary(scans, ("gap_voltages",), source)
    track = Track(scans.stamps_ns, environment.values(scans)[:, None], np.zeros(1), f"{source}, {title}")
    dwells = options.dwells(track)
    check_count(len(dwells), MIN_LEVELS, f"levels of the {title}", source)
    levels = average_dwells(scans, track, dwells, source=source, kinds=("gap_voltages",))
    span = float(np.ptp(environment.values(levels.scans)))
    if span < options.span:
        what, unit = f"the {title} spans {span:.3g} {environment.unit}", environment.unit
        raise FitError(what, where=source, expected=f"at least {options.span:g} {unit}")
    return levels


def _gap_derivatives(calibration: Calibration, at: int, probe: SingleProbe, levels: DwellMeans) -> FloatArray:
    """Return d(gap of one probe)/d(parameter of the stack) at the levels, (d, p); the pose does not matter."""
    sensor, first = calibration.sensors[at].build(), first_parameter(calibration, at)
    out = np.zeros((len(levels), first_parameter(calibration, len(calibration.sensors))))
    for n in range(len(levels)):
        block = sensor.residual_jacobian(levels.scans[n], np.eye(3), np.zeros(3))
        out[n, first : first + block.shape[1]] = block[probe.index]
    return out


def _fit_probe(
    probe: SingleProbe, levels: DwellMeans, options: EnvironmentOptions, environment: Environment, effects: FloatArray
) -> Fit:
    """Return the fit of ``sensitivity`` [m per unit] and ``gap`` at the mean of the quantity [m] of one probe.

    The calibration adds the sensitivity times the quantity to the linearised gap; the linearised gap falls by as much.
    ``effects`` of fixed parameters on the gaps [m], (d, q).
    """
    gaps = probe.gaps(levels.scans, without=environment.part)
    slopes = probe.slopes(levels.scans)
    values = environment.values(levels.scans)
    sigmas = slopes * levels.sigmas("gap_voltages")[:, probe.index]
    if not np.all(sigmas > 0.0):
        sigmas = slopes * probe.calibration.noise.number / np.sqrt(levels.counts)
    steepest = max(float(np.ptp(gaps)), float(np.max(sigmas))) / float(np.ptp(values))
    found = fit_linear(
        np.column_stack([values.mean() - values, np.ones(len(gaps))]),
        gaps,
        sigmas,
        np.array([0.0, float(np.median(gaps))]),
        ("sensitivity", "gap"),
        (f"m/{environment.unit}", "m"),
        np.array([steepest, float(np.mean(gaps))]),
        fixed_effects=effects,
        loss=options.loss,
        what=f"{environment.procedure} of {probe.name}",
    )
    return enlarge_if_improbable(found) if options.loss == "linear" else found


def _file_entry(
    probe: SingleProbe, found: Fit, options: EnvironmentOptions, environment: Environment
) -> dict[str, Any]:
    present: SupplyCalibration | TemperatureCalibration | None = getattr(probe.calibration, environment.part)
    unit = environment.unit
    if options.reference is not None:
        reference = {"value": options.reference, "sigma": options.reference_sigma, "unit": unit}
    elif present is not None:
        reference = present.reference.model_dump(mode="json")
    else:
        what = f"the {environment.title} at which the gaps were linearised is not known"
        raise FitError(what, where=probe.name, expected=f"the option reference, in {unit}")
    return {
        "sensitivity": {"value": found.value("sensitivity"), "sigma": found.sigma("sensitivity"), "unit": f"m/{unit}"},
        "reference": reference,
    }


def _tabulate(
    probes: list[SingleProbe], fits: dict[str, Fit], options: EnvironmentOptions, environment: Environment
) -> Table:
    rows = []
    for probe in probes:
        value, sigma = (MICRO * figure("sensitivity") for figure in (fits[probe.name].value, fits[probe.name].sigma))
        rows.append((probe.calibration.name, value, sigma, abs(value) * options.variation))
    unit = environment.unit
    return Table(
        f"sensitivity to the {environment.title}",
        ("probe", "sensitivity", "sigma", f"effect of {options.variation:g} {unit}"),
        ("", f"µm/{unit}", f"µm/{unit}", "µm"),
        tuple(rows),
    )


SUPPLY_SENSITIVITY = make_procedure(
    Environment(
        procedure="supply_sensitivity",
        summary="change of the gaps with the supply voltage, from a supply that is varied while the target rests",
        title="supply voltage",
        short_title="supply",
        field="supply_voltages",
        part="supply",
        unit="V",
        source="table 7.11",
        still=0.01,
        least_dwell=0.2,
        span=0.2,
        variation=0.1,
    )
)
TEMPERATURE_SENSITIVITY = make_procedure(
    Environment(
        procedure="temperature_sensitivity",
        summary="change of the gaps with the temperature of the plate, from a temperature that varies while the target "
        "rests",
        title="temperature of the plate",
        short_title="temperature",
        field="temperatures",
        part="temperature",
        unit="K",
        source="7.5.3",
        still=0.1,
        least_dwell=60.0,
        span=2.0,
        variation=1.0,
    )
)
