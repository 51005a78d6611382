# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Simulated recordings for tests of calibration: scans of a target moved from dwell to dwell, with a reference."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.bags.recording import Recording, Track
from posor.calibration.calibration_file import calibration_from, find_sensor
from posor.calibration.designs import STANDOFF, design
from posor.calibration.quantity import Quantity
from posor.estimation.forward import scans_at
from posor.estimation.posor import Posor
from posor.sensors.gap_probes import GapProbesCalibration
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration
    from posor.numerics.array_types import FloatArray

PERIOD_NS = 20_000_000  # from scan to scan


@cache
def diode_calibration() -> Calibration:
    """Return a POSOR of 1985 size with three gap probes and two diodes."""
    return design("triad_diodes")


def without_uncertainties(calibration: Calibration) -> Calibration:
    """Return a calibration without uncertainties, for a truth that differs only in the parameters of a fit."""

    def strip(part: Any) -> Any:
        if isinstance(part, dict):
            return {key: strip(value) for key, value in part.items() if not (key == "sigma" and "unit" in part)}
        return [strip(value) for value in part] if isinstance(part, list | tuple) else part

    return calibration_from(strip(calibration.model_dump(mode="json", exclude_defaults=True)))


def dwell_path(values: FloatArray, scans_per_dwell: int, moving_scans: int = 5) -> FloatArray:
    """Return dwells (d, k) as values scan by scan (n, k); after each dwell some scans on the way to the next one."""
    share = (np.arange(1, moving_scans + 1) / (moving_scans + 1))[:, None]
    parts = []
    for here, there in zip(values, [*values[1:], values[-1]], strict=True):
        parts += [np.tile(here, (scans_per_dwell, 1)), here + share * (there - here)]
    return np.concatenate(parts)


def simulated_recording(
    calibration: Calibration,
    rotations: FloatArray,
    translations: FloatArray,
    reference: FloatArray,
    rng: np.random.Generator,
    *,
    reference_sigma: float = 0.0,
    supply_voltages: FloatArray | None = None,
    temperatures: FloatArray | None = None,
    period_ns: int = PERIOD_NS,
) -> Recording:
    """Return the content of a bag: scans at poses (n, 3, 3), (n, 3), and the reference (n, k) at the same times.

    The stated uncertainty of the reference is a displacement of each dwell as a whole, as of a stage that is set.
    """
    stamps = np.arange(1, len(translations) + 1, dtype=np.int64) * period_ns
    stack, supplies = Posor(calibration).stack, supply_voltages
    scans = scans_at(
        stack, rotations, translations, stamps, supply_voltages=supplies, temperatures=temperatures, noise=rng
    )
    sigmas = np.full(reference.shape[1], reference_sigma)
    track = Track(stamps, reference, sigmas, "simulated, topic /reference")
    return Recording(scans, {"/reference": track}, "simulated")


def lifted_recording(
    calibration: Calibration, lifts: FloatArray, rng: np.random.Generator, *, scans_each: int = 25, sigma: float = 0.0
) -> Recording:
    """Return a recording of dwells along Z [m], (d,), with the lift as the reference (n, 1)."""
    shown = lifts + sigma * rng.normal(size=len(lifts))
    path = dwell_path(np.column_stack([lifts, shown]), scans_each)
    translations = np.zeros((len(path), 3))
    translations[:, 2] = path[:, 0]
    rotations = np.tile(np.eye(3), (len(path), 1, 1))
    return simulated_recording(calibration, rotations, translations, path[:, 1:], rng, reference_sigma=sigma)


def tilted_recording(
    calibration: Calibration, angles: FloatArray, rng: np.random.Generator, *, scans_each: int = 25, sigma: float = 0.0
) -> Recording:
    """Return a recording of dwells about X and Y [rad], (d, 2), with the pose as the reference.

    Each dwell has another height, which the reference does not know. ``sigma`` [rad] is the error of each reading of
    the angles.
    """
    shown = angles + sigma * rng.normal(size=angles.shape)
    heights = STANDOFF + 2e-5 * rng.normal(size=(len(angles), 1))
    path = dwell_path(np.hstack([angles, heights, shown]), scans_each)

    def rotations(pair: FloatArray) -> Rotation:
        return Rotation.from_rotvec(np.column_stack([pair, np.zeros(len(pair))]))

    across = np.zeros((len(path), 2))
    translations = np.column_stack([across, path[:, 2]])
    reference = np.column_stack([across, np.full(len(path), STANDOFF), rotations(path[:, 3:5]).as_quat()])
    recording = simulated_recording(calibration, rotations(path[:, :2]).as_matrix(), translations, reference, rng)
    sigmas = np.array([0.0, 0.0, 0.0, 0.5 * sigma, 0.5 * sigma, 0.0, 0.0])
    return replace(recording, tracks={"/reference": replace(recording.tracks["/reference"], sigmas=sigmas)})


def with_tips(calibration: Calibration, tips: FloatArray) -> Calibration:
    """Return the calibration with other probe tips [m], (probes, 3)."""
    sensor = find_sensor(calibration, GapProbesCalibration, "campaign")[1]
    probes = [
        probe.model_copy(update={"tip": Quantity(value=tip.tolist(), unit="m")})
        for probe, tip in zip(sensor.probes, tips, strict=True)
    ]
    others = [other for other in calibration.sensors if other is not sensor]
    return calibration.model_copy(update={"sensors": [sensor.model_copy(update={"probes": probes}), *others]})
