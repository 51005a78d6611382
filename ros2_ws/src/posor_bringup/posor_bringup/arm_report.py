"""Writes the report of a simulated arm: page, picture, and the figures for other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from posor_estimator.errors import PosorError

from posor_bringup.arm_figures import draw
from posor_bringup.arm_record import rms
from posor_bringup.document import Picture, Section, document, findings_table, notes_list, terms_list

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from posor_drivers.simulator.scenario import Scenario
    from posor_estimator.core.arm import Arm

    from posor_bringup.arm_coverage import Coverage
    from posor_bringup.arm_findings import ArmOutcome
    from posor_bringup.arm_record import ArmRecord
    from posor_bringup.findings import Findings

HEADINGS: Mapping[str, str] = {
    "computed": "found",
    "stated": "expected",
    "limit": "must be",
    "source": "source",
}
"""What the columns of the findings are called."""


def write_report(folder: Path, arm: Arm, scenario: Scenario, outcome: ArmOutcome, found: Findings) -> None:
    """Write ``report.html`` and ``report.png``.

    Raises:
        PosorError: They cannot be written.

    """
    title = f"Simulated arm {arm.name}: its endpoint by POSORs and by encoders alone"
    picture = draw(outcome, title)
    text = document(
        title,
        "Everything holds." if found.holds else "Not everything holds.",
        holds=found.holds,
        picture=Picture(picture, "Errors of the endpoint against time, the path, histograms, the controller"),
        sections=(
            Section("Findings", findings_table(found, HEADINGS)),
            Section("Notes", notes_list(_notes(outcome))),
            Section("Provenance", terms_list(_provenance(arm, scenario))),
        ),
    )
    try:
        (folder / "report.png").write_bytes(picture)
        (folder / "report.html").write_text(text, encoding="utf-8")
    except OSError as error:
        raise PosorError(f"cannot be written: {error.strerror}", where=str(folder)) from error


def _notes(outcome: ArmOutcome) -> Iterator[str]:
    if outcome.before is not None:
        yield (
            "Truth, POSOR endpoint and encoders were received over ROS and joined by their stamps, each node being a "
            "process of its own. Encoders alone: nominal kinematics of the angles that the motors' encoders read."
        )
        yield (
            "An arm is one draw of all calibration and beam parameters, so its error hardly changes along the path and "
            "its NEES need not average 6: only over many arms must 95 % of the poses lie in their published regions."
        )
    if outcome.coverage is not None:
        yield (
            "Many arms: each has parameters of POSORs and beams of its own, drawn with the files' standard "
            "uncertainties, its own runout and its own noise; raw scans go through the estimator and the chain, which "
            "know the files only. Drifts, dirt, dropouts and latency are off, since no file states an uncertainty for "
            "them, and each pose is one at rest."
        )
        yield (
            "Sag: the same scans through a chain that takes the beams for straight. The displacement found is the mean "
            "over all arms, the predicted one follows from the beams file alone."
        )
    if outcome.after is not None:
        yield (
            "Controller: a stage of three axes between the last joint and the endpoint, commanded from the POSOR "
            "endpoint. The distance is that of the true endpoint, which the controller does not know, to its target. "
            "Its peaks are where a joint turns round: backlash is taken up at once, the stage follows some ticks later."
        )


def _provenance(arm: Arm, scenario: Scenario) -> dict[str, str]:
    hashes = {f"calibration of {joint}": arm.calibration(joint).content_hash for joint in arm.calibrations}
    return {
        "arm": f"{arm.name}, {len(arm.calibrations)} POSORs",
        "scenario": f"{scenario.name}, seed {scenario.seed}, {scenario.ticks_per_second} Hz, cycle of "
        f"{scenario.duration.number:g} s",
        "scenario's source": f"{scenario.provenance.source}; {scenario.provenance.method}",
        **{name: f"hash {content}" for name, content in hashes.items()},
    }


def figures_of(outcome: ArmOutcome) -> dict[str, Any]:
    """Return all figures of a run for a JSON file; what was not asked for is left out."""
    made: dict[str, Any] = {}
    if outcome.budget is not None:
        made["budget"] = outcome.budget
    if outcome.coverage is not None:
        made |= _coverage_figures(outcome.coverage)
    before, after = outcome.before, outcome.after
    if before is not None and outcome.accounts is not None:
        made |= _run_figures(before)
        made["ticks"] = {
            "recorded": outcome.accounts.ticks,
            "with_pose": outcome.accounts.poses,
            "without_pose_by_cause": dict(outcome.accounts.causes),
            "unaccounted": outcome.accounts.unaccounted,
        }
        if after is not None:
            made["controller"] = {
                "before_rms_m": rms(before.off_target),
                "after_rms_m": rms(after.off_target),
                "before_max_m": float(np.nanmax(before.off_target)),
                "after_max_m": float(np.nanmax(after.off_target)),
            }
    return made


def _run_figures(record: ArmRecord) -> dict[str, Any]:
    errors = {"posor": record.posor_errors, "encoder_only": record.encoder_errors}
    return {
        "endpoint_error_rms_m": {name: rms(error[:, :3]) for name, error in errors.items()},
        "endpoint_error_max_m": {
            name: float(np.nanmax(np.linalg.norm(error[:, :3], axis=1))) for name, error in errors.items()
        },
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
