# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Runs a campaign: in memory, or with rosbag2 bags and the code of the ``calibrate`` command line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import yaml
from posor.calibration.calibration_file import load_calibration
from posor_calibration.calibrate_command import calibrate, make_parser, write_result
from posor_calibration.calibration_fit import fit_recording
from posor_calibration.procedure_registry import PROCEDURES
from rich.console import Console

from posor_lab.campaign.calibration_rig import REFERENCE
from posor_lab.campaign.campaign_steps import campaign_steps
from posor_lab.harness.calibration_bag import entries, write_bag

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from posor.calibration.calibration_file import Calibration
    from posor_calibration.procedure import Outcome

    from posor_lab.campaign.campaign_steps import CampaignStep
    from posor_lab.campaign.ground_truth import GroundTruth

WIDTH = 118


@dataclass(frozen=True)
class CompletedStep:
    """A completed step of a campaign: outcome of the procedure, and the calibration after the step."""

    step: CampaignStep
    outcome: Outcome
    calibration: Calibration


def run_in_memory(truth: GroundTruth) -> Iterator[CompletedStep]:
    """Run the steps of a campaign one after the other, without files.

    Raises PosorError: a procedure refuses its recording.
    """
    calibration = truth.as_built
    for step in campaign_steps(truth.name):
        procedure = PROCEDURES[step.procedure]
        recording = step.record(truth)
        settings = procedure.options(**step.options)
        found = fit_recording(procedure, calibration, recording, [], settings, {}, test_drift=False)
        calibration = found.calibration
        yield CompletedStep(step, found.outcome, calibration)


def step_arguments(step: CampaignStep, bag: Path, calibration: Path, output: Path) -> list[str]:
    """Return the arguments of ``calibrate`` for a step."""
    arguments = [step.procedure, str(bag), "--calibration", str(calibration), "--output", str(output)]
    for name, value in step.options.items():
        arguments += [f"--{name.replace('_', '-')}", str(value)]
    if step.uncertainty:
        arguments += ["--uncertainty", f"{REFERENCE}={','.join(f'{value:g}' for value in step.uncertainty)}"]
        arguments += ["--instrument", f"{REFERENCE}={step.instrument}"]
    return arguments


def record_bags(truth: GroundTruth, folder: Path, on_bag: Callable[[], None] = lambda: None) -> dict[str, Path]:
    """Record all steps of a campaign; return the bags by the names of the steps."""
    folder.mkdir(parents=True)
    bags = {}
    for step in campaign_steps(truth.name):
        bags[step.name] = write_bag(folder / step.name, entries(step.record(truth)))
        on_bag()
    return bags


def calibrate_from_bags(
    truth: GroundTruth, bags: dict[str, Path], folder: Path, on_step: Callable[[], None] = lambda: None
) -> list[CompletedStep]:
    """Run every procedure of a campaign on its bag, starting from the calibration file of the step before.

    Writes ``as_built.yaml``, and for each step a calibration file, its verdict, and its tables as page and JSON.

    Raises PosorError: a procedure refuses its bag.
    """
    known = folder / "as_built.yaml"
    content = truth.as_built.model_dump(mode="json", exclude_defaults=True)
    known.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120), encoding="utf-8")
    completed = []
    for step in campaign_steps(truth.name):
        output = folder / f"{step.name}.yaml"
        options = make_parser().parse_args(step_arguments(step, bags[step.name], known, output))
        found = calibrate(options, lambda _: None)
        with (folder / f"{step.name}.txt").open("w", encoding="utf-8") as log:
            write_result(found, options, Console(file=log, width=WIDTH))
        completed.append(CompletedStep(step, found.outcome, load_calibration(output)))
        known = output
        on_step()
    return completed
