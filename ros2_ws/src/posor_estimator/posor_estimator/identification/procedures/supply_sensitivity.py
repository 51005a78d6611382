"""Sensitivity of the gaps to the supply voltage, from a supply that is varied while the target rests.

Source: thesis 7.5.4, table 7.11. Each level of the supply is a dwell.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field

from posor_estimator.errors import FitError
from posor_estimator.identification.calibration_parameters import (
    FixedParameters,
    find_sensor,
    first_parameter,
    parameter_indices,
)
from posor_estimator.identification.data_checks import check_channels_vary, check_count
from posor_estimator.identification.dwells import NS, Settle, average_dwells, find_dwells
from posor_estimator.identification.fit_report import describe_enlargement, describe_rejected, enlarge_if_improbable
from posor_estimator.identification.gap_probe_data import MICRO, SingleProbe, list_probes
from posor_estimator.identification.least_squares import Fit, fit_linear
from posor_estimator.identification.procedure import Figure, LossOption, Options, Outcome, Part, Procedure, Table
from posor_estimator.identification.recording import Track
from posor_estimator.model.scan import PROBES_ESTIMATED, SATURATED
from posor_estimator.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from posor_estimator.calibration.calibration_file import Calibration
    from posor_estimator.identification.dwells import DwellMeans
    from posor_estimator.identification.recording import Recording
    from posor_estimator.numerics.array_types import FloatArray

NAME = "supply_sensitivity"
MIN_LEVELS = 4


class SupplySensitivityOptions(Options):
    """Options of ``supply_sensitivity``."""

    still: float = Field(default=0.01, gt=0.0, description="the supply is constant within this [V]")
    least_dwell: float = Field(default=0.2, gt=0.0, description="shortest dwell at a level [s]")
    settle: Settle = 0.05
    span: float = Field(default=0.2, gt=0.0, description="least span of the supply [V]")
    variation: float = Field(
        default=0.1, gt=0.0, description="standard uncertainty of the supply in use, for the table of its effect [V]"
    )
    reference: float | None = Field(
        default=None,
        description="supply at which the gaps are as linearised [V]; none: as calibrated, or the mean of the levels",
    )
    reference_sigma: float = Field(default=0.0, ge=0.0, description="standard uncertainty of that supply [V]")
    loss: LossOption = "linear"


def find_supply_sensitivity(
    recording: Recording, calibration: Calibration, options: SupplySensitivityOptions
) -> Outcome:
    """Fit the slope of each probe's gap over the supply voltage; raises as ``Procedure.identify``."""
    levels = _average_levels(recording, options)
    supplies = levels.scans.supply_voltages
    probes = list_probes(calibration)
    at, _ = find_sensor(calibration, GapProbesCalibration, NAME)
    fitted = parameter_indices(calibration, at, [f"supply[{probe.index},{i}]" for probe in probes for i in range(2)])
    fixed = FixedParameters(calibration, fitted)
    fits, warnings = {}, levels.warnings
    for probe in probes:
        name, effects = probe.name, fixed.effects(_gap_derivatives(calibration, at, probe, levels))
        fits[name] = _fit_probe(probe, levels, options, effects)
        if options.loss != "linear":
            warnings += describe_rejected(fits[name].outliers(), [f"level {n + 1}" for n in range(len(levels))], name)
        warnings += describe_enlargement(fits[name], name)
    return Outcome(
        method=f"straight line through {len(levels)} levels of the supply, {supplies.min():.4g} to "
        f"{supplies.max():.4g} V, target at rest (thesis table 7.11)",
        fits=fits,
        parts=tuple(
            Part(f"{probe.key}.supply", _file_entry(probe, fits[probe.name], float(supplies.mean()), options))
            for probe in probes
        ),
        covariances=tuple(
            fixed.joint_covariance((f"{probe.key}.supply.sensitivity",), fits[probe.name]) for probe in probes
        ),
        tables=(_tabulate(probes, fits, options),),
        warnings=warnings,
        figures=tuple(
            Figure(
                f"{probe.name}: gap over supply voltage",
                "supply [V]",
                "gap less its mean [µm]",
                {"levels": (supplies, MICRO * (gaps - gaps.mean()))},
            )
            for probe in probes
            for gaps in (probe.gaps(levels.scans, with_supply=False),)
        ),
    )


def _average_levels(recording: Recording, options: SupplySensitivityOptions) -> DwellMeans:
    """Return the mean scans at each level; raise FitError if the supply was not measured or not varied enough."""
    scans = recording.without_status(PROBES_ESTIMATED | SATURATED).scans
    known = np.asarray(np.isfinite(scans.supply_voltages))
    if not known.any():
        raise FitError("the supply voltage was not measured", where=recording.source, expected="scans that hold it")
    scans = scans.select(known)
    check_channels_vary(scans, ("gap_voltages",), recording.source)
    track = Track(scans.stamps_ns, scans.supply_voltages[:, None], np.zeros(1), f"{recording.source}, supply voltage")
    dwells = find_dwells(track, options.still, round(options.least_dwell * NS), settle_ns=round(options.settle * NS))
    check_count(len(dwells), MIN_LEVELS, "levels of the supply voltage", recording.source)
    levels = average_dwells(scans, track, dwells, source=recording.source, kinds=("gap_voltages",))
    span = float(np.ptp(levels.scans.supply_voltages))
    if span < options.span:
        what, expected = f"the supply voltage spans {span:.3g} V", f"at least {options.span:g} V"
        raise FitError(what, where=recording.source, expected=expected)
    return levels


def _gap_derivatives(calibration: Calibration, at: int, probe: SingleProbe, levels: DwellMeans) -> FloatArray:
    """Return d(gap of one probe)/d(parameter of the stack) at the levels, (d, p); the pose does not matter."""
    sensor, first = calibration.sensors[at].build(), first_parameter(calibration, at)
    out = np.zeros((len(levels), first_parameter(calibration, len(calibration.sensors))))
    for n in range(len(levels)):
        block = sensor.residual_jacobian(levels.scans[n], np.eye(3), np.zeros(3))
        out[n, first : first + block.shape[1]] = block[probe.index]
    return out


def _fit_probe(probe: SingleProbe, levels: DwellMeans, options: SupplySensitivityOptions, effects: FloatArray) -> Fit:
    """Return the fit of ``sensitivity`` [m/V] and ``gap`` at the mean supply [m] of one probe.

    The sensitivity is what is added to the linearised gap per volt, so the gap without it falls by as much. ``effects``
    of fixed parameters on the gaps [m], (d, q).
    """
    gaps = probe.gaps(levels.scans, with_supply=False)
    slopes = probe.slopes(levels.scans)
    supplies = levels.scans.supply_voltages
    sigmas = slopes * levels.sigmas("gap_voltages")[:, probe.index]
    if not np.all(sigmas > 0.0):
        sigmas = slopes * probe.calibration.noise.number / np.sqrt(levels.counts)
    steepest = max(float(np.ptp(gaps)), float(np.max(sigmas))) / float(np.ptp(supplies))
    found = fit_linear(
        np.column_stack([supplies.mean() - supplies, np.ones(len(gaps))]),
        gaps,
        sigmas,
        np.array([0.0, float(np.median(gaps))]),
        ("sensitivity", "gap"),
        ("m/V", "m"),
        np.array([steepest, float(np.mean(gaps))]),
        fixed_effects=effects,
        loss=options.loss,
        what=f"{NAME} of {probe.name}",
    )
    return enlarge_if_improbable(found) if options.loss == "linear" else found


def _file_entry(
    probe: SingleProbe, found: Fit, mean_supply: float, options: SupplySensitivityOptions
) -> dict[str, Any]:
    present = probe.calibration.supply
    reference, sigma = (mean_supply, 0.0) if present is None else (present.reference.number, present.reference.sigma)
    if options.reference is not None:
        reference, sigma = options.reference, options.reference_sigma
    return {
        "sensitivity": {"value": found.value("sensitivity"), "sigma": found.sigma("sensitivity"), "unit": "m/V"},
        "reference": {"value": reference, "sigma": sigma, "unit": "V"},
    }


def _tabulate(probes: list[SingleProbe], fits: dict[str, Fit], options: SupplySensitivityOptions) -> Table:
    rows = []
    for probe in probes:
        value, sigma = (MICRO * figure("sensitivity") for figure in (fits[probe.name].value, fits[probe.name].sigma))
        rows.append((probe.calibration.name, value, sigma, abs(value) * options.variation))
    return Table(
        "sensitivity to the supply voltage",
        ("probe", "sensitivity", "sigma", f"effect of {options.variation:g} V"),
        ("", "µm/V", "µm/V", "µm"),
        tuple(rows),
    )


PROCEDURE = Procedure(
    NAME,
    "change of the gaps with the supply voltage, from a supply that is varied while the target rests",
    SupplySensitivityOptions,
    find_supply_sensitivity,
)
