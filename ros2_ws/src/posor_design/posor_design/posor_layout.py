# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""A layout of a POSOR: where its sensors are and what they are, and the calibration that it would have.

The uncertainties of the parts are those of ``calibration.designs.sized_design``: calibrated as assembled. Those that
are a share of a sensor's range change with the range.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from posor.calibration.design_parts import (
    CHORD_MIDDLE,
    TARGET_TILT,
    DiodeKind,
    ProbeKind,
    RingShape,
    ambient_light,
    bumpy_ring,
    coded_places,
    diodes,
    gap_probes,
    light_ring,
    reference_voltage,
)
from posor.calibration.designs import (
    GAP_OF_VOLT,
    SIZED_DIODE,
    SIZED_GAP_PROBE,
    SIZED_RING_PROBE,
    SIZED_TILT_SIGMA,
    STANDOFF,
    converter_steps,
    design_calibration,
    environment_ranges,
    travel_limits,
    velocity_limits,
)

if TYPE_CHECKING:
    from posor.calibration.calibration_file import Calibration

    from posor_design.requirement import Requirement

ThetaSensor = Literal["diodes", "light_ring", "bumpy_ring"]
REFERENCE_RATE = 1e3
"""Scan rate [Hz] at which a layout of noise 1 has the noise of the sized designs: 1 / 11 000 of a probe's range."""
BITS = (16, 18, 20, 24)
VOLTAGE_SPAN, CURRENT_SPAN, MIDDLE_CURRENT = 14.0, 1.5e-4, 8.5e-5
"""Ranges of the converter [V], [A], and the current sum of a diode in the middle of its range [A]."""
DIODE_SLOPE = 6.0 / 5.5  # slope of a diode's map over the half width of its calibrated surface
BUMP_SLOPE = 0.4 / 3.32  # amplitude of the bumps over their pitch, as that of the sized designs
NOMINAL_RANGE = 0.6e-3
"""Motion to either side that the probes of ``designs`` (range 1) measure from their middle [m], with a reserve."""
SPEED_RESERVE = 1.5
"""Limits of velocity of the calibration over the required speed, and over what the motion of the range has with it."""
TRAVEL_RESERVE = 1.5
"""Travel of the calibration over the required range, whose leans about X and Y may come together."""
_LEAST_LIMITS = (0.02, 0.02)  # of translation [m/s] and lean [rad/s]
_STEP_NOISE = math.sqrt(1.0 / 12.0)  # standard deviation of the rounding error of a converter, in its steps


@dataclass(frozen=True)
class PosorLayout:
    """Positions and kinds of the sensors."""

    # what measures theta and the two runouts: fixed light sources with diodes, a coded ring of light sources with
    # diodes, or a bumpy ring with probes
    theta_sensor: ThetaSensor
    theta_probes: int  # number of diodes, or of probes of the bumpy ring
    gap_azimuths: tuple[float, ...]  # azimuths of the gap probes [rad]
    outside_diameter: float  # that the layout needs [m]
    probe_circle: float  # radius of the circle of the gap probes [m]
    probe_range: float  # range of the gap probes over that of the probes of ``designs``
    ring_radius: float  # of diodes and light sources, or mean radius of the bumpy ring [m]
    ring_size: float  # half width of a diode's calibrated surface, or pitch of the bumps [m]
    ring_range: float  # range of the ring probes over that of the gap probes of ``designs``; without meaning for diodes
    marks: int  # number of light sources, or of bumps
    noise: float  # noise of the electronics over the reference at the same scan rate

    @property
    def gap(self) -> float:
        """Gap in the middle of the range of the probes [m]."""
        return self.probe_range * STANDOFF

    @property
    def diode_azimuths(self) -> tuple[float, ...]:
        """Azimuths of the diodes [rad]; of a bumpy ring: none."""
        return () if self.theta_sensor == "bumpy_ring" else coded_places(self.theta_probes)

    def scan_noise(self, rate: float) -> float:
        """Return the noise of one scan over that of the sized designs; white noise in half the rate [Hz]."""
        return self.noise * math.sqrt(rate / REFERENCE_RATE)

    def bits(self, rate: float) -> int:
        """Return the fewest bits of a converter whose steps do not exceed the noise of a scan.

        With larger steps, readings at rest repeat and look like frozen electronics (``estimation.frozen``).
        """
        noise = self.scan_noise(rate)
        volts = SIZED_GAP_PROBE.noise * noise / VOLTAGE_SPAN
        amperes = 0.5 * MIDDLE_CURRENT * SIZED_DIODE.noise * noise / CURRENT_SPAN
        least = volts if self.theta_sensor == "bumpy_ring" else min(volts, amperes)
        return next((bits for bits in BITS if 2.0**-bits <= least), BITS[-1])

    def calibration(self, requirement: Requirement, frames: tuple[str, str] = ("receiving", "target")) -> Calibration:
        """Return the calibration of this layout at the scan rate of a requirement."""
        rate = requirement.scan_rate.number
        bits = self.bits(rate)
        tips = [
            [self.probe_circle * math.cos(azimuth), self.probe_circle * math.sin(azimuth), 0.0]
            for azimuth in self.gap_azimuths
        ]
        ring = self._bumpy_ring(rate, bits) if self.theta_sensor == "bumpy_ring" else self._diodes(rate, bits)
        tilt = requirement.target_tilt.number / math.hypot(*TARGET_TILT)
        probes = self._probe(SIZED_GAP_PROBE, self.probe_range, rate, bits)
        gaps = gap_probes(probes, tips, SIZED_TILT_SIGMA, (tilt * TARGET_TILT[0], tilt * TARGET_TILT[1]))
        gaps["reference"] = reference_voltage()
        if self.theta_sensor != "bumpy_ring":
            ring["ambient"] = ambient_light()
        return design_calibration(
            requirement.name,
            f"designed for the requirement '{requirement.name}'",
            (
                "assumed: uncertainties of the parts, calibrated as assembled, as those of sized_design",
                "assumed: linearisation of the probes, ranges of supply and temperature",
                "assumed: a reference of 5 V that the converter reads, dark scans of diodes",
                f"noise of one scan at {rate:g} Hz, {self.noise:g} times the reference; converters of {bits} bits",
            ),
            frames,
            _motion(requirement, self.gap),
            environment_ranges(SIZED_GAP_PROBE.supply_sigma),
            converter_steps(bits),
            [gaps, ring],
        )

    def _probe(self, kind: ProbeKind, scale: float, rate: float, bits: int) -> ProbeKind:
        """Return a kind of probe with another range; its noise is a share of the range."""
        offset, *slopes = kind.volts_to_gap_sigmas
        noise = SIZED_GAP_PROBE.noise * self.scan_noise(rate)
        return replace(
            kind,
            volts_to_gap=tuple(scale * coefficient for coefficient in GAP_OF_VOLT),
            volts_to_gap_sigmas=(offset, *(scale * slope for slope in slopes)),
            noise=math.hypot(noise, _STEP_NOISE * VOLTAGE_SPAN / 2**bits),
        )

    def _bumpy_ring(self, rate: float, bits: int) -> dict[str, object]:
        amplitude = BUMP_SLOPE * self.ring_size
        shape = RingShape(
            bumps=self.marks,
            mean_radius=self.ring_radius,
            cos=(-4e-6, 0.0, amplitude, 1.25e-3 * amplitude, 0.025 * amplitude),
            sin=(0.0, -5e-6, 0.0, -0.025 * amplitude, 0.0),
            radius_sigma=20e-9,
            amplitude_sigma=20e-9,
            tip_radius=self.ring_radius + self.ring_range * STANDOFF,
        )
        return bumpy_ring(self._probe(SIZED_RING_PROBE, self.ring_range, rate, bits), shape, self.theta_probes)

    def _diodes(self, rate: float, bits: int) -> dict[str, object]:
        step = math.sqrt(2.0) * CURRENT_SPAN / 2**bits / MIDDLE_CURRENT
        reference = SIZED_DIODE
        size = DIODE_SLOPE * self.ring_size / reference.scale
        kind: DiodeKind = replace(
            reference,
            noise=math.hypot(reference.noise * self.scan_noise(rate), _STEP_NOISE * step),
            map_sigma=reference.map_sigma * size,
            scale=reference.scale * size,
        )
        if self.theta_sensor == "light_ring":
            return light_ring(kind, self.ring_radius, self.marks, count=self.theta_probes)
        places = [
            (self.ring_radius * math.cos(azimuth), self.ring_radius * math.sin(azimuth))
            for azimuth in self.diode_azimuths
        ]
        return diodes(kind, places, places)


def _motion(requirement: Requirement, gap: float) -> dict[str, object]:
    """Return the limits of velocity and the travel about ``gap`` [m]; no travel where gap or tilt must be zero.

    Error motions of once a turn over the whole range have a velocity of twice its half width.
    """
    limits, speed = requirement.range, SPEED_RESERVE * requirement.speed.number
    shift, tilt = max(limits.runout.number, limits.gap.number), limits.tilt.number
    least_translation, least_lean = _LEAST_LIMITS
    out = velocity_limits(max(least_translation, 2.0 * shift * speed), max(least_lean, 2.0 * tilt * speed), speed)
    half_range, lean = TRAVEL_RESERVE * limits.gap.number, TRAVEL_RESERVE * tilt
    return {**out, "travel": travel_limits(gap, half_range, lean)} if half_range > 0.0 and lean > 0.0 else out


def gap_azimuths(count: int, obstacles: tuple[float, ...]) -> tuple[float, ...]:
    """Return evenly spaced azimuths [rad] of gap probes, as far from those of the diodes as possible."""
    pitch = 2.0 * math.pi / count

    def clearance(offset: float) -> float:
        return min(
            (abs(math.remainder(offset + k * pitch - each, 2.0 * math.pi)) for k in range(count) for each in obstacles),
            default=0.0,
        )

    offsets = [CHORD_MIDDLE + pitch * step / 12.0 for step in range(12)]
    best = max(offsets, key=lambda offset: round(clearance(offset), 9))
    return tuple(best + k * pitch for k in range(count))
