"""Simulated truth for tests of calibration: a POSOR, its target moved from stop to stop, a reference beside it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from posor_estimator.core.calibrate.parameters import the_sensor
from posor_estimator.core.calibrate.recording import Recording
from posor_estimator.core.calibrate.track import Track
from posor_estimator.core.calibration.model import calibration_from
from posor_estimator.core.calibration.quantity import Quantity
from posor_estimator.core.designs import STANDOFF, design
from posor_estimator.core.forward import scans_at
from posor_estimator.core.posor import Posor
from posor_estimator.core.sensors.gap_probes import GapProbesCalibration

if TYPE_CHECKING:
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import FloatArray

PERIOD_NS = 20_000_000
"""From scan to scan."""


def posor() -> Calibration:
    """Return a POSOR of 1985 size with three gap probes and two diodes."""
    return design("triad_diodes")


def exact(calibration: Calibration) -> Calibration:
    """Return a calibration in which nothing is uncertain, for a truth that differs only in what is to be found."""

    def stripped(part: Any) -> Any:
        if isinstance(part, dict):
            return {key: stripped(value) for key, value in part.items() if not (key == "sigma" and "unit" in part)}
        return [stripped(value) for value in part] if isinstance(part, list | tuple) else part

    return calibration_from(stripped(calibration.model_dump(mode="json", exclude_defaults=True)))


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


def tilted(
    calibration: Calibration, angles: FloatArray, rng: np.random.Generator, *, scans_each: int = 25, sigma: float = 0.0
) -> Recording:
    """Return a recording of the target leant to stops about X and Y [rad], (s, 2), with the pose as the reference.

    It stands at another height at each stop, which the reference does not know. ``sigma`` [rad] is how far off each
    reading of the angles is.
    """
    shown = angles + sigma * rng.normal(size=angles.shape)
    heights = STANDOFF + 2e-5 * rng.normal(size=(len(angles), 1))
    path = held(np.hstack([angles, heights, shown]), scans_each)

    def rotations(pair: FloatArray) -> Rotation:
        return Rotation.from_rotvec(np.column_stack([pair, np.zeros(len(pair))]))

    still = np.zeros((len(path), 2))
    translations = np.column_stack([still, path[:, 2]])
    told = np.column_stack([still, np.full(len(path), STANDOFF), rotations(path[:, 3:5]).as_quat()])
    taken = recording(calibration, rotations(path[:, :2]).as_matrix(), translations, told, rng)
    track = taken.tracks["/reference"]
    sigmas = np.array([0.0, 0.0, 0.0, 0.5 * sigma, 0.5 * sigma, 0.0, 0.0])
    return replace(taken, tracks={"/reference": replace(track, sigmas=sigmas)})


def with_tips(calibration: Calibration, tips: FloatArray) -> Calibration:
    """Return the calibration with other probe tips [m], (probes, 3)."""
    sensor = the_sensor(calibration, GapProbesCalibration, "campaign")[1]
    probes = [
        probe.model_copy(update={"tip": Quantity(value=tip.tolist(), unit="m")})
        for probe, tip in zip(sensor.probes, tips, strict=True)
    ]
    others = [other for other in calibration.sensors if other is not sensor]
    return calibration.model_copy(update={"sensors": [sensor.model_copy(update={"probes": probes}), *others]})
