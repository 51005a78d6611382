"""Run a campaign in memory: the same procedures on the same recordings, with the same changes to the calibration."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor_estimator.core.calibrate.procedure import procedures
from posor_estimator.core.calibrate.result import Run, applied

from posor_bringup.campaign.steps import steps_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from posor_estimator.core.calibrate.procedure import Outcome
    from posor_estimator.core.calibration.model import Calibration

    from posor_bringup.campaign.plant import Plant
    from posor_bringup.campaign.steps import Step


@dataclass(frozen=True)
class Done:
    """A step that was taken.

    Attributes:
        step: The step.
        outcome: What the procedure found.
        calibration: What is known afterwards.

    """

    step: Step
    outcome: Outcome
    calibration: Calibration


def run_campaign(plant: Plant) -> Iterator[Done]:
    """Take the steps of a campaign, one after the other.

    Raises:
        PosorError: A procedure refuses its recording.

    """
    known, calibration = procedures(), plant.known
    for step in steps_of(plant.name):
        procedure = known[step.procedure]
        recording = step.record(plant)
        outcome = procedure.run(recording, calibration, procedure.options(**step.options))
        run = Run(procedure.name, {}, [], dt.datetime(2026, 1, 1, tzinfo=dt.UTC))
        calibration = applied(calibration, outcome, recording, run)
        yield Done(step, outcome, calibration)
