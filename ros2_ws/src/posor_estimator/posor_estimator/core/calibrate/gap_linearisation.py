"""Linearise gap probes: polynomials from voltage to gap against a reference (thesis 7.5.1, tables 7.3 to 7.6, 7.10)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from posor_estimator.core.calibrate.checks import misfit_sentences, outlier_sentences
from posor_estimator.core.calibrate.gap_polynomial import Criterion, GapPolynomial, best, fitted_orders, outliers_of
from posor_estimator.core.calibrate.gap_reference import GapReferenceOptions, gap_data, gap_stops
from posor_estimator.core.calibrate.one_probe import OneProbe
from posor_estimator.core.calibrate.procedure import Figure, Outcome, Procedure, Table
from posor_estimator.core.calibrate.replacement import JointCovariance, Replacement
from posor_estimator.core.calibration.quantity import Quantity

if TYPE_CHECKING:
    from posor_estimator.core.calibrate.gap_polynomial import GapData
    from posor_estimator.core.calibrate.joining import Stops
    from posor_estimator.core.calibrate.recording import Recording
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

MICRO = 1e6
NAME = "gap_linearisation"


class GapLinearisationOptions(GapReferenceOptions):
    """Options of the linearisation of gap probes."""

    highest_order: int = Field(default=9, ge=1, le=12, description="highest order of polynomial that is tried")
    order: int = Field(default=0, ge=0, le=12, description="order to take; 0: the one that the criterion prefers")
    criterion: Criterion = Field(
        default="cross_validation", description="by what the order is chosen: leave-one-out cross-validation or AICc"
    )
    zero: Literal["kept", "reference"] = Field(
        default="kept",
        description="where the gaps count from: the gap at 0 V, or at the end of the range next to it, stays as it is "
        "calibrated (kept), or the reference measures from the probe's face (reference)",
    )
    scale_sigma: float = Field(
        default=0.0, ge=0.0, description="relative standard uncertainty of the reference's scale, common to all stops"
    )
    update_noise: bool = Field(default=True, description="replace each probe's noise by the scatter within the stops")


@dataclass(frozen=True)
class LinearisedProbe:
    """What was found of one probe: its polynomials of all orders, the chosen one, and that with the file's zero."""

    probe: OneProbe
    data: GapData
    polynomials: list[GapPolynomial]
    chosen: GapPolynomial
    coefficients: FloatArray
    covariance: FloatArray
    warnings: tuple[str, ...]


def run(recording: Recording, calibration: Calibration, options: GapLinearisationOptions) -> Outcome:
    """Linearise all gap probes of a POSOR.

    Raises:
        FitError: Too few stops, a stuck channel, or data that fit no curve.
        TrackError: The reference does not serve.

    """
    stops = gap_stops(recording, options, NAME)
    probes = [
        linearised(probe, gap_data(probe, stops, calibration, options, recording.source), options)
        for probe in OneProbe.all_of(calibration)
    ]
    return Outcome(
        method=f"polynomials through {len(stops)} stops, {_order(options)} (thesis 7.5.1)",
        fits={one.probe.name: one.chosen.fit for one in probes},
        replacements=tuple(new for one in probes for new in _replacements(one, stops, options)),
        covariances=tuple(
            JointCovariance(
                tuple(f"{one.probe.key}.volts_to_gap[{k}]" for k in range(len(one.coefficients))), one.covariance
            )
            for one in probes
        ),
        tables=(
            _order_table("standard deviation of the residuals against order", probes, "residual_deviation"),
            _order_table("leave-one-out cross-validation against order", probes, "cross_validation"),
            *(_coefficient_table(one) for one in probes),
            _uncertainty_table(probes),
        ),
        warnings=(*stops.warnings, *(sentence for one in probes for sentence in one.warnings)),
        figures=tuple(_figure(one) for one in probes),
    )


def _order(options: GapLinearisationOptions) -> str:
    return f"order {options.order} as asked" if options.order else f"order by {options.criterion}"


def linearised(probe: OneProbe, data: GapData, options: GapLinearisationOptions) -> LinearisedProbe:
    """Return the polynomials of one probe; stops that do not fit the others are left out, and named.

    Raises:
        FitError: Too few stops, or too many that do not fit.

    """
    outliers = outliers_of(probe, data)
    names = [f"stop {n + 1}" for n in range(len(outliers))]
    warnings = outlier_sentences(outliers, names, probe.name)
    data = data.without(outliers)
    polynomials = fitted_orders(probe, data, max(options.highest_order, options.order))
    if options.order:
        polynomials_of_order = [polynomial for polynomial in polynomials if polynomial.order == options.order]
        chosen = best(polynomials_of_order, options.criterion, f"{probe.name}, order {options.order}")
    else:
        chosen = best(polynomials, options.criterion, probe.name)
    coefficients, covariance = _with_zero(probe, chosen, options)
    low, high = probe.calibration.range.array
    if chosen.span[0] > low or chosen.span[1] < high:
        said = f"the stops span {chosen.span[0]:.4g} to {chosen.span[1]:.4g} V, which becomes its range"
        warnings += (f"{probe.name}: {said}; it was {low:.4g} to {high:.4g} V.",)
    return LinearisedProbe(
        probe, data, polynomials, chosen, coefficients, covariance, warnings + misfit_sentences(chosen.fit, probe.name)
    )


def uncertainty_over_range(one: LinearisedProbe) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return voltages over the range, and the curve's standard uncertainty there: joint, and as if independent.

    Returns:
        Voltages [V]; standard uncertainty of the gap [m] by the full covariance, which is what the estimator counts;
        that by the coefficients' own standard uncertainties alone; (9,) each.

    """
    volts = np.linspace(*one.chosen.span, 9)
    powers = volts[:, None] ** np.arange(len(one.coefficients))
    jointly = np.sqrt(np.einsum("ni,ij,nj->n", powers, one.covariance, powers))
    sigmas = np.sqrt(np.diag(one.covariance)).tolist()
    alone = one.probe.polynomial_at(volts, Quantity(value=one.coefficients.tolist(), sigma=sigmas, unit="m/V^k"))[1]
    return volts, jointly, alone


def _with_zero(
    probe: OneProbe, chosen: GapPolynomial, options: GapLinearisationOptions
) -> tuple[FloatArray, FloatArray]:
    """Return coefficients and covariance with the zero that the options ask for, and the reference's scale counted."""
    coefficients, covariance = chosen.coefficients, chosen.covariance
    scaled = coefficients
    zero_sigma = 0.0
    if options.zero == "kept":
        volt = float(np.clip(0.0, *chosen.span))
        zero, zero_sigma = (float(one[0]) for one in probe.polynomial_at(np.array([volt])))
        refer = np.eye(len(coefficients))
        refer[0] -= volt ** np.arange(len(coefficients))
        scaled, covariance = refer @ coefficients, refer @ covariance @ refer.T
        coefficients = scaled.copy()
        coefficients[0] += zero
    covariance = covariance + options.scale_sigma**2 * np.outer(scaled, scaled)
    covariance[0, 0] += zero_sigma**2
    return coefficients, covariance


def _replacements(one: LinearisedProbe, stops: Stops, options: GapLinearisationOptions) -> list[Replacement]:
    found = [
        Replacement(
            f"{one.probe.key}.volts_to_gap", one.coefficients.tolist(), np.sqrt(np.diag(one.covariance)).tolist()
        ),
        Replacement(f"{one.probe.key}.range", list(one.chosen.span), 0.0),
    ]
    noise = float(stops.spreads["gap_voltages"][one.probe.index])
    if options.update_noise and noise > 0.0:
        freedoms = int(np.sum(stops.counts - 1))
        found.append(Replacement(f"{one.probe.key}.noise", noise, noise / float(np.sqrt(2.0 * freedoms))))
    return found


def _order_table(title: str, probes: list[LinearisedProbe], what: str) -> Table:
    most = max(len(one.polynomials) for one in probes)
    rows = tuple(
        (
            one.probe.calibration.name,
            *(MICRO * getattr(polynomial, what) for polynomial in one.polynomials),
            *(float("nan") for _ in range(most - len(one.polynomials))),
            one.chosen.order,
        )
        for one in probes
    )
    orders = tuple(f"order {k + 1}" for k in range(most))
    return Table(title, ("probe", *orders, "chosen order"), ("", *("µm",) * most, ""), rows)


def _coefficient_table(one: LinearisedProbe) -> Table:
    sigmas = np.sqrt(np.diag(one.covariance))
    rows = tuple(
        (f"A_{k}", float(value), float(sigma), f"m/V^{k}")
        for k, (value, sigma) in enumerate(zip(one.coefficients, sigmas, strict=True))
    )
    return Table(f"{one.probe.name}, volts to gap", ("coefficient", "value", "sigma", "unit"), ("",) * 4, rows)


def _uncertainty_table(probes: list[LinearisedProbe]) -> Table:
    rows = []
    for one in probes:
        volts, jointly, alone = uncertainty_over_range(one)
        for at in (0, len(volts) // 2, len(volts) - 1):
            uncertainties = MICRO * float(jointly[at]), MICRO * float(alone[at])
            rows.append((one.probe.calibration.name, float(volts[at]), *uncertainties))
    return Table(
        "standard uncertainty of the curves",
        ("probe", "voltage", "uncertainty", "as if coefficients were independent"),
        ("", "V", "µm", "µm"),
        tuple(rows),
    )


def _figure(one: LinearisedProbe) -> Figure:
    return Figure(
        f"{one.probe.name}: residuals of order {one.chosen.order}",
        "voltage, zero shift added [V]",
        "polynomial less reference [µm]",
        {"stops": (one.probe.volts(one.data.scans), MICRO * one.chosen.residuals)},
    )


PROCEDURE = Procedure(
    name=NAME,
    summary="polynomials from voltage to gap of all gap probes, against a reference that goes from stop to stop",
    options=GapLinearisationOptions,
    run=run,
)
