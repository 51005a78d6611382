"""A campaign as its user would run it: each step a rosbag2 bag, each procedure by the command line's own code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import yaml
from posor_drivers.recording_bag import entries, write_bag
from posor_estimator.calibrate.command import calibrate, parser, tell
from posor_estimator.core.calibration.load import load_calibration
from rich.console import Console

from posor_bringup.campaign.bench import REFERENCE
from posor_bringup.campaign.steps import steps_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from posor_estimator.core.calibrate.procedure import Outcome
    from posor_estimator.core.calibration.model import Calibration

    from posor_bringup.campaign.plant import Plant
    from posor_bringup.campaign.steps import Step

WIDTH = 118


@dataclass(frozen=True)
class Bagged:
    """A step of a campaign that was recorded, and calibrated from.

    Attributes:
        step: The step.
        arguments: Command line of the procedure.
        outcome: What it found.
        calibration: What is known afterwards.

    """

    step: Step
    arguments: tuple[str, ...]
    outcome: Outcome
    calibration: Calibration


def arguments_of(step: Step, bag: Path, known: Path, output: Path) -> list[str]:
    """Return the command line of a step, ``calibrate`` itself left out."""
    arguments = [step.procedure, str(bag), "--calibration", str(known), "--output", str(output)]
    for name, value in step.options.items():
        arguments += [f"--{name.replace('_', '-')}", str(value)]
    if step.uncertainty:
        arguments += ["--uncertainty", f"{REFERENCE}={','.join(f'{value:g}' for value in step.uncertainty)}"]
        arguments += ["--instrument", f"{REFERENCE}={step.instrument}"]
    return arguments


def make_bags(plant: Plant, folder: Path, on_made: Callable[[], None] = lambda: None) -> dict[str, Path]:
    """Record all steps of a campaign; return the bags by the steps' names."""
    folder.mkdir(parents=True)
    bags = {}
    for step in steps_of(plant.name):
        bags[step.name] = write_bag(folder / step.name, entries(step.record(plant)))
        on_made()
    return bags


def calibrate_bags(
    plant: Plant, bags: dict[str, Path], folder: Path, on_step: Callable[[], None] = lambda: None
) -> list[Bagged]:
    """Run every procedure of a campaign on its bag, each beginning from the file that the one before has written.

    Leaves ``as_built.yaml``, a file and what was printed for each step; the last file is the result.

    Raises:
        PosorError: A procedure refuses its bag.

    """
    known = folder / "as_built.yaml"
    content = plant.known.model_dump(mode="json", exclude_defaults=True)
    known.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120), encoding="utf-8")
    done = []
    for step in steps_of(plant.name):
        output = folder / f"{step.name}.yaml"
        arguments = arguments_of(step, bags[step.name], known, output)
        options = parser().parse_args(arguments)
        found = calibrate(options, lambda _: None)
        with (folder / f"{step.name}.txt").open("w", encoding="utf-8") as log:
            tell(found, options, Console(file=log, width=WIDTH))
        known = output
        done.append(Bagged(step, tuple(arguments), found.outcome, load_calibration(output)))
        on_step()
    return done
