# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Contact stress of curved bodies, and of the balls of a bearing, by Hertz theory."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from posor.errors import ParameterError
from scipy.optimize import brentq, minimize_scalar
from scipy.special import ellipe, ellipk, elliprd, elliprf

from posor_design.calculators import POISSON_RATIO, POSITIVE, calculator, more_than

_FLATTEST = 1e-5  # smallest ratio of the half axes that is solved
_DEEPEST = 2.0
"""Depth over the small half axis above which the greatest shear stress lies: at most 0.79, or at the surface."""


@dataclass(frozen=True)
class Contact:
    """Contact of two elastic bodies."""

    large_half_axis: Annotated[float, "m", "Large half axis of the contact ellipse."]
    small_half_axis: Annotated[float, "m", "Small half axis of the contact ellipse."]
    stress: Annotated[float, "Pa", "Greatest compressive stress, at the centre of the ellipse."]
    shear_stress: Annotated[float, "Pa", "Greatest shear stress at and under this centre, in the first body."]
    shear_depth: Annotated[float, "m", "Depth of the greatest shear stress."]
    approach: Annotated[float, "m", "Approach of the two bodies."]


@calculator
def hertz_contact(
    load: Annotated[float, "N", POSITIVE, "Force between the bodies."],
    curvature_x: Annotated[float, "1/m", POSITIVE, "Sum of both bodies' curvatures, first principal direction."],
    curvature_y: Annotated[float, "1/m", POSITIVE, "Sum of both bodies' curvatures, second principal direction."],
    modulus: Annotated[float, "Pa", POSITIVE, "Modulus of elasticity of the first body."],
    poisson_ratio: Annotated[float, "1", POISSON_RATIO, "Poisson's ratio of the first body, 0 to 0.5."],
    other_modulus: Annotated[float, "Pa", POSITIVE, "Modulus of elasticity of the second body."],
    other_poisson_ratio: Annotated[float, "1", POISSON_RATIO, "Poisson's ratio of the second body, 0 to 0.5."],
) -> Contact:
    """Stress, size and approach of the contact of two elastic bodies.

    The contact is an ellipse without friction, small beside the radii. A curvature is the inverse of a radius; that of
    a hollow surface is negative. The sums of the curvatures of both bodies in the two principal directions are enough.

    Source: Johnson, Contact Mechanics (1985), 4.2; Boresi and Schmidt, Advanced Mechanics of Materials (2003), 17.4;
        thesis 6.2.3.3 and appendix 6B (CONTACT.FOR, after Timoshenko).
    """
    contact_modulus = 1.0 / ((1.0 - poisson_ratio**2) / modulus + (1.0 - other_poisson_ratio**2) / other_modulus)
    k = _axis_ratio(curvature_x, curvature_y)
    first_kind, second_kind = float(ellipk(1.0 - k**2)), float(ellipe(1.0 - k**2))
    curvature = curvature_x + curvature_y
    large = math.cbrt(3.0 * load * second_kind / (math.pi * k**2 * contact_modulus * curvature))
    stress = 1.5 * load / (math.pi * k * large**2)
    interior = minimize_scalar(
        lambda depth: -_shear_stress(depth, k, poisson_ratio), bounds=(0.0, _DEEPEST), options={"xatol": 1e-9}
    )
    depth = max(0.0, float(interior.x), key=lambda depth: _shear_stress(depth, k, poisson_ratio))
    return Contact(
        large_half_axis=large,
        small_half_axis=k * large,
        stress=stress,
        shear_stress=_shear_stress(depth, k, poisson_ratio) * stress,
        shear_depth=depth * k * large,
        approach=1.5 * load * first_kind / (math.pi * contact_modulus * large),
    )


def _axis_ratio(curvature_x: float, curvature_y: float) -> float:
    """Return the small half axis over the large one."""
    target = max(curvature_x, curvature_y) / min(curvature_x, curvature_y)

    def excess(k: float) -> float:
        return _curvature_ratio(k) - target

    if excess(_FLATTEST) < 0.0:
        what = f"the ratio of the curvatures is {target:.3g}: the contact is a line"
        expected = f"a ratio of at most {_curvature_ratio(_FLATTEST):.3g}"
        raise ParameterError(what, where="curvature_x, curvature_y", expected=expected)
    return 1.0 if excess(1.0) >= 0.0 else float(brentq(excess, _FLATTEST, 1.0, xtol=1e-15, rtol=1e-14))


def _curvature_ratio(k: float) -> float:
    """Return the ratio of the curvatures that belongs to a ratio of the half axes; Carlson's forms hold at k = 1."""
    along = elliprd(0.0, 1.0, k**2) / 3.0
    across = elliprd(0.0, k**2, 1.0) / 3.0
    return float(along / across)


def _shear_stress(depth: float, k: float, poisson_ratio: float) -> float:
    """Return the greatest shear stress on the normal through the centre, over the greatest compressive stress.

    Carlson's forms of the elliptic integrals hold for a circle (k = 1) too.

    ``depth``: depth over the small half axis. ``k``: small half axis over the large one. ``poisson_ratio``: Poisson's
    ratio of the body.
    """
    t = k * depth
    sine, cosine = 1.0 / math.hypot(1.0, t), t / math.hypot(1.0, t)
    root_squared = (k**2 + t**2) * sine**2
    root = math.sqrt(root_squared)
    sine_integral = sine**3 * float(elliprd(cosine**2, root_squared, 1.0)) / 3.0
    cosine_integral = sine * float(elliprf(cosine**2, root_squared, 1.0)) - sine_integral
    q = sine**2 / (1.0 + root)
    across = (q - 1.0 + t * cosine_integral) / k**2
    along_x = -0.5 * q + t * sine_integral + poisson_ratio * across
    along_y = across + 0.5 * q / root + poisson_ratio * (t * sine_integral - q)
    stresses = (2.0 * k * along_x, 2.0 * k * along_y, -k * sine**2 / root)
    return 0.5 * (max(stresses) - min(stresses))


@calculator
def ball_race_contact(
    load: Annotated[float, "N", POSITIVE, "Force of the ball."],
    ball_diameter: Annotated[float, "m", POSITIVE, "Diameter of the ball."],
    pitch_diameter: Annotated[float, "m", POSITIVE, "Diameter of the circle through the centres of the balls."],
    conformity: Annotated[float, "1", more_than(0.5), "Radius of the groove over diameter of the ball, more than 0.5."],
    ball_modulus: Annotated[float, "Pa", POSITIVE, "Modulus of elasticity of the ball."],
    ball_poisson_ratio: Annotated[float, "1", POISSON_RATIO, "Poisson's ratio of the ball."],
    race_modulus: Annotated[float, "Pa", POSITIVE, "Modulus of elasticity of the race."],
    race_poisson_ratio: Annotated[float, "1", POISSON_RATIO, "Poisson's ratio of the race."],
    race: Annotated[Literal["inner", "outer"], "Race that the ball touches."] = "inner",
) -> Contact:
    """Contact of a ball with the groove of a radial ball bearing.

    Source: thesis 6.2.3.3 and appendix 6B (CONTACT.FOR); curvatures: Harris, Rolling Bearing Analysis (2001), 2.6.
    """
    if pitch_diameter <= ball_diameter:
        expected = f"more than the diameter of the ball, {ball_diameter:g} m"
        raise ParameterError(f"{pitch_diameter:g} m", where="pitch_diameter", expected=expected)
    side = 1.0 if race == "inner" else -1.0
    return hertz_contact(
        load,
        2.0 / ball_diameter + side * 2.0 / (pitch_diameter - side * ball_diameter),
        2.0 / ball_diameter - 1.0 / (conformity * ball_diameter),
        ball_modulus,
        ball_poisson_ratio,
        race_modulus,
        race_poisson_ratio,
    )
