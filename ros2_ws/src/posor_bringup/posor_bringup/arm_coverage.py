"""Does the endpoint's published uncertainty hold, and does the sag matter as predicted? Asked of many arms. No ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from posor_drivers.simulator.scenario import load_scenario

from posor_bringup.arm_draws import ArmDrawer, Draws, draw_arms
from posor_bringup.arm_record import REGION_LIMIT, rms

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_estimator.core.arm import Arm
    from posor_estimator.core.types import FloatArray

ARMS = 1000
POSES = 6


@dataclass(frozen=True)
class Figure:
    """A figure and its standard uncertainty, the arms being independent of one another, the poses of one arm not."""

    value: float
    sigma: float

    @staticmethod
    def of(by_arm: FloatArray) -> Figure:
        """Return the mean over the arms, (a,)."""
        return Figure(float(np.mean(by_arm)), float(np.std(by_arm, ddof=1) / np.sqrt(len(by_arm))))


@dataclass(frozen=True)
class Coverage:
    """What many arms say.

    Attributes:
        arms: How many were drawn.
        poses: Poses of each.
        lost: Poses that a POSOR did not give; they count as outside.
        inside: Part of the poses inside the published 95 % region.
        nees: Mean normalised error squared; 6 where the covariance is right.
        normalised: All of them, (a p,).
        rms_m: Endpoint's distance from the truth, root mean square [m].
        rms_without_sag_m: The same where the chain does not correct the beams' sag.
        shift_found_m: Mean displacement that the uncorrected sag leaves, (p, 3), axes of the base.
        shift_predicted_m: What the beams file predicts.
        shift_ratio: Found over predicted, along the predicted displacement.

    """

    arms: int
    poses: int
    lost: int
    inside: Figure
    nees: Figure
    normalised: FloatArray
    rms_m: float
    rms_without_sag_m: float
    shift_found_m: FloatArray
    shift_predicted_m: FloatArray
    shift_ratio: Figure


def coverage(
    arm: Arm,
    arms: int = ARMS,
    poses: int = POSES,
    *,
    workers: int = 0,
    on_drawn: Callable[[int], None] = lambda _: None,
) -> Coverage:
    """Return how the published uncertainty and the predicted sag of an arm hold over many arms like it.

    The arms' seeds follow that of the scenario, which is the demo's own arm.

    Args:
        arm: The arm; it has a scenario and a beams file.
        arms: How many to draw, two or more.
        poses: Poses of each, evenly spread over the scenario.
        workers: Processes; 0: one for each processor.
        on_drawn: Told how many more have been drawn; what it raises ends the run.

    Raises:
        ParameterError: The arm has no scenario or no beams file.
        PosorError: A file cannot be used.

    """
    predicted = ArmDrawer(arm, poses).predicted_shift()[:, :3]
    seed = 0 if arm.scenario is None else load_scenario(arm.scenario).seed + 1
    return judged(draw_arms(arm, arms, poses, seed, workers=workers, on_drawn=on_drawn), predicted)


def judged(draws: Draws, predicted: FloatArray) -> Coverage:
    """Return the figures of drawn arms.

    Args:
        draws: The arms.
        predicted: Displacement by the uncorrected sag [m], (p, 3), axes of the base.

    """
    arms, poses = draws.normalised.shape
    known = np.isfinite(draws.normalised)
    left = np.where(known[..., None], draws.without_sag[..., :3], 0.0)
    seen = np.maximum(known.sum(axis=0), 1)[:, None]
    along = np.einsum("apk,pk->a", left, predicted)
    scale = np.einsum("ap,pk,pk->a", known, predicted, predicted)
    complete = scale > 0.0
    return Coverage(
        arms=arms,
        poses=poses,
        lost=draws.lost,
        inside=Figure.of(np.mean(np.where(known, draws.normalised, np.inf) <= REGION_LIMIT, axis=1)),
        nees=Figure.of(np.array([np.nanmean(of_arm) for of_arm in draws.normalised[known.any(axis=1)]])),
        normalised=draws.normalised[known],
        rms_m=rms(draws.errors[..., :3].reshape(-1, 3)),
        rms_without_sag_m=rms(draws.without_sag[..., :3].reshape(-1, 3)),
        shift_found_m=left.sum(axis=0) / seen,
        shift_predicted_m=predicted,
        shift_ratio=Figure.of(along[complete] / scale[complete]),
    )
