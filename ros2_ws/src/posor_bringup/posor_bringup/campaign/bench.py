"""What is recorded on the bench of a campaign: raw scans with noise, from a converter, and a reference beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from posor_drivers.simulator.converter import converted
from posor_drivers.simulator.electronics import HOME_MARK, STATUS_SATURATED, STATUS_SIMULATED
from posor_estimator.core.calibrate.recording import Recording
from posor_estimator.core.calibrate.track import Track
from posor_estimator.core.forward import empty_scans, scans_at
from posor_estimator.core.kernels.rows import evaluate_all
from posor_estimator.core.native import native_from_rotation, rotation_from_native
from posor_estimator.core.scan import NO_SOURCE
from posor_estimator.core.stack import Stack
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from posor_estimator.core.scan import Scans
    from posor_estimator.core.sensors.diodes import Diodes
    from posor_estimator.core.types import FloatArray, IntArray

PERIOD_NS = 20_000_000
"""From scan to scan."""
BEGIN_NS = 1_795_000_000_000_000_000
BITS = 16
VOLTS = np.array([-10.0, 10.0])
AMPERES = np.array([0.0, 2e-4])
REFERENCE = "/reference"
SUPPLY, RIPPLE = 15.0, 5e-3
"""Mean of the supply voltage, and its slow change to either side [V]."""
SUPPLY_NOISE = 2e-4
"""Of the measured supply voltage [V]."""
DARK = 1e-7
"""Current of each contact of a diode that no light falls on [A]."""


def stamps_of(count: int) -> IntArray:
    """Return the stamps of scans [ns], (n,)."""
    return BEGIN_NS + np.arange(1, count + 1, dtype=np.int64) * PERIOD_NS


def rotations_of(natives: FloatArray) -> FloatArray:
    """Return R_R_T of native coordinates (n, 6), (n, 3, 3)."""
    return np.array([rotation_from_native(*native[3:]) for native in natives])


def natives_of(rotations: FloatArray, translations: FloatArray) -> FloatArray:
    """Return native coordinates (n, 6)."""
    return np.array([[*t, *native_from_rotation(r)] for r, t in zip(rotations, translations, strict=True)])


def scans_of(
    stack: Stack, natives: FloatArray, random: np.random.Generator, supply_voltages: FloatArray | None = None
) -> Scans:
    """Return the scans of a target at native coordinates x, y, gap [m], alpha, beta, theta [rad], (n, 6)."""
    count, stamps = len(natives), stamps_of(len(natives))
    if supply_voltages is None:
        supply_voltages = SUPPLY + RIPPLE * np.sin(np.linspace(0.0, 5.0, count))
    translations = np.ascontiguousarray(natives[:, :3])
    scans = scans_at(stack, rotations_of(natives), translations, stamps, supply_voltages=supply_voltages, noise=random)
    told = supply_voltages + SUPPLY_NOISE * random.normal(size=count)
    home = _at_home(stack, natives[:, 5])
    return scans.with_fields({"supply_voltages": told}).with_fields({"at_home": home})


def scans_of_one_source(sensor: Diodes, translations: FloatArray, source: int, random: np.random.Generator) -> Scans:
    """Return the scans of diodes over which one light source of a level target is carried, translations (n, 3)."""
    count, diodes = len(translations), len(sensor.reading_names) // 2
    scans = empty_scans(stamps_of(count)).with_fields({"lit_sources": np.full((count, diodes), source)})
    light = {"diode_currents": np.full((count, diodes, 4), 2.5e-5)}
    chosen = Stack([sensor]).linearise(scans.with_fields(light))[1].chosen
    spots = np.empty(chosen.shape)
    level = np.tile(np.eye(3), (count, 1, 1))
    evaluate_all(sensor.pool.kinds, sensor.pool.rows, chosen, level, np.ascontiguousarray(translations), spots)
    return _lit(sensor, spots, scans, random)


def scans_of_spots(sensor: Diodes, diode: int, spots: FloatArray, random: np.random.Generator) -> Scans:
    """Return the scans of one diode under a light at positions of its own (n, 2) [m]; the others are in the dark."""
    count, diodes = len(spots), len(sensor.reading_names) // 2
    lit = np.full((count, diodes), NO_SOURCE, dtype=np.int64)
    lit[:, diode] = diode
    scans = empty_scans(stamps_of(count)).with_fields({"lit_sources": lit})
    every = np.full((count, 2 * diodes), np.nan)
    every[:, 2 * diode : 2 * diode + 2] = spots
    return _lit(sensor, every, scans, random)


def _lit(sensor: Diodes, spots: FloatArray, scans: Scans, random: np.random.Generator) -> Scans:
    """Return scans with the currents of spots (n, 2 diodes)."""
    scans = scans.with_fields(sensor.encode(spots, scans))
    return scans.with_fields(sensor.disturbed(scans, random))


def _at_home(stack: Stack, thetas: FloatArray) -> IntArray:
    counted = [sensor for sensor in stack.sensors if hasattr(sensor, "bumps")]
    if not counted:
        return np.zeros(len(thetas), dtype=np.int64)
    away = np.mod(thetas + np.pi, 2.0 * np.pi) - np.pi
    return np.asarray(np.abs(away) < HOME_MARK * 2.0 * np.pi / counted[0].bumps, dtype=np.int64)


def recorded(scans: Scans, track: Track | None) -> Recording:
    """Return what the converter gives of scans, and the reference, as a recording.

    A probe that has lost its target stands at the upper end, a diode that the light misses is dark.
    """
    fields, saturated = {}, np.zeros(len(scans), dtype=bool)
    for name, limits, instead in (
        ("gap_voltages", VOLTS, VOLTS[1]),
        ("ring_voltages", VOLTS, VOLTS[1]),
        ("diode_currents", AMPERES, DARK),
    ):
        values = getattr(scans, name)
        fields[name], ended = converted(np.where(np.isnan(values), instead, values), limits, BITS, steps=True)
        saturated |= ended
    tracks = {} if track is None else {REFERENCE: track}
    statuses = STATUS_SIMULATED | STATUS_SATURATED * saturated.astype(np.int64)
    return Recording(scans.with_fields(fields), tracks, "simulated", statuses=statuses)


def reference(values: FloatArray, sigmas: FloatArray) -> Track:
    """Return what an instrument said at the times of the scans, (n, k)."""
    return Track(stamps_of(len(values)), values, np.asarray(sigmas, dtype=float), f"simulated, topic {REFERENCE}")


def pose_reference(natives: FloatArray, along: float, about: float) -> Track:
    """Return what an instrument for poses said, native coordinates (n, 6); its standard uncertainties [m], [rad]."""
    quaternions = Rotation.from_matrix(rotations_of(natives)).as_quat()
    turned = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    signs = np.cumprod(np.concatenate([[1.0], np.where(turned, -1.0, 1.0)]))
    return reference(
        np.column_stack([natives[:, :3], quaternions * signs[:, None]]), np.array([along] * 3 + [0.5 * about] * 4)
    )
