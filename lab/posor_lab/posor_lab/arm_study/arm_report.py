# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Report of a simulated arm: findings on endpoint, controller, coverage, sag and budget; page; figures as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from posor.reporting.figure_style import MICRON
from posor.reporting.html_page import Section, bullet_list, definition_list, paragraph, render_page

from posor_lab.accuracy.consistency import REGION
from posor_lab.arm_study.arm_plots import plot_axes, plot_controller, plot_coverage, plot_path
from posor_lab.arm_study.arm_record import rms
from posor_lab.lab_output import figures_of, page_notes
from posor_lab.reports.findings import COMPARISON_HEADINGS, Finding, Findings, findings_table, judge
from posor_lab.thesis_data import MICROINCH

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from posor.chain.arm_file import ArmFile
    from posor.numerics.array_types import FloatArray
    from posor_drivers.simulator.scenario import Scenario

    from posor_lab.arm_study.arm_coverage import Coverage
    from posor_lab.arm_study.arm_record import ArmRecord, TickOutcomes

COVERAGE_TOLERANCE = 0.02  # allowed difference of the coverage from 95 %
SHARED_TOLERANCE = 0.015  # the same of arms whose files state shared terms
SAG_TOLERANCE = 0.02  # allowed relative difference of the displacement by uncorrected sag from the predicted one
BUDGET_TOLERANCE = 0.02
MIN_SIGMAS = 3.0  # with few arms, a tolerance is at least so many standard uncertainties of the figure
BUDGET_FIGURES = {
    "alpha_x_urad": "about X",
    "alpha_y_urad": "about Y",
    "alpha_z_urad": "about Z",
    "displacement_uin": "displacement",
}
SURPRISING_SIGMAS = 2.0  # a coverage that differs by more standard uncertainties from 95 % gets a remark


@dataclass(frozen=True)
class ArmOutcome:
    """Results of a run; None: not requested."""

    before: ArmRecord | None = None  # one cycle without a controller
    after: ArmRecord | None = None  # one cycle with a controller
    ticks: TickOutcomes | None = None  # outcomes of the ticks of both
    coverage: Coverage | None = None  # figures of many arms
    budget: Mapping[str, Any] | None = None  # error budget of the endpoint, see ``arm_budget``


def arm_findings(outcome: ArmOutcome) -> Findings:
    """Return all figures of a run with their verdicts."""
    found: list[Finding] = []
    if outcome.before is not None and outcome.ticks is not None:
        found += _endpoint_findings(outcome.before, outcome.ticks)
        if outcome.after is not None:
            found.append(_controller_finding(outcome.before, outcome.after))
    if outcome.coverage is not None:
        found += _coverage_findings(outcome.coverage)
    if outcome.budget is not None:
        found += _budget_findings(outcome.budget)
    return Findings(tuple(found))


def _endpoint_findings(record: ArmRecord, ticks: TickOutcomes) -> Iterator[Finding]:
    texts = page_notes("arm")["findings"]
    accounted = ticks.unaccounted == 0 and ticks.ticks > 0
    yield judge(texts["ticks"], holds=accounted, ticks=ticks.ticks, sentence=ticks.sentence)
    encoders = _error_sizes(record.encoder_errors)
    posors = _error_sizes(record.posor_errors)
    published = rms(np.sqrt(np.trace(record.covariances[:, :3, :3], axis1=1, axis2=2))) / MICRON
    judged = published < encoders["rms"]
    yield judge(
        texts["posors" if judged else "posors_not_judged"],
        holds=posors["rms"] < encoders["rms"] if judged else None,
        published=published,
        encoders=encoders["rms"],
        poses=np.count_nonzero(record.has_pose),
        **posors,
    )
    yield judge(texts["encoders"], **encoders)
    yield judge(texts["own_region"], inside=100.0 * record.inside, nees=np.nanmean(record.normalised))


def _error_sizes(errors: FloatArray) -> dict[str, Any]:
    """Return rms and largest length of the position [um], and rms of the orientation [urad], of errors (n, 6)."""
    largest = float(np.nanmax(np.linalg.norm(errors[:, :3], axis=1)))
    sizes = {"rms": rms(errors[:, :3]), "largest": largest, "orientation": rms(errors[:, 3:])}
    return {name: size / MICRON for name, size in sizes.items()}


def _controller_finding(before: ArmRecord, after: ArmRecord) -> Finding:
    notes = page_notes("arm")
    without, with_controller = rms(before.target_distances) / MICRON, rms(after.target_distances) / MICRON
    return judge(
        notes["findings"]["controller"],
        holds=with_controller < without,
        rms=with_controller,
        largest=np.nanmax(after.target_distances) / MICRON,
        without=without,
        gain=without / with_controller,
        reversals=notes["reversals"],
    )


def _coverage_findings(coverage: Coverage) -> Iterator[Finding]:
    texts = page_notes("arm")["findings"]
    inside, ratio = coverage.inside, coverage.shift_ratio
    sample = f"{coverage.arms} arms, {coverage.poses} poses of each"
    binomial = float(np.sqrt(REGION * (1.0 - REGION) / (coverage.arms * coverage.poses)))
    independent = coverage.inside_independent
    tolerance = COVERAGE_TOLERANCE if independent is None else SHARED_TOLERANCE
    allowed = max(tolerance, MIN_SIGMAS * max(inside.sigma, binomial))
    yield judge(
        texts["region"],
        holds=abs(inside.value - REGION) <= allowed,
        inside=100.0 * inside.value,
        sigma=100.0 * inside.sigma,
        low=100.0 * (REGION - allowed),
        high=min(100.0, 100.0 * (REGION + allowed)),
        sample=sample,
        nees=coverage.nees.value,
        lost=coverage.lost,
        surprise=_coverage_remark(coverage),
    )
    if independent is not None:
        yield judge(texts["independent"], inside=100.0 * independent.value, sigma=100.0 * independent.sigma)
    allowed = max(SAG_TOLERANCE, MIN_SIGMAS * ratio.sigma)
    yield judge(
        texts["sag"],
        holds=abs(ratio.value - 1.0) <= allowed,
        ratio=ratio.value,
        sigma=ratio.sigma,
        low=1.0 - allowed,
        high=1.0 + allowed,
        found=_range_um(coverage.shift_found_m),
        predicted=_range_um(coverage.shift_predicted_m),
    )
    without, rest = coverage.rms_without_sag_m / MICRON, coverage.rms_m / MICRON
    expected = float(np.hypot(rest, rms(coverage.shift_predicted_m) / MICRON))
    yield judge(texts["without_sag"], without=without, expected=expected, rms=rest, sample=sample)


def _coverage_remark(coverage: Coverage) -> str:
    """Return how the published covariance differs from the scatter, if the coverage differs visibly from 95 %."""
    sigmas = (coverage.inside.value - REGION) / coverage.inside.sigma if coverage.inside.sigma > 0.0 else 0.0
    if abs(sigmas) <= SURPRISING_SIGMAS:
        return ""
    ratio = 100.0 * (6.0 / coverage.nees.value - 1.0)
    size = "larger" if ratio > 0.0 else "smaller"
    return (
        f"; {abs(sigmas):.1f} standard uncertainties from 95 %: on average the published variance is {abs(ratio):.0f} "
        f"% {size} than that of the errors"
    )


def _budget_findings(budget: Mapping[str, Any]) -> Iterator[Finding]:
    notes = page_notes("arm")
    for configuration, figures in budget.items():
        for key, figure in BUDGET_FIGURES.items():
            is_angle, value = key.endswith("urad"), figures[key]
            unit, scale = ("urad", 1.0) if is_angle else ("um", MICROINCH / MICRON)
            common = {"configuration": configuration, "figure": figure, "value": scale * value, "unit": unit}
            printed = figures.get("printed", {}).get(key)
            if not printed:
                yield judge(notes["findings"]["budget"], **common)
                continue
            judged = configuration == "extended"  # how the thesis computed the bent arm is not known
            yield judge(
                notes["findings"]["budget_printed"],
                holds=abs(value / printed - 1.0) <= BUDGET_TOLERANCE if judged else None,
                stated=f"{scale * printed:.3g} {unit}" + ("" if is_angle else f" ({printed:g} uin)"),
                limit=f"within {100.0 * BUDGET_TOLERANCE:.0f} %" if judged else "",
                reason="" if is_angle else notes["printed_displacement"][configuration],
                **common,
            )


def _range_um(vectors: FloatArray) -> str:
    lengths = np.linalg.norm(vectors, axis=1) / MICRON
    return f"{lengths.min():.1f} to {lengths.max():.1f}"


def arm_page(arm: ArmFile, scenario: Scenario, outcome: ArmOutcome, findings: Findings) -> str:
    """Return the page of a run."""
    notes = page_notes("arm")
    parts = {"run": outcome.before, "coverage": outcome.coverage, "controller": outcome.after}
    shown = [text for part, result in parts.items() if result is not None for text in notes[part]]
    return render_page(
        f"Simulated arm {arm.name}: its endpoint by POSORs and by encoders alone",
        findings.sentence,
        holds=findings.holds,
        sections=(
            Section("Findings", findings_table(findings, COMPARISON_HEADINGS)),
            *_plotted_sections(outcome, notes),
            Section("Notes", bullet_list(shown)),
            Section("Provenance", definition_list(_provenance(arm, scenario))),
        ),
    )


def _plotted_sections(outcome: ArmOutcome, notes: Mapping[str, Any]) -> Iterator[Section]:
    before, after, coverage = outcome.before, outcome.after, outcome.coverage
    if before is not None:
        yield Section("Error of each axis with its published band", paragraph(notes["band"]), plot_axes(before))
        plots = plot_path(before)
        if after is not None:
            plots.insert(1, plot_controller(before, after))
        yield Section("Endpoint along the path", paragraph(notes["reversals"]) if after else Markup(), plots)
    if coverage is not None:
        yield Section("Many arms", Markup(), plot_coverage(coverage))


def _provenance(arm: ArmFile, scenario: Scenario) -> dict[str, str]:
    return {
        "arm": f"{arm.name}, {len(arm.calibrations)} POSORs",
        "scenario": f"{scenario.name}, seed {scenario.seed}, {scenario.ticks_per_second} Hz, cycle of "
        f"{scenario.duration.number:g} s",
        "scenario's source": f"{scenario.provenance.source}; {scenario.provenance.method}",
        **{f"calibration of {joint}": f"hash {arm.calibration(joint).content_hash}" for joint in arm.calibrations},
    }


def arm_figures(outcome: ArmOutcome) -> dict[str, Any]:
    """Return all figures of a run for the JSON file."""
    figures: dict[str, Any] = {} if outcome.budget is None else {"budget": outcome.budget}
    if outcome.coverage is not None:
        figures |= _coverage_figures(outcome.coverage)
    before, after = outcome.before, outcome.after
    if before is not None and outcome.ticks is not None:
        figures |= _endpoint_figures(before)
        figures["ticks"] = figures_of(outcome.ticks, page_notes("arm")["ticks"])
        if after is not None:
            distances = {"before": before.target_distances, "after": after.target_distances}
            figures["controller"] = {
                **{f"{name}_rms_m": rms(values) for name, values in distances.items()},
                **{f"{name}_max_m": float(np.nanmax(values)) for name, values in distances.items()},
            }
    return figures


def _endpoint_figures(record: ArmRecord) -> dict[str, Any]:
    errors = {"posor": record.posor_errors, "encoder_only": record.encoder_errors}
    distances = {name: np.linalg.norm(error[:, :3], axis=1) for name, error in errors.items()}
    return {
        "endpoint_error_rms_m": {name: rms(distance) for name, distance in distances.items()},
        "endpoint_error_max_m": {name: float(np.nanmax(distance)) for name, distance in distances.items()},
        "endpoint_error_rms_rad": {name: rms(error[:, 3:]) for name, error in errors.items()},
        "nees_mean": float(np.nanmean(record.normalised)),
        "inside95": record.inside,
    }


def _coverage_figures(coverage: Coverage) -> dict[str, Any]:
    figures = figures_of(coverage, page_notes("arm")["figures"])
    shifts = {"found": coverage.shift_found_m, "predicted": coverage.shift_predicted_m}
    if coverage.inside_independent is not None:
        figures["coverage95_independent"] = coverage.inside_independent.value
    figures["sag"] |= {f"displacement_{name}_m": np.linalg.norm(each, axis=1).tolist() for name, each in shifts.items()}
    return figures
