"""Report of a simulated arm: page, picture, and figures as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from posor.reporting.html_page import Section, bullet_list, definition_list, paragraph, render_page

from posor_lab.arm_study.arm_figures import draw_arm
from posor_lab.arm_study.arm_findings import REVERSALS
from posor_lab.arm_study.arm_plots import plot_axes, plot_controller, plot_coverage, plot_path
from posor_lab.arm_study.arm_record import rms
from posor_lab.output_files import write_files
from posor_lab.reports.findings import COMPARISON_HEADINGS, findings_table

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from posor.chain.arm_file import Arm
    from posor_drivers.simulator.scenario import Scenario

    from posor_lab.arm_study.arm_coverage import Coverage
    from posor_lab.arm_study.arm_findings import ArmOutcome
    from posor_lab.arm_study.arm_record import ArmRecord
    from posor_lab.reports.findings import Findings

RUN_NOTES = (
    (
        "Truth, endpoint and encoders were received over ROS and matched by their stamps; each node is a process of "
        "its own. Encoders alone: nominal kinematics with the angles of the motors' encoders."
    ),
    (
        "An arm is one draw of all calibration and beam parameters, so its error hardly changes along the path and its "
        "mean NEES need not be 6: only over many arms 95 % of the poses must lie in their published regions."
    ),
)
COVERAGE_NOTES = (
    (
        "Many arms: each has its own parameters of POSORs and beams, drawn with the standard uncertainties of the "
        "files, its own runout and its own noise. Raw scans go through the estimator and the chain, which know only "
        "the files. Drifts, contamination, dropouts and latency are off, since no file states an uncertainty for them; "
        "each pose is at rest."
    ),
    (
        "Sag: the same scans go through a chain with straight beams. The displacement found is the mean over all arms; "
        "the predicted one follows from the beams file alone."
    ),
)
CONTROLLER_NOTES = (
    (
        "Controller: a stage of three axes between the last joint and the endpoint follows the endpoint measured by "
        "the POSORs. The distance is that of the true endpoint, unknown to the controller, from its target."
    ),
)
BAND = (
    "The band is twice the published standard uncertainty, about zero, in the axes of the base. It contains noise and "
    "calibration. The calibration's part is one draw for this arm: it hardly changes along the path and shifts the "
    "whole curve. 95.4 % of the poses are expected in the band only over many arms."
)


def write_report(folder: Path, arm: Arm, scenario: Scenario, outcome: ArmOutcome, findings: Findings) -> None:
    """Write ``report.html`` and ``report.png``.

    Raises:
        ParameterError: They cannot be written.

    """
    title = f"Simulated arm {arm.name}: its endpoint by POSORs and by encoders alone"
    notes: tuple[str, ...] = RUN_NOTES if outcome.before is not None else ()
    notes += COVERAGE_NOTES if outcome.coverage is not None else ()
    notes += CONTROLLER_NOTES if outcome.after is not None else ()
    page = render_page(
        title,
        findings.sentence,
        holds=findings.holds,
        sections=(
            Section("Findings", findings_table(findings, COMPARISON_HEADINGS)),
            *_plotted_sections(outcome),
            Section("Notes", bullet_list(notes)),
            Section("Provenance", definition_list(_provenance(arm, scenario))),
        ),
    )
    write_files(folder, {"report.png": draw_arm(outcome, title), "report.html": page})


def _plotted_sections(outcome: ArmOutcome) -> Iterator[Section]:
    before, after, coverage = outcome.before, outcome.after, outcome.coverage
    if before is not None:
        yield Section("Error of each axis with its published band", paragraph(BAND), plot_axes(before))
        plots = plot_path(before)
        if after is None:
            yield Section("Endpoint along the path", Markup(), plots)
        else:
            plots.insert(1, plot_controller(before, after))
            yield Section("Endpoint along the path", paragraph(REVERSALS), plots)
    if coverage is not None:
        yield Section("Many arms", Markup(), plot_coverage(coverage))


def _provenance(arm: Arm, scenario: Scenario) -> dict[str, str]:
    return {
        "arm": f"{arm.name}, {len(arm.calibrations)} POSORs",
        "scenario": f"{scenario.name}, seed {scenario.seed}, {scenario.ticks_per_second} Hz, cycle of "
        f"{scenario.duration.number:g} s",
        "scenario's source": f"{scenario.provenance.source}; {scenario.provenance.method}",
        **{f"calibration of {joint}": f"hash {arm.calibration(joint).content_hash}" for joint in arm.calibrations},
    }


def arm_figures(outcome: ArmOutcome) -> dict[str, Any]:
    """Return all figures of a run for the JSON file."""
    figures: dict[str, Any] = {}
    if outcome.budget is not None:
        figures["budget"] = outcome.budget
    if outcome.coverage is not None:
        figures |= _coverage_figures(outcome.coverage)
    before, after = outcome.before, outcome.after
    if before is not None and outcome.ticks is not None:
        figures |= _endpoint_figures(before)
        figures["ticks"] = {
            "recorded": outcome.ticks.ticks,
            "with_pose": outcome.ticks.poses,
            "without_pose_by_cause": dict(outcome.ticks.causes),
            "unaccounted": outcome.ticks.unaccounted,
        }
        if after is not None:
            figures["controller"] = {
                "before_rms_m": rms(before.target_distances),
                "after_rms_m": rms(after.target_distances),
                "before_max_m": float(np.nanmax(before.target_distances)),
                "after_max_m": float(np.nanmax(after.target_distances)),
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
    return {
        "coverage95": coverage.inside.value,
        "coverage": {
            "standard_uncertainty": coverage.inside.sigma,
            "arms": coverage.arms,
            "poses_of_each": coverage.poses,
            "poses_lost": coverage.lost,
            "nees_mean": coverage.nees.value,
            "error_rms_m": coverage.rms_m,
        },
        "sag": {
            "error_rms_uncorrected_m": coverage.rms_without_sag_m,
            "error_rms_corrected_m": coverage.rms_m,
            "displacement_found_over_predicted": coverage.shift_ratio.value,
            "standard_uncertainty": coverage.shift_ratio.sigma,
            "displacement_found_m": np.linalg.norm(coverage.shift_found_m, axis=1).tolist(),
            "displacement_predicted_m": np.linalg.norm(coverage.shift_predicted_m, axis=1).tolist(),
        },
    }
