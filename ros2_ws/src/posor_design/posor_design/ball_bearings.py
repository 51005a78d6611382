# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ball bearings: load of the balls, stress and life by the rated load, and friction from breakaway tests."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from typing import Annotated

from posor_design.calculators import POSITIVE, at_least, calculator, more_than


@dataclass(frozen=True)
class BallLoad:
    """Load of the ball that carries most."""

    ball_load: Annotated[float, "N", "Load of this ball in a bearing with clearance."]
    tight_ball_load: Annotated[float, "N", "Load of this ball in a bearing without clearance."]
    two_ball_load: Annotated[float, "N", "Load of each ball, if two balls beside the load's direction carry all of it."]


@calculator
def ball_load(
    radial_load: Annotated[float, "N", POSITIVE, "Radial load of the bearing."],
    balls: Annotated[int, more_than(4), "Number of balls, at least 5."],
) -> BallLoad:
    """Load of the most loaded ball of a radial ball bearing.

    Source: Harris, Rolling Bearing Analysis (2001), 7.4 (Stribeck's factors 5 and 4.37).
    """
    return BallLoad(
        ball_load=5.0 * radial_load / balls,
        tight_ball_load=4.37 * radial_load / balls,
        two_ball_load=0.5 * radial_load / math.cos(math.pi / balls),
    )


@dataclass(frozen=True)
class BearingScaling:
    """Stress and life of a ball bearing under a load."""

    stress: Annotated[float, "Pa", "Greatest compressive stress."]
    relative_life: Annotated[
        float,
        "1",
        "Life over the life under the rated load; with the dynamic rating of ISO 281 as rated load, the life that 90 % "
        "reach in millions of revolutions.",
    ]


@calculator
def bearing_scaling(
    load: Annotated[float, "N", POSITIVE, "Equivalent load, of the same kind as the rated one."],
    rated_load: Annotated[float, "N", POSITIVE, "Rated load."],
    rated_stress: Annotated[float, "Pa", POSITIVE, "Greatest compressive stress under the rated load."],
) -> BearingScaling:
    """Stress and life of a ball bearing from those under its rated load.

    The stress of a point contact grows with the cube root of the load, and the life falls with its cube.

    Source: thesis 6.2.3.3 (stress); ISO 281 (2007), 5.3 (life).
    """
    ratio = load / rated_load
    return BearingScaling(stress=rated_stress * math.cbrt(ratio), relative_life=ratio**-3)


@dataclass(frozen=True)
class BearingFriction:
    """Friction of bearings, from breakaway tests."""

    friction_radius: Annotated[float, "m", "Mean of the coefficient of friction times radius of the bearing."]
    standard_deviation: Annotated[float, "m", "Standard deviation of one test."]
    standard_uncertainty: Annotated[float, "m", "Standard deviation of the mean."]
    largest_share: Annotated[float, "1", "Largest result over the allowed value."]


@calculator
def bearing_friction(
    deflections: Annotated[tuple[float, ...], "m", POSITIVE, at_least(2), "Deflection of the spring at breakaways."],
    spring_length: Annotated[float, "m", POSITIVE, "Length of the spring from the axis to the stage."],
    spring_width: Annotated[float, "m", POSITIVE, "Width of the spring along the axis."],
    spring_thickness: Annotated[float, "m", POSITIVE, "Thickness of the spring."],
    modulus: Annotated[float, "Pa", POSITIVE, "Modulus of elasticity of the spring."],
    thrust: Annotated[float, "N", POSITIVE, "Axial load of the bearing."],
    allowed_friction_radius: Annotated[float, "m", POSITIVE, "Allowed value, such as that of ``yoke-friction``."],
) -> BearingFriction:
    """Coefficient of friction times radius of loaded bearings, from the deflections at which they break away.

    A leaf spring in radial direction is fixed to the inner race at the axis of the bearing. A stage deflects its end
    until the race turns.

    Source: thesis equation 7.1 and table 7.2; standard uncertainty: JCGM 100 (2008), 4.2.
    """
    inertia = spring_width * spring_thickness**3 / 12.0
    scale = 3.0 * modulus * inertia / (spring_length**2 * thrust)
    results = [scale * deflection for deflection in deflections]
    deviation = statistics.stdev(results)
    return BearingFriction(
        friction_radius=statistics.fmean(results),
        standard_deviation=deviation,
        standard_uncertainty=deviation / math.sqrt(len(results)),
        largest_share=max(results) / allowed_friction_radius,
    )
