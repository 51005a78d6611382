# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ambient light: what a dark scan removes from the readings of diodes.

Ambient light adds a current to each contact of a diode, which draws its spot towards the middle of the diode. In a dark
scan no light source is lit, so its diode currents are those of the ambient light. They are followed by a random walk:
with the variance P of the estimate, the drift d [A/s^.5], the time t since the last dark scan and the variance R of a
dark current,

    P := P + d^2 t,   K = P / (P + R),   dark := dark + K (I - dark),   P := (1 - K) P  (Kalman filter of a constant),

and anew from a dark current further than DARK_SIGMAS sqrt(P + R) away, as after a lamp was switched on. A scan t after
the last dark scan subtracts them with the variance s^2 = P + d^2 t, independent for each contact. For the ratio
``u = (A - C)/(A + C)`` follows ``2 (1 + u^2) s^2 / (A + C)^2`` (JCGM 100, 5.1.2), which counts as systematic, because
the scans between two dark scans share it. A lit scan before the first dark scan is LOST; one long after the last is
DEGRADED.

Light of the sources may be left in a dark scan, because an amplifier is slow. The share q of the light of the lit scan
before, with the sum S and the difference D of a pair of contacts, changes a ratio u of a later scan with the sum T by
``q (u S - D) / T``: the further the spot has moved, the more. The standard uncertainty of q that the calibration states
(``source_light``) makes this a part of the systematic covariance, common to all spots. Between two dark scans the
differences A - C and B - D of the dark currents then change as those of the light do. Where they do, with a share
beyond its uncertainty, lit scans are LOST until two dark scans differ less although the spots have moved. A lamp
changes all four contacts of a diode alike, and the differences hardly.

A dark scan has a pose too: that of the gap probes, and in the other directions the previous pose, moved on, with the
largest motion as spread. It is DEGRADED and does not enter the tracker; beyond the travel of the bearing it is LOST and
latches the joint. With sensors in plain Python it is LOST.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from posor.model.diode import BRIGHT, CODES, NOT_FINITE, VALID
from posor.model.scan import CONTACTS, DARK_SUBTRACTED, NO_SOURCE
from posor.numerics.compiled import in_place
from posor.numerics.stamps import NS
from posor.numerics.vector import square

if TYPE_CHECKING:
    from posor.estimation.workspace import Model

DARK_SIGMAS = 5.0  # standard deviations by which a dark current differs where the ambient light has changed
LIGHT_SIGMAS = 10.0  # root mean square of the differences by light that is left, in standard deviations of one
EXPLAINED_BY_LIGHT = 0.9  # share of the square of the differences that such light explains at least
SEEN_SHARE = 5e-3  # share of the light that two dark scans must be able to show before they show that none is left
NO_POSE, NO_DARK_SCAN, LIGHT_LEFT = -106, -107, -108
"""Codes of a dark scan without a previous pose or of a latched joint, and of lit scans before any dark scan and after
dark scans that hold light of the sources."""


@in_place
def is_dark(scan: Any) -> bool:
    """Return whether a scan is a dark scan."""
    dark = scan.lit_count > 0
    for i in range(scan.lit_count):
        dark = dark and scan.lit_sources[i] == NO_SOURCE
    return bool(dark)


@in_place
def check_dark_currents(model: Model, sensor: Any, scan: Any) -> int:
    """Return VALID, or the code of a diode whose currents are not finite or those of a lit source."""
    for i in range(sensor.count):
        least = model.diodes[sensor.first_channel + i].least_sum
        for axis in range(2):
            total = scan.diode_currents[CONTACTS * i + axis] + scan.diode_currents[CONTACTS * i + axis + 2]
            if not math.isfinite(total):
                return NOT_FINITE + CODES * i
            if total >= least:
                return BRIGHT + CODES * i
    return VALID


@in_place
def subtract_ambient(workspace: Any, scan: Any) -> float:
    """Write the currents without ambient light; return the standard uncertainty of what was subtracted [A].

    Zero: the scan needs no dark scan, or there was none. Whether it is missing or too old stands in the workspace.
    """
    settings, ambient = workspace.settings, workspace.tracker.ambient
    needed = settings.dark_age > 0.0 and scan.status & DARK_SUBTRACTED == 0
    known, age = needed and ambient.known == 1, max(0.0, float(scan.stamp_ns - ambient.stamp_ns) / NS)
    workspace.ambient_unknown = 1 if needed and (not known or ambient.light_left) else 0
    workspace.ambient_old = 1 if known and age > settings.dark_age else 0
    for k in range(scan.current_count):
        workspace.lit_currents[k] = scan.diode_currents[k] - (ambient.currents[k] if known else 0.0)
    return math.sqrt(ambient.variance + square(settings.dark_drift) * age) if known else 0.0


@in_place
def keep_light(workspace: Any, scan: Any) -> None:
    """Keep the light of a lit scan whose spots are valid, for the next dark scan."""
    for k in range(scan.current_count):
        workspace.tracker.ambient.light[k] = workspace.lit_currents[k]


@in_place
def write_ambient_effects(workspace: Any, r: int, diode: int, sigma: float) -> None:
    """Write what the ambient light does to readings r and r + 1, a spot whose ratios and slope are in the workspace."""
    spot, currents, left = workspace.spot, workspace.lit_currents, workspace.tracker.ambient.dark_light
    workspace.light_effects[r] = workspace.light_effects[r + 1] = 0.0
    for axis in range(2):
        k = CONTACTS * diode + axis
        total = currents[k] + currents[k + 2]
        of_ratio = sigma * math.sqrt(2.0 * (1.0 + square(spot.ratios[axis]))) / total
        for i in range(2):
            workspace.ambient_effects[r + i, axis] = spot.slope[i, axis] * of_ratio
        if sigma > 0.0 and workspace.settings.source_light > 0.0:
            of_light = spot.ratios[axis] * (left[k] + left[k + 2]) - (left[k] - left[k + 2])
            of_light *= workspace.settings.source_light / total
            for i in range(2):
                workspace.light_effects[r + i] += spot.slope[i, axis] * of_light


@in_place
def follow_ambient(workspace: Any, scan: Any) -> bool:
    """Update the currents of the ambient light by a dark scan; return whether they are new, not as they were."""
    settings, ambient = workspace.settings, workspace.tracker.ambient
    noise, elapsed = square(settings.dark_noise), float(scan.stamp_ns - ambient.stamp_ns) / NS
    variance = ambient.variance + square(settings.dark_drift) * max(elapsed, 0.0)
    anew = ambient.known == 0 or elapsed < 0.0
    for k in range(scan.current_count):
        off = abs(scan.diode_currents[k] - ambient.currents[k])
        anew = anew or off > DARK_SIGMAS * math.sqrt(variance + noise)
    if ambient.known:
        _find_source_light(workspace, scan, 2.0 * (variance + noise))
    gain = 1.0 if anew else variance / (variance + noise)
    for k in range(scan.current_count):
        ambient.currents[k] += gain * (scan.diode_currents[k] - ambient.currents[k])
        ambient.dark_light[k] += gain * (ambient.light[k] - ambient.dark_light[k])
    ambient.known, ambient.stamp_ns, ambient.variance = 1, scan.stamp_ns, gain * noise
    return anew


@in_place
def _find_source_light(workspace: Any, scan: Any, variance: float) -> None:
    """Note whether the currents of this dark scan differ from those before as the light of the sources does.

    ``variance``: of the change of the difference of two contacts [A^2].
    """
    ambient, count = workspace.tracker.ambient, 0
    dark_square = light_square = dot = 0.0
    for k in range(scan.current_count):
        if k % CONTACTS < 2:  # noqa: PLR2004  A and B; C and D are two further
            dark = scan.diode_currents[k] - ambient.currents[k] - scan.diode_currents[k + 2] + ambient.currents[k + 2]
            light = ambient.light[k] - ambient.dark_light[k] - ambient.light[k + 2] + ambient.dark_light[k + 2]
            dark_square += dark * dark
            light_square += light * light
            dot += dark * light
            count += 1
    if light_square == 0.0:
        return
    share, seen = dot / light_square, LIGHT_SIGMAS * math.sqrt(variance * count / light_square)
    threshold = max(seen, DARK_SIGMAS * workspace.settings.source_light)
    if abs(share) > threshold and dot * share > EXPLAINED_BY_LIGHT * dark_square:
        ambient.light_left = 1
    elif abs(share) <= threshold and seen <= SEEN_SHARE:
        ambient.light_left = 0


@in_place
def add_common_effects(workspace: Any) -> None:
    """Add the covariance from gain, ambient light and light that is left to ``systematic_readings``."""
    m, by_gain, by_ambient = workspace.reading_count, workspace.gain_effects, workspace.ambient_effects
    by_light = workspace.light_effects
    for r in range(m):
        for q in range(m):
            workspace.systematic_readings[r, q] += by_gain[r] * by_gain[q]
    if workspace.settings.source_light > 0.0:
        for r in range(m):
            for q in range(m):
                workspace.systematic_readings[r, q] += by_light[r] * by_light[q]
    for r in range(m):
        partner = workspace.spot_partners[r]
        for axis in range(2):
            workspace.systematic_readings[r, r] += square(by_ambient[r, axis])
            if partner != r:
                workspace.systematic_readings[r, partner] += by_ambient[r, axis] * by_ambient[partner, axis]
