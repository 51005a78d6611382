# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calibrations of typical POSORs with realistic uncertainties, for accuracy studies, budgets and simulation.

Sizes follow the thesis: ``design`` its 1985 design (probes at 1.5 and 3 in, table 5.2), ``sized_design`` the POSORs of
its conceptual robot (section 9.3.1; sensors of 5 microinch), given by their outside diameter. Everything else is
assumed, and the provenance says so.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from scipy.constants import inch

from posor.calibration.calibration_file import VERSION, Calibration, calibration_from
from posor.calibration.causes import DEFAULT_CAUSES
from posor.calibration.design_parts import (
    DiodeKind,
    Part,
    ProbeKind,
    RingShape,
    ambient_light,
    bumpy_ring,
    diodes,
    gap_probes,
    light_ring,
    quantity_entry,
    reference_voltage,
)
from posor.calibration.yaml_document import parse_yaml
from posor.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Sequence

DesignName = Literal[
    "triad_diodes", "triad_light_ring", "triad_bumpy_ring", "quad_diodes", "quad_light_ring", "quad_bumpy_ring"
]
SizedDesignName = Literal[
    "triad_light_ring",
    "triad_bumpy_ring",
    "quad_light_ring",
    "quad_bumpy_ring",
    "checked_light_ring",
    "checked_bumpy_ring",
]

THETA_OF_TWO_SOURCES = 0.1  # largest theta [rad] with two fixed sources on their diodes, at a runout of 1 mm
SOURCES = 36
BUMPS = 36
STANDOFF = 0.735e-3  # gap at which a probe along Z reads 0 V, the nominal distance of the plates [m]

PROBE_ACCURACY = 5e-6 * inch  # accuracy of the probes of section 9.3.1, 5 microinch [m]
SMALLEST_DIAMETER = 3.0 * inch  # smallest outside diameter of ``sized_design`` [m]
SOURCE_PITCH = 7.7e-3
"""Largest mean distance between light sources [m]. With a coded ring's growth of pitch, one is always on each diode."""
BUMPS_PER_INCH = 24
"""Bumps per inch of a sized ring's diameter (pitch 3.32 mm). The slopes then resolve theta nearly as section 9.3.1
assumes, 5 microinch over the ring's radius. The number of bumps is a multiple of four for whole inches."""

_RING_RANGE = 1.5
"""Range of the ring probes of sized designs over that of others: for bumps of 0.4 mm and motions of 0.5 mm."""

_PARTS: Any = parse_yaml(Path(__file__).with_name("design_parts.yaml").read_text("utf-8"), "design_parts.yaml")[1]
GAP_OF_VOLT: tuple[float, ...] = tuple(_PARTS["gap_of_volt"])
_PROBE = ProbeKind(**_PARTS["probe"])
_DIODE, _CODED_DIODE = DiodeKind(**_PARTS["diode"]), DiodeKind(**_PARTS["coded_diode"])
_RING = RingShape(**_PARTS["ring"])
SIZED_GAP_PROBE = ProbeKind(noise=PROBE_ACCURACY / 0.118e-3, **_PARTS["sized_gap_probe"])
SIZED_RING_PROBE = replace(
    SIZED_GAP_PROBE,
    volts_to_gap=tuple(_RING_RANGE * coefficient for coefficient in GAP_OF_VOLT),
    noise=PROBE_ACCURACY / (_RING_RANGE * 0.118e-3),
    tip_sigma=(30e-9, 30e-9, 5e-6),
    axis_sigma=2e-5,
)
SIZED_DIODE = DiodeKind(**_PARTS["sized_diode"])
SIZED_TILT_SIGMA = 0.3e-6


def _sized_ring(outside_diameter: float) -> RingShape:
    radius = 0.5 * outside_diameter - inch
    return RingShape(
        bumps=4 * max(1, round(BUMPS_PER_INCH * 2.0 * radius / inch / 4.0)),
        mean_radius=radius,
        cos=(-4e-6, 0.0, 4e-4, 5e-7, 1e-5),
        sin=(0.0, -5e-6, 0.0, -1e-5, 0.0),
        radius_sigma=20e-9,
        amplitude_sigma=20e-9,
        tip_radius=radius + _RING_RANGE * 0.8e-3,
    )


def velocity_limits(translation: float, lean: float = 0.02, theta: float = 3.0) -> Part:
    """Return the largest velocities of the target [m/s], [rad/s]."""
    return {
        "translation": quantity_entry(translation, "m/s"),
        "lean": quantity_entry(lean, "rad/s"),
        "theta": quantity_entry(theta, "rad/s"),
    }


def travel_limits(gap: float, half_range: float, lean: float) -> Part:
    """Return the travel of a bearing: ``half_range`` [m] about the nominal ``gap`` [m]; largest lean [rad]."""
    return {"gap": quantity_entry([gap - half_range, gap + half_range], "m"), "lean": quantity_entry(lean, "rad")}


def assumed_motion(translation: float) -> Part:
    """Return the largest velocities and accelerations of a design; ``translation``: velocity [m/s]."""
    acceleration = {
        "translation": quantity_entry(0.1, "m/s^2"),
        "lean": quantity_entry(0.5, "rad/s^2"),
        "theta": quantity_entry(30.0, "rad/s^2"),
    }
    return {**velocity_limits(translation), "acceleration": acceleration}


def environment_ranges(supply_spread: float) -> Part:
    """Return ranges of supply and temperature; ``supply_spread``: uncertainty of a supply not measured [V]."""
    return {
        "supply": {"range": quantity_entry([14.5, 15.5], "V"), "spread": quantity_entry(supply_spread, "V")},
        "temperature": {"range": quantity_entry([283.15, 303.15], "K"), "spread": quantity_entry(0.1, "K")},
    }


SHOWN_BY_FIVE_RING_PROBES = ("growth of ring", "supply channel")
"""Default causes of kind ``always`` that the residuals of five ring probes show at their bounds."""


def _shown_causes() -> list[Part]:
    """Return these causes as faults: the test would reject scans of a joint in which one of them was always there."""
    shown = "a fault, since residuals show one that is always there"
    causes = [cause for cause in DEFAULT_CAUSES if cause.name in SHOWN_BY_FIVE_RING_PROBES]
    changed = [each.model_copy(update={"kind": "fault", "source": f"{each.source}; {shown}"}) for each in causes]
    return [each.model_dump(exclude_defaults=True) for each in changed]


CONVERTER_BITS, LIGHT_RING_BITS = 16, 24
"""The noise of light spots on a ring is below a step of 16 bits; frozen diodes would look like a joint at rest."""


def converter_steps(bits: int) -> Part:
    """Return the steps of a converter over the ranges of the readings."""
    return {"voltage": quantity_entry(14.0 / 2**bits, "V"), "current": quantity_entry(1.5e-4 / 2**bits, "A")}


def design_calibration(
    name: str,
    source: str,
    notes: tuple[str, ...],
    frames: tuple[str, str],
    motion: Part | None,
    environment: Part,
    converter: Part | None,
    sensors: list[Part],
    causes: Sequence[Part] = (),
) -> Calibration:
    """Return the calibration of a design; the arguments are the parts of its file."""
    content: dict[str, Any] = {
        "format": "posor_calibration",
        "version": VERSION,
        "name": name,
        "provenance": {"source": source, "method": "posor/calibration/designs.py", "date": "none", "notes": notes},
        "frames": {"parent": frames[0], "child": frames[1]},
        "motion": motion,
        "environment": environment,
        "converter": converter,
        "sensors": sensors,
        "causes": list(causes),
    }
    return calibration_from(content)


def _with_fourth_probe(name: str) -> bool:
    return name.startswith(("quad_", "checked_"))


def design(
    name: DesignName,
    *,
    ring_probes: int = 4,
    motion: bool = False,
    converter: bool = False,
    frames: tuple[str, str] = ("receiving", "target"),
) -> Calibration:
    """Return the calibration of one of the designs of the 1985 size; a light ring is coded (``coded_azimuths``).

    ``name``: which stack: ``triad_`` with the three gap probes of the thesis; ``quad_``, recommended, with a fourth one
    opposite to the first, so that the gap probes check one another. ``ring_probes``: number of probes of a bumpy ring,
    three or more. ``motion``: whether to limit the velocity of the target: 1 mm/s, 0.02 rad/s of lean, 3 rad/s of
    theta. ``converter``: whether to state the steps of the converter, so that repeated readings are a fault.
    ``frames``: names of receiving and target plate.
    """
    tips = [[-0.0762, 0.0, 0.0], [0.0, 0.0381, 0.0], [0.0, -0.0381, 0.0]]
    if _with_fourth_probe(name):
        tips.append([0.0762, 0.0, 0.0])
    sensors = [gap_probes(_PROBE, tips, 20e-6)]
    if name.endswith("_light_ring"):
        sensors.append(light_ring(_CODED_DIODE, 0.044, SOURCES))
    elif name.endswith("_diodes"):
        positions = [(-0.0254, 0.0381), (-0.0254, -0.0381)]
        sensors.append(diodes(_DIODE, positions, positions))
    else:
        sensors.append(bumpy_ring(_PROBE, _RING, ring_probes))
    limits, environment = assumed_motion(1e-3) if motion else None, environment_ranges(_PROBE.supply_sigma)
    steps = converter_steps(CONVERTER_BITS) if converter else None
    return design_calibration(name, "assumed design", (), frames, limits, environment, steps, sensors)


def sized_design(name: SizedDesignName, outside_diameter: float, *, frames: tuple[str, str], title: str) -> Calibration:
    """Return the calibration of a POSOR of an outside diameter D.

    Gap probes on a circle of D - 1 in: ``triad_``, the three of section 9.3.1 in an equilateral triangle, whose
    altitude .75 (D - 1 in) is the lever of that section; ``quad_``, four in a square. A bumpy ring with four probes, or
    a ring of light sources with two diodes, of D - 2 in. ``checked_``, recommended: as ``quad_`` with five ring probes
    or three diodes, dark scans and a reference voltage, so that the readings show more causes of wrong poses. Limits of
    velocity: 20 mm/s, 0.02 rad/s of lean, 3 rad/s of theta.

    ``name``: which stack. ``outside_diameter``: [m]. ``frames``: names of receiving and target plate. ``title``: the
    calibration's name. Raises CalibrationError: the diameter is too small.
    """
    if not outside_diameter >= SMALLEST_DIAMETER:
        what = f"outside diameter {outside_diameter:g} m"
        raise CalibrationError(what, where=title, expected=f"at least {SMALLEST_DIAMETER:g} m")
    circle = 0.5 * (outside_diameter - inch)
    half_side = circle * math.sqrt(0.75)
    tips = [[-circle, 0.0, 0.0], [0.5 * circle, half_side, 0.0], [0.5 * circle, -half_side, 0.0]]
    bits = LIGHT_RING_BITS if name.endswith("_light_ring") else CONVERTER_BITS
    notes = [
        "thesis 9.3.1: probes of 5 microinch on a circle of the outside diameter less 1 in, ring of it less 2 in",
        "assumed: all calibrated as assembled, hence the small uncertainties; the 5 microinch taken for noise",
        "assumed: linearisation and range of the probes, tilt of the target plane, limits of motion",
        f"assumed: converters of {bits} bits, ranges of supply and temperature",
    ]
    if _with_fourth_probe(name):
        tips = [[-circle, 0.0, 0.0], [0.0, circle, 0.0], [circle, 0.0, 0.0], [0.0, -circle, 0.0]]
        notes.append("assumed: a fourth gap probe, so that the others check each of them")
    checked, causes = name.startswith("checked_"), list[Part]()
    sensors = [gap_probes(SIZED_GAP_PROBE, tips, SIZED_TILT_SIGMA)]
    if checked:
        sensors[0]["reference"] = reference_voltage()
        notes.append("assumed: a reference of 5 V that the converter of the probes reads in each scan")
    if name.endswith("_light_ring"):
        radius, number = 0.5 * outside_diameter - inch, "three" if checked else "two"
        sources = 4 * math.ceil(2.0 * math.pi * radius / SOURCE_PITCH / 4.0)
        sensors.append(light_ring(SIZED_DIODE, radius, sources, 3 if checked else 2))
        notes.append(
            f"assumed: light sources 7.7 mm apart on average, {number} diodes of 5.5 mm half width, their noise"
        )
        notes.append("assumed: the pitch of the sources grows around the ring, so that two lit ones tell which")
        if checked:
            sensors[1]["ambient"] = ambient_light()
            notes.append("assumed: ambient light removed by dark scans, its drift 1 nA in a second")
    else:
        causes = _shown_causes() if checked else []
        sensors.append(bumpy_ring(SIZED_RING_PROBE, _sized_ring(outside_diameter), 5 if checked else 4))
        notes.append("assumed: bumps of 0.4 mm every 3.32 mm, ring probes of 1.5 times the range of the others")
    source = f"assumed design of {outside_diameter / inch:g} in outside diameter"
    environment = environment_ranges(SIZED_GAP_PROBE.supply_sigma)
    return design_calibration(
        title, source, tuple(notes), frames, assumed_motion(0.02), environment, converter_steps(bits), sensors, causes
    )
