"""Simulated truth for the tests of calibration procedures: a POSOR, its target moved from stop to stop, a reference."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor_estimator.core.calibrate.recording import Recording
from posor_estimator.core.calibrate.track import Track
from posor_estimator.core.designs import design
from posor_estimator.core.forward import scans_at
from posor_estimator.core.posor import Posor

if TYPE_CHECKING:
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

PERIOD_NS = 20_000_000
"""From scan to scan."""
STANDOFF = 0.735e-3


def posor() -> Calibration:
    return design("triad_diodes")


def held(values: FloatArray, scans_each: int, moving: int = 5) -> FloatArray:
    """Return stops (s, k) as time goes: each held for some scans, the way between them gone in a few."""
    parts = []
    for here, there in zip(values, [*values[1:], values[-1]], strict=True):
        parts.append(np.tile(here, (scans_each, 1)))
        share = (np.arange(1, moving + 1) / (moving + 1))[:, None]
        parts.append(here + share * (there - here))
    return np.concatenate(parts)


def recording(
    calibration: Calibration,
    rotations: FloatArray,
    translations: FloatArray,
    reference: FloatArray,
    rng: np.random.Generator,
    *,
    reference_sigma: float = 0.0,
    supply_voltages: FloatArray | None = None,
) -> Recording:
    """Return what a bag would hold: scans at poses (n, 3, 3), (n, 3), and the reference (n, k) at the same times.

    The stated uncertainty of the reference is a displacement of each stop as a whole, as of the stage that is set.
    """
    stamps = np.arange(1, len(translations) + 1, dtype=np.int64) * PERIOD_NS
    stack = Posor(calibration).stack
    scans = scans_at(stack, rotations, translations, stamps, supply_voltages=supply_voltages, noise=rng)
    sigmas = np.full(reference.shape[1], reference_sigma)
    return Recording(
        scans, {"/reference": Track(stamps, reference, sigmas, "simulated, topic /reference")}, "simulated"
    )


def lifted(
    calibration: Calibration, lifts: FloatArray, rng: np.random.Generator, *, scans_each: int = 25, sigma: float = 0.0
) -> Recording:
    """Return a recording of the target lifted along Z to stops [m], (s,), with the lift as the reference (n, 1)."""
    shown = lifts + sigma * rng.normal(size=len(lifts))
    path = held(np.column_stack([lifts, shown]), scans_each)
    translations = np.zeros((len(path), 3))
    translations[:, 2] = path[:, 0]
    rotations = np.tile(np.eye(3), (len(path), 1, 1))
    return recording(calibration, rotations, translations, path[:, 1:], rng, reference_sigma=sigma)
