"""Ball bearings: load of the balls, stress and life by the rated load, and friction from breakaway tests."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from typing import TYPE_CHECKING

from posor.errors import ParameterError

from posor_design.checks import require_positive

if TYPE_CHECKING:
    from posor_design.units import Metre, Newton, Number, Pascal


@dataclass(frozen=True)
class BearingScaling:
    """Stress and life of a ball bearing under a load.

    Attributes:
        stress: Greatest compressive stress.
        relative_life: Life over the life under the rated load; with the dynamic rating of ISO 281 as rated load, the
            life that 90 % reach in millions of revolutions.

    """

    stress: Pascal
    relative_life: Number


def bearing_scaling(load: Newton, rated_load: Newton, rated_stress: Pascal) -> BearingScaling:
    """Stress and life of a ball bearing from those under its rated load.

    The stress of a point contact grows with the cube root of the load, and the life falls with its cube.

    Args:
        load: Equivalent load, of the same kind as the rated one.
        rated_load: Rated load.
        rated_stress: Greatest compressive stress under the rated load.

    Raises:
        ParameterError: An argument is not finite or not positive.

    Source: thesis 6.2.3.3 (stress); ISO 281 (2007), 5.3 (life).

    Example:
        posor design bearing-scaling --load '36.8 lbf' --rated-load '683 lbf' --rated-stress '400 ksi'

    """
    require_positive(load=load, rated_load=rated_load, rated_stress=rated_stress)
    ratio = load / rated_load
    return BearingScaling(stress=rated_stress * math.cbrt(ratio), relative_life=ratio**-3)


@dataclass(frozen=True)
class BallLoad:
    """Load of the ball that carries most.

    Attributes:
        ball_load: Load of this ball in a bearing with clearance.
        tight_ball_load: Load of this ball in a bearing without clearance.
        two_ball_load: Load of each ball, if two balls on both sides of the load's direction carry all of it.

    """

    ball_load: Newton
    tight_ball_load: Newton
    two_ball_load: Newton


def ball_load(radial_load: Newton, balls: int) -> BallLoad:
    """Load of the most loaded ball of a radial ball bearing.

    Args:
        radial_load: Radial load of the bearing.
        balls: Number of balls, at least 5.

    Raises:
        ParameterError: The load is not finite or not positive, or there are fewer than 5 balls.

    Source: Harris, Rolling Bearing Analysis (2001), 7.4 (Stribeck's factors 5 and 4.37).

    Example:
        posor design ball-load --radial-load '3.1 lbf' --balls 7

    """
    require_positive(radial_load=radial_load)
    fewest = 5
    if balls < fewest:
        raise ParameterError(f"{balls} balls", where="balls", expected=f"at least {fewest}")
    return BallLoad(
        ball_load=5.0 * radial_load / balls,
        tight_ball_load=4.37 * radial_load / balls,
        two_ball_load=0.5 * radial_load / math.cos(math.pi / balls),
    )


@dataclass(frozen=True)
class BearingFriction:
    """Friction of bearings, from breakaway tests.

    Attributes:
        friction_radius: Mean of the coefficient of friction times radius of the bearing.
        standard_deviation: Standard deviation of one test.
        standard_uncertainty: Standard deviation of the mean.
        largest_share: Largest result over the allowed value.

    """

    friction_radius: Metre
    standard_deviation: Metre
    standard_uncertainty: Metre
    largest_share: Number


def bearing_friction(
    deflections: tuple[Metre, ...],
    spring_length: Metre,
    spring_width: Metre,
    spring_thickness: Metre,
    modulus: Pascal,
    thrust: Newton,
    allowed_friction_radius: Metre,
) -> BearingFriction:
    """Coefficient of friction times radius of loaded bearings, from the deflections at which they break away.

    A leaf spring in radial direction is fixed to the inner race at the axis of the bearing. A stage deflects its end
    until the race turns.

    Args:
        deflections: Deflection of the end of the spring at each breakaway, at least two.
        spring_length: Length of the spring from the axis to the stage.
        spring_width: Width of the spring along the axis.
        spring_thickness: Thickness of the spring.
        modulus: Modulus of elasticity of the spring.
        thrust: Axial load of the bearing.
        allowed_friction_radius: Allowed value, such as that of ``yoke-friction``.

    Raises:
        ParameterError: An argument is not finite or not positive, or there are fewer than two deflections.

    Source: thesis equation 7.1 and table 7.2; standard uncertainty: JCGM 100 (2008), 4.2.

    Example:
        posor design bearing-friction --deflections '.021, .024, .019, .022 in' --spring-length '2 in'
        --spring-width '.5 in' --spring-thickness '.01 in' --modulus '30e6 psi' --thrust '20 lbf'
        --allowed-friction-radius '.0082 in'

    """
    require_positive(spring_length=spring_length, spring_width=spring_width, spring_thickness=spring_thickness)
    require_positive(modulus=modulus, thrust=thrust, allowed_friction_radius=allowed_friction_radius)
    require_positive(**{f"deflections[{index}]": value for index, value in enumerate(deflections)})
    fewest = 2
    if len(deflections) < fewest:
        raise ParameterError(f"{len(deflections)} deflections", where="deflections", expected=f"at least {fewest}")
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
