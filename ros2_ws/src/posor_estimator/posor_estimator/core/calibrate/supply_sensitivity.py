"""How much the gaps change with the supply voltage, from a supply that is varied while the target stands still.

Source: thesis 7.5.4, table 7.11. Each level at which the supply stays is a stop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.channels import check_channels
from posor_estimator.core.calibrate.checks import check_enough, misfit_sentences, outlier_sentences
from posor_estimator.core.calibrate.fit import Loss, fit
from posor_estimator.core.calibrate.joining import NS, stops
from posor_estimator.core.calibrate.one_probe import OneProbe
from posor_estimator.core.calibrate.parameters import first_index, indices, the_sensor
from posor_estimator.core.calibrate.procedure import Figure, Options, Outcome, Procedure, Table
from posor_estimator.core.calibrate.recording import PROBES_ESTIMATED, SATURATED
from posor_estimator.core.calibrate.replacement import Part
from posor_estimator.core.calibrate.stated import Taken
from posor_estimator.core.calibrate.track import Track, dwells
from posor_estimator.core.sensors.gap_probes import GapProbesCalibration
from posor_estimator.errors import FitError

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.fit import Fit
    from posor_estimator.core.calibrate.joining import Stops
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

NAME = "supply_sensitivity"
MICRO = 1e6
LEAST_LEVELS = 4


class SupplySensitivityOptions(Options):
    """Options of the supply-voltage sensitivity."""

    still: float = Field(default=0.01, gt=0.0, description="the supply stays while it is this close [V]")
    least: float = Field(default=0.2, gt=0.0, description="shortest stay that counts [s]")
    settle: float = Field(default=0.05, ge=0.0, description="beginning of each stay that is left out [s]")
    span: float = Field(default=0.2, gt=0.0, description="least span of the supply over which a slope is told [V]")
    variation: float = Field(
        default=0.1, gt=0.0, description="standard uncertainty of the supply in use, for the table of its effect [V]"
    )
    reference: float | None = Field(
        default=None,
        description="supply at which the gaps are as linearised [V]; none: as calibrated, or the mean here",
    )
    reference_sigma: float = Field(default=0.0, ge=0.0, description="standard uncertainty of that [V]")
    loss: Loss = Field(default="linear", description="soft_l1, huber or cauchy where outliers are to be survived")


def run(recording: Recording, calibration: Calibration, options: SupplySensitivityOptions) -> Outcome:
    """Fit the slope of each probe's gap over the supply voltage.

    Raises:
        FitError: The supply was not measured or not varied.

    """
    levels = supply_levels(recording, options)
    supplies = levels.scans.supply_voltages
    probes = OneProbe.all_of(calibration)
    at, _ = the_sensor(calibration, GapProbesCalibration, NAME)
    own = indices(calibration, at, [f"supply[{probe.index},{i}]" for probe in probes for i in range(2)])
    taken = Taken(calibration, own)
    fits = {
        probe.name: fitted(probe, levels, options, taken.effects(_derivatives(calibration, at, probe, levels)))
        for probe in probes
    }
    warnings = levels.warnings
    for name, found in fits.items():
        names = [f"level {n + 1}" for n in range(len(levels))]
        warnings += outlier_sentences(found.outliers(), names, name) if options.loss != "linear" else ()
        warnings += misfit_sentences(found, name)
    return Outcome(
        method=f"straight line through {len(levels)} levels of the supply, {supplies.min():.4g} to "
        f"{supplies.max():.4g} V, target at rest (thesis table 7.11)",
        fits=fits,
        parts=tuple(
            Part(f"{probe.key}.supply", _part(probe, fits[probe.name], float(supplies.mean()), options))
            for probe in probes
        ),
        covariances=tuple(taken.joint((f"{probe.key}.supply.sensitivity",), fits[probe.name]) for probe in probes),
        tables=(_table(probes, fits, options),),
        warnings=warnings,
        figures=tuple(
            Figure(
                f"{probe.name}: gap over supply voltage",
                "supply [V]",
                "gap less its mean [µm]",
                {"levels": (supplies, MICRO * _less_mean(probe.gaps_without_supply(levels.scans)))},
            )
            for probe in probes
        ),
    )


def supply_levels(recording: Recording, options: SupplySensitivityOptions) -> Stops:
    """Return the mean scans at each level of the supply.

    Raises:
        FitError: The supply was not measured, or not varied enough.

    """
    scans = recording.without(PROBES_ESTIMATED | SATURATED).scans
    known = np.asarray(np.isfinite(scans.supply_voltages))
    if not known.any():
        raise FitError("the supply voltage was not measured", where=recording.source, expected="scans that hold it")
    scans = scans.chosen(known)
    check_channels(scans, ("gap_voltages",), recording.source)
    track = Track(scans.stamps_ns, scans.supply_voltages[:, None], np.zeros(1), f"{recording.source}, supply voltage")
    stays = dwells(track, options.still, round(options.least * NS), settle_ns=round(options.settle * NS))
    check_enough(len(stays), LEAST_LEVELS, "levels of the supply voltage", recording.source)
    found = stops(scans, track, stays, what=recording.source, judged=("gap_voltages",))
    spanned = float(np.ptp(found.scans.supply_voltages))
    if spanned < options.span:
        raise FitError(
            f"the supply voltage spans {spanned:.3g} V", where=recording.source, expected=f"at least {options.span:g} V"
        )
    return found


def _derivatives(calibration: Calibration, at: int, probe: OneProbe, levels: Stops) -> FloatArray:
    """Return d(gap of one probe)/d(parameter of the stack) at the levels, (d, p), wherever the target rests."""
    sensor, first = calibration.sensors[at].build(), first_index(calibration, at)
    out = np.zeros((len(levels), first_index(calibration, len(calibration.sensors))))
    for n in range(len(levels)):
        block = sensor.residual_jacobian(levels.scans[n], np.eye(3), np.zeros(3))
        out[n, first : first + block.shape[1]] = block[probe.index]
    return out


def fitted(probe: OneProbe, levels: Stops, options: SupplySensitivityOptions, by_taken: FloatArray) -> Fit:
    """Return the fit of ``sensitivity`` [m/V] and ``gap`` at the mean supply [m] of one probe.

    The sensitivity is what is added to the linearised gap for a volt: the gap without it falls by as much.
    ``by_taken``: what a standard deviation of what is taken for known does to the gaps [m], (d, q).
    """
    gaps = probe.gaps_without_supply(levels.scans)
    slopes = probe.slopes(levels.scans)
    from_mean = _less_mean(levels.scans.supply_voltages)
    design = np.column_stack([-from_mean, np.ones(len(gaps))])
    sigmas = slopes * levels.sigmas("gap_voltages")[:, probe.index]
    if not np.all(sigmas > 0.0):
        sigmas = slopes * probe.calibration.noise.number / np.sqrt(levels.counts)
    scales = np.array(
        [max(float(np.ptp(gaps)), float(np.max(sigmas))) / float(np.ptp(from_mean)), float(np.mean(gaps))]
    )

    def attempt(*, trust_sigmas: bool) -> Fit:
        return fit(
            lambda values: (design @ values - gaps) / sigmas,
            np.array([0.0, float(np.median(gaps))]),
            ("sensitivity", "gap"),
            ("m/V", "m"),
            scales,
            jacobian=lambda values: design / sigmas[:, None],  # noqa: ARG005  the same at all values
            taken=by_taken / sigmas[:, None],
            loss=options.loss,
            trust_sigmas=trust_sigmas,
            what=f"{NAME} of {probe.name}",
        )

    found = attempt(trust_sigmas=True)
    return attempt(trust_sigmas=False) if misfit_sentences(found, probe.name) else found


def _less_mean(values: FloatArray) -> FloatArray:
    return np.asarray(values - values.mean())


def _part(probe: OneProbe, found: Fit, mean_supply: float, options: SupplySensitivityOptions) -> dict[str, Any]:
    present = probe.calibration.supply
    reference, sigma = (mean_supply, 0.0) if present is None else (present.reference.number, present.reference.sigma)
    if options.reference is not None:
        reference, sigma = options.reference, options.reference_sigma
    return {
        "sensitivity": {"value": found.value("sensitivity"), "sigma": found.sigma("sensitivity"), "unit": "m/V"},
        "reference": {"value": reference, "sigma": sigma, "unit": "V"},
    }


def _table(probes: list[OneProbe], fits: dict[str, Fit], options: SupplySensitivityOptions) -> Table:
    rows = tuple(
        (
            probe.calibration.name,
            MICRO * fits[probe.name].value("sensitivity"),
            MICRO * fits[probe.name].sigma("sensitivity"),
            MICRO * abs(fits[probe.name].value("sensitivity")) * options.variation,
        )
        for probe in probes
    )
    return Table(
        "sensitivity to the supply voltage",
        ("probe", "sensitivity", "sigma", f"effect of {options.variation:g} V"),
        ("", "µm/V", "µm/V", "µm"),
        rows,
    )


PROCEDURE = Procedure(
    name=NAME,
    summary="change of the gaps with the supply voltage, from a supply that is varied while the target stands still",
    options=SupplySensitivityOptions,
    run=run,
)
