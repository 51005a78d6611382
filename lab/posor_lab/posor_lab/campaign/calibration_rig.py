# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The calibration rig of a campaign: raw scans with noise and converter, and the readings of a reference."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor.bags.recording import Recording, Track
from posor.estimation.forward import empty_scans
from posor.model.native_coordinates import native_from_rotation, rotation_from_native
from posor.model.scan import NO_SOURCE, SATURATED, SIMULATED
from posor.numerics.vector import wrapped_angles
from posor.sensors.diodes import Diodes
from posor_drivers.simulator.electronics import HOME_MARK, convert_to_digital
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from posor.estimation.sensor_stack import Stack
    from posor.model.scan import Scans
    from posor.numerics.array_types import FloatArray, IntArray

    from posor_lab.true_scans import TruePosor

PERIOD_NS = 20_000_000  # from scan to scan
BEGIN_NS = 1_795_000_000_000_000_000
BITS = 16
VOLTS = np.array([-10.0, 10.0])
AMPERES = np.array([0.0, 2e-4])
REFERENCE = "/reference"
SUPPLY, RIPPLE = 15.0, 5e-3  # mean and slow variation of the supply voltage [V]
SUPPLY_NOISE = 2e-4  # noise of the measured supply voltage [V]
DARK = 1e-7  # current of each contact of a dark diode [A]


def scan_stamps(count: int) -> IntArray:
    """Return the stamps of scans [ns], (n,)."""
    return BEGIN_NS + np.arange(1, count + 1, dtype=np.int64) * PERIOD_NS


def rotations_of_natives(natives: FloatArray) -> FloatArray:
    """Return R_R_T of native coordinates (n, 6), (n, 3, 3)."""
    return np.array([rotation_from_native(*native[3:]) for native in natives])


def natives_of_poses(rotations: FloatArray, translations: FloatArray) -> FloatArray:
    """Return native coordinates (n, 6)."""
    return np.array([[*t, *native_from_rotation(r)] for r, t in zip(rotations, translations, strict=True)])


def simulate_scans(
    real: TruePosor,
    stack: Stack,
    natives: FloatArray,
    random: np.random.Generator,
    supply_voltages: FloatArray | None = None,
) -> Scans:
    """Return the scans of a target at native coordinates x, y, gap [m], alpha, beta, theta [rad], (n, 6).

    ``real`` reads the sensors, ``stack`` holds their true parameters.
    """
    count, stamps = len(natives), scan_stamps(len(natives))
    if supply_voltages is None:
        supply_voltages = SUPPLY + RIPPLE * np.sin(np.linspace(0.0, 5.0, count))
    rotations, translations = rotations_of_natives(natives), np.ascontiguousarray(natives[:, :3])
    scans = real.scans_at(stack, rotations, translations, stamps, supply_voltages=supply_voltages, noise=random)
    measured = supply_voltages + SUPPLY_NOISE * random.normal(size=count)
    home = _home_marks(stack, natives[:, 5])
    return scans.with_fields({"supply_voltages": measured}).with_fields({"at_home": home})


def simulate_single_source_scans(
    real: TruePosor, stack: Stack, translations: FloatArray, source: int, random: np.random.Generator
) -> Scans:
    """Return the scans of diodes over which one light source of a level target is moved, translations (n, 3)."""
    count, diodes = len(translations), len(_diodes(stack).reading_names) // 2
    level, lit = np.tile(np.eye(3), (count, 1, 1)), np.full((count, diodes), source)
    readings = real.joint(stack).readings(level, translations, lit_sources=lit)
    return _noisy_currents(stack, readings["diode_currents"], lit, random)


def simulate_spot_scans(
    real: TruePosor, stack: Stack, diode: int, spots: FloatArray, random: np.random.Generator
) -> Scans:
    """Return the scans of one diode with its light at spots (n, 2) [m]; the other diodes are dark."""
    count, diodes = len(spots), len(_diodes(stack).reading_names) // 2
    lit, currents = np.full((count, diodes), NO_SOURCE), np.full((count, diodes, 4), np.nan)
    lit[:, diode], currents[:, diode] = diode, real.joint(stack).spot_currents(diode, spots)
    return _noisy_currents(stack, currents, lit, random)


def _diodes(stack: Stack) -> Diodes:
    return next(sensor for sensor in stack.sensors if isinstance(sensor, Diodes))


def _noisy_currents(stack: Stack, currents: FloatArray, lit: IntArray, random: np.random.Generator) -> Scans:
    """Return scans with noisy currents (n, d, 4) of the diodes alone."""
    scans = empty_scans(scan_stamps(len(lit))).with_fields({"lit_sources": lit, "diode_currents": currents})
    return scans.with_fields(_diodes(stack).disturbed(scans, random))


def _home_marks(stack: Stack, thetas: FloatArray) -> IntArray:
    rings = [sensor for sensor in stack.sensors if hasattr(sensor, "bumps")]
    if not rings:
        return np.zeros(len(thetas), dtype=np.int64)
    from_home = wrapped_angles(thetas)
    return np.asarray(np.abs(from_home) < HOME_MARK * 2.0 * np.pi / rings[0].bumps, dtype=np.int64)


def record_scans(scans: Scans, track: Track | None) -> Recording:
    """Return scans after the converter, with the reference, as a recording.

    A probe without target reads the upper end of its range; a diode without light reads the dark current.
    """
    fields, saturated = {}, np.zeros(len(scans), dtype=bool)
    for name, limits, missing_value in (
        ("gap_voltages", VOLTS, VOLTS[1]),
        ("ring_voltages", VOLTS, VOLTS[1]),
        ("diode_currents", AMPERES, DARK),
    ):
        values = getattr(scans, name)
        values = np.where(np.isnan(values), missing_value, values)
        fields[name], at_limit = convert_to_digital(values, limits, BITS, steps=True)
        saturated |= at_limit
    statuses = SIMULATED | SATURATED * saturated.astype(np.int64)
    tracks = {} if track is None else {REFERENCE: track}
    return Recording(scans.with_fields(fields), tracks, "simulated", statuses=statuses)


def reference_track(values: FloatArray, sigmas: FloatArray) -> Track:
    """Return the readings of an instrument at the times of the scans, (n, k)."""
    return Track(scan_stamps(len(values)), values, np.asarray(sigmas, dtype=float), f"simulated, topic {REFERENCE}")


def pose_reference_track(natives: FloatArray, sigma_m: float, sigma_rad: float) -> Track:
    """Return the readings of a pose instrument, native coordinates (n, 6), with its standard uncertainties."""
    quaternions = Rotation.from_matrix(rotations_of_natives(natives)).as_quat()
    flipped = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    signs = np.cumprod(np.concatenate([[1.0], np.where(flipped, -1.0, 1.0)]))
    values = np.column_stack([natives[:, :3], quaternions * signs[:, None]])
    return reference_track(values, np.array([sigma_m] * 3 + [0.5 * sigma_rad] * 4))
