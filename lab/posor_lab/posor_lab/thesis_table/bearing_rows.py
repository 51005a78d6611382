"""Rows and plots of the thesis table for the stresses of ball bearings: 6.2.3.3 and appendix 6B (CONTACT.FOR)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.reporting.figure_style import BLUE, GREEN, ORANGE
from posor.reporting.plot import Plot
from posor_design.ball_bearings import ball_load, bearing_scaling
from posor_design.contact import ball_race_contact, hertz_contact
from scipy.constants import inch, lbf, psi

from posor_lab.thesis_table.printed_units import KSI
from posor_lab.thesis_table.thesis_row import ThesisRow

if TYPE_CHECKING:
    from posor_design.contact import Contact

BALL: dict[str, Any] = {"ball_diameter": 5.0 / 32.0 * inch, "pitch_diameter": 0.5 * (0.375 + 0.875) * inch}
"""Bearing of 3/8 in bore and 7/8 in outside diameter; the balls run halfway between them."""
BALL_LOAD = 2.2 * lbf
CONFORMITY = 0.515
"""Not printed (assumed): it fits the printed stress of steel, and is usual for ball bearings."""
STEEL = (30e6 * psi, 0.3)
BRASS = (15e6 * psi, 0.33)
DELRIN = (450.0 * KSI, 0.35)
"""Modulus of elasticity and Poisson's ratio; of these only the modulus of Delrin is printed, the others are usual."""


def rows() -> list[ThesisRow]:
    """Return the rows of 6.2.3.3 and of CONTACT.FOR."""
    return [*_contact_rows(), *_program_rows()]


def ball(material: tuple[float, float], race: tuple[float, float], conformity: float = CONFORMITY) -> Contact:
    """Return the contact of the yoke bearing's ball with its inner race."""
    return ball_race_contact(
        load=BALL_LOAD,
        **BALL,
        conformity=conformity,
        ball_modulus=material[0],
        ball_poisson_ratio=material[1],
        race_modulus=race[0],
        race_poisson_ratio=race[1],
    )


def _contact_rows() -> list[ThesisRow]:
    section = "6.2.3.3"
    load = ball_load(0.5 * 6.2 * lbf, 7)
    other = ball(STEEL, STEEL, 0.52).stress / KSI
    conformity = (
        "not independent: the conformity is not printed, and .515 is the one that fits this number "
        f"(.52 gives {other:.0f} ksi); the stresses of Delrin and brass follow from it"
    )
    return [
        ThesisRow(
            section,
            "load of a ball, 6.2 lbf on two bearings with seven balls",
            "lbf",
            "2.2",
            load.ball_load / lbf,
            "Stribeck's factor 5; two balls at the same distance from the direction of the load carry "
            f"{load.two_ball_load / lbf:.2f} lbf each",
        ),
        ThesisRow(
            section,
            "stress of the yoke bearing, steel",
            "ksi",
            "123",
            ball(STEEL, STEEL).stress / KSI,
            f"{conformity}; the print has 859 kPa for 848 MPa",
        ),
        ThesisRow(
            section,
            "stress, steel ball on races of Delrin",
            "ksi",
            "12",
            ball(STEEL, DELRIN).stress / KSI,
            "same conformity; the print has 8.4 GPa for 83 MPa",
        ),
        ThesisRow(
            section,
            "stress, ball and races of brass",
            "ksi",
            "78",
            ball(BRASS, BRASS).stress / KSI,
            "same conformity; 15e6 psi for brass (assumed)",
        ),
        ThesisRow(
            section,
            "stress of the Kaydon bearing under 36.8 lbf",
            "ksi",
            "154",
            bearing_scaling(36.8 * lbf, 683.0 * lbf, 400.0 * KSI).stress / KSI,
            "cube root of the ratio to 683 lbf at 400 ksi",
        ),
    ]


def _program_rows() -> list[ThesisRow]:
    """Return the fit of CONTACT.FOR to the large half axis, and its shear stress."""
    steel = ball(STEEL, STEEL)
    result = [
        ThesisRow(
            "App. 6B",
            f"coefficient of the large half axis at {degrees} deg, fit of CONTACT.FOR",
            "1",
            f"{np.polyval((1.155e-7, -3.466e-5, 0.004062, -0.2353, 6.9756), degrees):.3f}",
            _half_axis_coefficient(math.radians(degrees)),
            "printed: the polynomial of the listing at this angle",
        )
        for degrees in (30, 60, 90)
    ]
    shear = ThesisRow(
        "App. 6B",
        "greatest shear stress over compressive stress, yoke bearing",
        "1",
        ".3",
        steel.shear_stress / steel.stress,
        "the factor of CONTACT.FOR",
    )
    return [*result, shear]


def _half_axis_coefficient(angle: float) -> float:
    """Return the large half axis over the cube root of 3 P / (2 E* S).

    P: load, E*: contact modulus, S: sum of the curvatures; their difference is S times the cosine of the angle.
    """
    load, modulus, curvature_sum = BALL_LOAD, STEEL[0], 800.0
    x, y = (0.5 * curvature_sum * (1.0 + sign * math.cos(angle)) for sign in (1.0, -1.0))
    half_axis = hertz_contact(load, x, y, modulus, 0.0, modulus, 0.0).large_half_axis
    return half_axis / math.cbrt(3.0 * load / (modulus * curvature_sum))


def plots() -> list[Plot]:
    """Return the stress of a ball by the conformity of its race."""
    plot = Plot(
        "6.2.3.3: stress of a ball of 5/32 in under 2.2 lbf", "conformity of the inner race", "stress [ksi]", y_log=True
    )
    conformities = np.linspace(0.505, 0.58, 31)
    for name, materials, printed, colour, dash in (
        ("steel", (STEEL, STEEL), 123.0, BLUE, "solid"),
        ("brass", (BRASS, BRASS), 78.0, ORANGE, "dashed"),
        ("steel on Delrin", (STEEL, DELRIN), 12.0, GREEN, "dotted"),
    ):
        stresses = [ball(*materials, value).stress / KSI for value in conformities]
        plot.curve(name, conformities, stresses, colour, dash=dash)
        plot.curve(f"{name}, printed", [CONFORMITY], [printed], colour, dash=None, marker="circle")
    return [plot]
