# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Linearise gap probes: polynomials from voltage to gap against a reference (thesis 7.5.1, tables 7.3 to 7.6, 7.10)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from posor.calibration.quantity import Quantity
from pydantic import Field

from posor_calibration.fit_report import describe_enlargement, describe_rejected
from posor_calibration.gap_polynomial import Criterion, GapPolynomial, find_outliers, fit_orders, select_polynomial
from posor_calibration.gap_probe_data import MICRO, GapReferenceOptions, SingleProbe, read_gap_data
from posor_calibration.procedure import Figure, JointCovariance, Outcome, Procedure, Replacement, Table
from posor_calibration.reference_checks import check_visits

if TYPE_CHECKING:
    from posor.bags.recording import Recording
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

    from posor_calibration.dwells import DwellMeans
    from posor_calibration.gap_probe_data import GapData

NAME = "gap_linearisation"
CURVE_POINTS = 9


class GapLinearisationOptions(GapReferenceOptions):
    """Options of ``gap_linearisation``."""

    highest_order: int = Field(default=9, ge=1, le=12, description="highest order of polynomial that is tried")
    order: int = Field(default=0, ge=0, le=12, description="order to use; 0: the one that the criterion prefers")
    criterion: Criterion = Field(
        default="cross_validation", description="selection of the order: leave-one-out cross-validation or AICc"
    )
    zero: Literal["kept", "reference"] = Field(
        default="kept",
        description="origin of the gaps: the gap at 0 V, or at the end of the range next to it, stays as calibrated "
        "(kept), or the reference measures from the probe's face (reference)",
    )
    scale_sigma: float = Field(
        default=0.0, ge=0.0, description="relative standard uncertainty of the reference's scale, common to all dwells"
    )
    update_noise: bool = Field(default=True, description="replace each probe's noise by the scatter within the dwells")


@dataclass(frozen=True)
class LinearisedProbe:
    """Result for one probe."""

    probe: SingleProbe
    data: GapData  # without outliers
    polynomials: list[GapPolynomial]  # of all orders
    selected: GapPolynomial
    coefficients: FloatArray  # of the selected polynomial, with the zero that the options ask for
    covariance: FloatArray  # of the coefficients
    warnings: tuple[str, ...]

    @property
    def sigmas(self) -> FloatArray:
        """Standard uncertainties of the coefficients."""
        return np.sqrt(np.diag(self.covariance))

    def replacements(self, means: DwellMeans, *, update_noise: bool) -> list[Replacement]:
        """Return the changes to the calibration file."""
        key = self.probe.key
        found = [
            Replacement(f"{key}.volts_to_gap", self.coefficients.tolist(), self.sigmas.tolist()),
            Replacement(f"{key}.range", list(self.selected.span), 0.0),
        ]
        noise = float(means.deviations["gap_voltages"][self.probe.index])
        if update_noise and noise > 0.0:
            freedoms = int(np.sum(means.counts - 1))
            found.append(Replacement(f"{key}.noise", noise, noise / float(np.sqrt(2.0 * freedoms))))
        return found


def linearise_gap_probes(recording: Recording, calibration: Calibration, options: GapLinearisationOptions) -> Outcome:
    """Linearise all gap probes of a POSOR; raises as ``Procedure.identify``."""
    means, probes = read_gap_data(recording, calibration, options, NAME)
    results = [linearise_probe(probe, data, options) for probe, data in probes]
    order = f"order {options.order} as asked" if options.order else f"order by {options.criterion}"
    return Outcome(
        method=f"polynomials through {len(means)} dwells, {order} (thesis 7.5.1)",
        fits={result.probe.name: result.selected.fit for result in results},
        replacements=tuple(
            r for result in results for r in result.replacements(means, update_noise=options.update_noise)
        ),
        covariances=tuple(
            JointCovariance(
                tuple(f"{result.probe.key}.volts_to_gap[{k}]" for k in range(len(result.coefficients))),
                result.covariance,
            )
            for result in results
        ),
        tables=(
            _tabulate_orders("standard deviation of the residuals against order", results, "residual_deviation"),
            _tabulate_orders("leave-one-out cross-validation against order", results, "cross_validation"),
            *(_tabulate_coefficients(result) for result in results),
            _tabulate_uncertainty(results),
        ),
        warnings=(*means.warnings, *(sentence for result in results for sentence in result.warnings)),
        figures=tuple(
            Figure(
                f"{result.probe.name}: residuals of order {result.selected.order}",
                "voltage, zero shift added [V]",
                "polynomial less reference [µm]",
                {"dwells": (result.probe.shifted_volts(result.data.scans), MICRO * result.selected.residuals)},
            )
            for result in results
        ),
    )


def linearise_probe(probe: SingleProbe, data: GapData, options: GapLinearisationOptions) -> LinearisedProbe:
    """Return the polynomials of one probe; outliers are left out and named.

    Raises FitError: there are too few dwells, or too many outliers.
    """
    if not options.uncalibrated:
        sigmas = np.hypot(data.reference_sigmas, probe.slopes(data.scans) * data.volt_sigmas)
        if np.all(sigmas > 0.0):
            check_visits(probe.gaps(data.scans), data.reference, sigmas, probe.name)
    outliers = find_outliers(probe, data)
    warnings = describe_rejected(outliers, [f"dwell {n + 1}" for n in range(len(outliers))], probe.name)
    data = data.select(~outliers)
    polynomials = fit_orders(probe, data, max(options.highest_order, options.order))
    candidates = [p for p in polynomials if options.order in (0, p.order)]
    where = f"{probe.name}, order {options.order}" if options.order else probe.name
    selected = select_polynomial(candidates, options.criterion, where)
    coefficients, covariance = _apply_zero(probe, selected, options)
    low, high = probe.calibration.range.array
    if selected.span[0] > low or selected.span[1] < high:
        said = f"the dwells span {selected.span[0]:.4g} to {selected.span[1]:.4g} V, which becomes its range"
        warnings += (f"{probe.name}: {said}; it was {low:.4g} to {high:.4g} V.",)
    warnings += describe_enlargement(selected.fit, probe.name)
    return LinearisedProbe(probe, data, polynomials, selected, coefficients, covariance, warnings)


def _apply_zero(
    probe: SingleProbe, selected: GapPolynomial, options: GapLinearisationOptions
) -> tuple[FloatArray, FloatArray]:
    """Return coefficients and covariance with the zero that the options ask for, and the scale's uncertainty."""
    coefficients, covariance = selected.coefficients, selected.covariance
    scaled, zero_sigma = coefficients, 0.0
    if options.zero == "kept":
        volt = float(np.clip(0.0, *selected.span))
        zero, zero_sigma = (float(result[0]) for result in probe.evaluate_polynomial(np.array([volt])))
        refer = np.eye(len(coefficients))
        refer[0] -= volt ** np.arange(len(coefficients))
        scaled, covariance = refer @ coefficients, refer @ covariance @ refer.T
        coefficients = scaled.copy()
        coefficients[0] += zero
    covariance = covariance + options.scale_sigma**2 * np.outer(scaled, scaled)
    covariance[0, 0] += zero_sigma**2
    return coefficients, covariance


def curve_uncertainty(result: LinearisedProbe) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return voltages over the range [V], and the curve's standard uncertainty there [m], (9,) each.

    The first uncertainty uses the full covariance, as the estimator does; the second the coefficients' own sigmas.
    """
    volts = np.linspace(*result.selected.span, CURVE_POINTS)
    powers = volts[:, None] ** np.arange(len(result.coefficients))
    joint = np.sqrt(np.einsum("ni,ij,nj->n", powers, result.covariance, powers))
    independent = Quantity(value=result.coefficients.tolist(), sigma=result.sigmas.tolist(), unit="m/V^k")
    return volts, joint, result.probe.evaluate_polynomial(volts, independent)[1]


def _tabulate_orders(title: str, results: list[LinearisedProbe], figure: str) -> Table:
    highest = max(len(result.polynomials) for result in results)
    rows = tuple(
        (
            result.probe.calibration.name,
            *(MICRO * getattr(polynomial, figure) for polynomial in result.polynomials),
            *(float("nan") for _ in range(highest - len(result.polynomials))),
            result.selected.order,
        )
        for result in results
    )
    orders = tuple(f"order {k + 1}" for k in range(highest))
    return Table(title, ("probe", *orders, "chosen order"), ("", *("µm",) * highest, ""), rows)


def _tabulate_coefficients(result: LinearisedProbe) -> Table:
    rows = tuple(
        (f"A_{k}", float(value), float(sigma), f"m/V^{k}")
        for k, (value, sigma) in enumerate(zip(result.coefficients, result.sigmas, strict=True))
    )
    return Table(f"{result.probe.name}, volts to gap", ("coefficient", "value", "sigma", "unit"), ("",) * 4, rows)


def _tabulate_uncertainty(results: list[LinearisedProbe]) -> Table:
    rows = []
    for result in results:
        volts, joint, independent = curve_uncertainty(result)
        for at in (0, len(volts) // 2, len(volts) - 1):
            sigmas = MICRO * float(joint[at]), MICRO * float(independent[at])
            rows.append((result.probe.calibration.name, float(volts[at]), *sigmas))
    return Table(
        "standard uncertainty of the curves",
        ("probe", "voltage", "uncertainty", "as if coefficients were independent"),
        ("", "V", "µm", "µm"),
        tuple(rows),
    )


PROCEDURE = Procedure(
    NAME,
    "polynomials from voltage to gap of all gap probes, against a reference that moves from dwell to dwell",
    GapLinearisationOptions,
    linearise_gap_probes,
)
