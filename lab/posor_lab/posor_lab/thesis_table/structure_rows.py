"""Rows and plots of the thesis table for robot structures: sections 1.3, 1.4, 2.4, 9.4 and appendix 1A."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.reporting.figure_style import BLUE, GREEN, ORANGE
from posor.reporting.plot import Plot
from posor_design.error_chain import endpoint_error, position_bits, straight_linkage
from posor_design.inertial_sensors import inertial_limits
from posor_design.quantity_text import parse_quantity
from posor_design.structures import (
    cantilever_beam,
    cantilever_for_stiffness,
    cantilever_for_stress,
    cantilever_frequencies,
)
from scipy.constants import arcsec, foot, g, inch, lb, lbf, minute, psi

from posor_lab.thesis_table.joint_load_rows import ALUMINIUM_MODULUS, DESIGN_STRESS, joint_load_rows
from posor_lab.thesis_table.thesis_row import ThesisRow

if TYPE_CHECKING:
    from posor_design.structures import CantileverFrequencies

POUND_PER_FOOT = lb / foot
ALUMINIUM: dict[str, Any] = {"modulus": ALUMINIUM_MODULUS, "density": 0.1 * lb / inch**3}
"""The density is a usual value (assumed)."""
STEEL: dict[str, Any] = {"modulus": 29e6 * psi, "density": 0.283 * lb / inch**3}
"""Usual values (assumed)."""
ARM: dict[str, Any] = {"length": 10.0 * foot, "tip_force": 300.0 * lbf, "modulus": ALUMINIUM["modulus"]}
"""Appendix 1A; the weight of the beam is not part of its load there."""
STRESS_BOX: dict[str, Any] = {"height": 7.0 * inch, "width": 4.0 * inch}
STIFF_BOX: dict[str, Any] = {"height": 20.0 * inch, "width": 8.0 * inch}
STRESS_WALL, STIFF_WALL = 3.0 / 16.0 * inch, 5.0 / 16.0 * inch
LINK_WEIGHT, DEVICE_WEIGHT = 6.625 * lbf, 2.0 * lbf
"""Of each link and of the angular measuring device, 2.4."""
PAYLOADS = np.linspace(0.0, 300.0, 61)
"""Of the plot [lb]."""


def rows() -> list[ThesisRow]:
    """Return the rows of 1.3, 1.4, 2.4, 9.4 and appendix 1A."""
    return [
        *_accuracy_rows(),
        *_inertial_rows(),
        *_stress_rows(),
        *_stiffness_rows(),
        *_linkage_rows(),
        *joint_load_rows(),
    ]


def plots() -> list[Plot]:
    """Return figure 1A.1: first frequencies of both beams over the payload, and their ratio."""
    frequencies = Plot("Figure 1A.1: first mode of the two beams", "payload [lb]", "frequency [Hz]")
    ratio = Plot("Figure 1A.1: ratio of the first modes", "payload [lb]", "stress over deflection [1]")
    stress, stiff = (np.array([beam(payload).frequencies[0] for payload in PAYLOADS]) for beam in (_light, _heavy))
    frequencies.curve("designed for stress", PAYLOADS, stress, BLUE)
    frequencies.curve("designed for deflection", PAYLOADS, stiff, ORANGE, dash="dashed")
    ratio.curve("ratio", PAYLOADS, stress / stiff, GREEN)
    return [frequencies, ratio]


def _accuracy_rows() -> list[ThesisRow]:
    error = endpoint_error((30.0 * inch, 30.0 * inch), (15.0 * arcsec, 15.0 * arcsec))
    bits = position_bits(60.0 * inch, 0.001 * inch).bits
    return [
        ThesisRow("1.3", "bits for .001 in over 60 in", "bit", "16", bits),
        ThesisRow(
            "1.3",
            "equation 1.1: backlash 10 arcsec, encoder 5 arcsec, two arms of 30 in",
            "in",
            ".0065",
            error.worst_case / inch,
        ),
    ]


def _inertial_rows() -> list[ThesisRow]:
    limits = inertial_limits(0.001 * inch, 100.0 * inch, 30.0 * minute)
    parts = position_bits(100.0 * inch, 0.001 * inch).parts
    navigation, precise = (parse_quantity(text, "rad/s", "gyroscope") for text in (".008 deg/h", ".0003 deg/h"))
    return [
        ThesisRow("1.4", "drift of a gyroscope, 30 min, 100 in", "rad/s", "5.6e-9", limits.drift_rate),
        ThesisRow("1.4", "navigation gyroscope of .008 deg/h", "rad/s", "3.9e-8", navigation),
        ThesisRow("1.4", "precise gyroscope of .0003 deg/h", "rad/s", "1.5e-9", precise),
        *(
            ThesisRow(
                "1.4",
                f"orders of magnitude from the allowed drift to {rate:g} rad/s, {name}",
                "1",
                printed,
                math.log10(rate / limits.drift_rate),
            )
            for name, rate, printed in (("fibre gyroscope", 9.7e-7, "2"), ("ring laser", 4.8e-6, "3"))
        ),
        ThesisRow(
            "1.4", "equation 1.3: smallest acceleration, 30 min", "in/s^2", "6.2e-10", limits.acceleration / inch
        ),
        ThesisRow(
            "1.4",
            "accelerometer of 6e-6 times gravity",
            "in/s^2",
            ".0023",
            6e-6 * g / inch,
        ),
        ThesisRow("1.4", "required accuracy, parts of 100 in", "1", "100000", parts),
    ]


def _stress_rows() -> list[ThesisRow]:
    beam = cantilever_beam(**ARM, **STRESS_BOX, wall=STRESS_WALL)
    sized = cantilever_for_stress(**ARM, **STRESS_BOX, stress=DESIGN_STRESS)
    mass = cantilever_beam(**ARM, **STRESS_BOX, wall=STRESS_WALL, density=ALUMINIUM["density"]).mass_per_length
    rounded = f"5000 psi need {sized.wall / inch:.4f} in, and the thesis takes the next common wall, 3/16 in"
    return [
        ThesisRow("App. 1A", "box 7 x 4 x 3/16 in: second moment of area", "in^4", "26", beam.second_moment / inch**4),
        ThesisRow("App. 1A", "box 7 x 4 x 3/16 in: stress at 300 lb", "psi", "5000", beam.stress / psi, rounded),
        ThesisRow("App. 1A", "box 7 x 4 in: wall for 5000 psi", "in", ".1875", sized.wall / inch, rounded),
        ThesisRow(
            "App. 1A",
            "box 7 x 4 x 3/16 in: weight",
            "lb/ft",
            "",
            mass / POUND_PER_FOOT,
            "the line with the weight is lost in the scan",
        ),
    ]


def _stiffness_rows() -> list[ThesisRow]:
    sized = cantilever_for_stiffness(**ARM, **STIFF_BOX, deflection=0.020 * inch)
    beam = cantilever_beam(**ARM, **STIFF_BOX, wall=STIFF_WALL)
    weighing = cantilever_beam(**ARM, **STIFF_BOX, wall=STIFF_WALL, density=ALUMINIUM["density"])
    metric = cantilever_beam(**ARM, **STIFF_BOX, wall=STIFF_WALL, density=2700.0).mass_per_length
    light = cantilever_beam(**ARM, **STRESS_BOX, wall=STRESS_WALL, density=ALUMINIUM["density"])
    ends = [each.mass_per_length * ARM["length"] + 300.0 * lb for each in (light, weighing)]
    proportional = math.sqrt(light.second_moment / weighing.second_moment * ends[1] / ends[0])
    free, loaded = (_light(load).frequencies[0] / _heavy(load).frequencies[0] for load in (0.0, 300.0))
    return [
        ThesisRow(
            "App. 1A", "box 20 x 8 x 5/16 in: second moment of area", "in^4", "864", beam.second_moment / inch**4
        ),
        ThesisRow(
            "App. 1A",
            "box 20 x 8 x 5/16 in: deflection by 300 lb",
            "in",
            ".020",
            beam.deflection / inch,
            f"the weight of the beam, left out in the text, makes it {weighing.deflection / inch:.4f} in",
        ),
        ThesisRow("App. 1A", "box 20 x 8 in: wall for .020 in", "in", ".3125", sized.wall / inch),
        ThesisRow(
            "App. 1A",
            "box 20 x 8 x 5/16 in: weight",
            "lb/ft",
            "20",
            weighing.mass_per_length / POUND_PER_FOOT,
            f"approximate in the text, with .1 lb/in^3 here; 2700 kg/m^3 make it {metric / POUND_PER_FOOT:.2f} lb/ft, "
            f"and {metric:.1f} kg/m against the printed 29.8",
        ),
        ThesisRow(
            "App. 1A",
            "first mode of the stress design over that of the deflection design, 300 lb",
            "1",
            ".3",
            loaded,
            f"figure 1A.1, which the text quotes, is lost; without payload the ratio is {free:.3f}; equation 1.1A, "
            f"which takes the whole mass of the beam to its end, gives {proportional:.3f} at 300 lb",
        ),
    ]


def _light(payload: float) -> CantileverFrequencies:
    """Return the frequencies of the beam designed for stress, with a payload [lb]."""
    return _box_frequencies(payload, STRESS_BOX, STRESS_WALL)


def _heavy(payload: float) -> CantileverFrequencies:
    """Return the frequencies of the beam designed for deflection, with a payload [lb]."""
    return _box_frequencies(payload, STIFF_BOX, STIFF_WALL)


def _box_frequencies(payload: float, box: dict[str, Any], wall: float) -> CantileverFrequencies:
    values: dict[str, Any] = {**box, **ALUMINIUM}
    return cantilever_frequencies(**values, length=ARM["length"], wall=wall, tip_mass=payload * lb, modes=1)


def _linkage_rows() -> list[ThesisRow]:
    tube: dict[str, Any] = {"shape": "tube", "height": 2.0 * inch, "wall": 0.125 * inch, "length": 30.0 * inch}
    link, dense = (
        cantilever_beam(**tube, tip_force=0.0, modulus=STEEL["modulus"], density=density).mass_per_length * 30.0 * inch
        for density in (STEEL["density"], 0.3 * lb / inch**3)
    )
    links: dict[str, Any] = {
        "link_length": 30.0 * inch,
        "area": link / STEEL["density"] / (30.0 * inch),
        "modulus": STEEL["modulus"],
    }
    printed = straight_linkage(**links, joint_force=LINK_WEIGHT + 0.5 * DEVICE_WEIGHT)
    balanced = straight_linkage(**links, joint_force=0.5 * (LINK_WEIGHT + DEVICE_WEIGHT))
    force = (
        "not independent: the printed tension requires that each link carries its whole weight and half of the device "
        "at the joint; by moments about its support it carries half of its weight: "
        f"{balanced.tension / lbf:.0f} lb, {balanced.stretch / inch:.4f} in"
    )
    gap = endpoint_error((100.0 * inch,), (0.0001 / 4.0,)).worst_case / inch
    return [
        ThesisRow(
            "2.4",
            "weight of a link, steel tube 2 / 1.75 in, 30 in long",
            "lb",
            "6.625",
            link / lb,
            f"with .283 lb/in^3; .3 lb/in^3 make it {dense / lb:.3f} lb",
        ),
        ThesisRow("2.4", "tension of two straight links", "lb", "862", printed.tension / lbf, force),
        ThesisRow("2.4", "stretch of each link", "in", ".0012", printed.stretch / inch, force),
        ThesisRow("2.4", "gap of .0001 in in a slide of 4 in, over 100 in", "in", ".0025", gap),
    ]
