"""Types of the arguments and results of design calculators: a float with its SI unit, and limits of its value.

An annotation such as ``Annotated[Metre, POSITIVE, "Length of the beam."]`` states unit, limits and meaning. Limits of a
tuple hold for each of its numbers. Source of the units: BIPM, The International System of Units (2019).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True)
class Limit:
    """Limit of an argument: what it accepts, in words for errors, and whether it limits the count of a tuple."""

    accepts: Callable[[float], bool]
    expected: str
    of_count: bool = False


def at_least(count: int) -> Limit:
    """Return the limit of a tuple that has a number of values or more."""
    return Limit(lambda found: found >= count, f"at least {count}", of_count=True)


def more_than(low: float) -> Limit:
    """Return the limit of numbers that exceed ``low``."""
    return Limit(lambda value: value > low, f"more than {low:g}")


FINITE = Limit(math.isfinite, "a finite number")
"""Holds for all arguments."""
POSITIVE = more_than(0.0)
NON_NEGATIVE = Limit(lambda value: value >= 0.0, "0 or more")
NON_ZERO = Limit(lambda value: value != 0.0, "a number other than 0")
SMALL_ANGLE = Limit(lambda angle: abs(angle) <= 0.2, "at most 0.2 rad")  # noqa: PLR2004  a larger one is a wrong unit
ACUTE_ANGLE = Limit(lambda angle: 0.0 < angle < 0.5 * math.pi, "more than 0, less than a right angle")
SHARE = Limit(lambda share: 0.0 < share <= 1.0, "more than 0, at most 1")
PROPER_SHARE = Limit(lambda share: 0.0 <= share < 1.0, "0 to less than 1")
POISSON_RATIO = Limit(lambda ratio: 0.0 <= ratio <= 0.5, "0 to 0.5")  # noqa: PLR2004  0.5: incompressible


def unit_of(kind: Any) -> str:
    """Return the SI unit of a quantity or of the quantities of a tuple; ``1`` for everything without unit."""
    arguments = get_args(kind)
    if not arguments:
        return "1"
    return str(arguments[1]) if arguments[0] is float else unit_of(arguments[0])


Number = Annotated[float, "1"]
Metre = Annotated[float, "m"]
Radian = Annotated[float, "rad"]
Second = Annotated[float, "s"]
Hertz = Annotated[float, "Hz"]
RadianPerSecond = Annotated[float, "rad/s"]
MetrePerSecondSquared = Annotated[float, "m/s^2"]
Kilogram = Annotated[float, "kg"]
KilogramPerMetre = Annotated[float, "kg/m"]
KilogramPerCubicMetre = Annotated[float, "kg/m^3"]
KilogramSquareMetre = Annotated[float, "kg m^2"]
Newton = Annotated[float, "N"]
NewtonMetre = Annotated[float, "N m"]
NewtonPerMetre = Annotated[float, "N/m"]
NewtonMetrePerRadian = Annotated[float, "N m/rad"]
Pascal = Annotated[float, "Pa"]
PascalSecond = Annotated[float, "Pa s"]
MetreToTheFourth = Annotated[float, "m^4"]
SquareMetre = Annotated[float, "m^2"]
KilogramPerSecond = Annotated[float, "kg/s"]
Kelvin = Annotated[float, "K"]
PerKelvin = Annotated[float, "1/K"]
Volt = Annotated[float, "V"]
Ohm = Annotated[float, "Ohm"]
Farad = Annotated[float, "F"]
Watt = Annotated[float, "W"]
AmperePerWatt = Annotated[float, "A/W"]
AmperePerRootHertz = Annotated[float, "A/Hz^0.5"]
VoltPerRootHertz = Annotated[float, "V/Hz^0.5"]
MetrePerRootHertz = Annotated[float, "m/Hz^0.5"]
MetrePerVolt = Annotated[float, "m/V"]
PerMetre = Annotated[float, "1/m"]
FaradPerMetre = Annotated[float, "F/m"]

# Arguments that calculators of beams share.
MOST_MODES = 20
"""Largest number of modes; beam theory fails for higher ones, whose waves are shorter than usual sections are high."""
MODES = Limit(lambda modes: 1 <= modes <= MOST_MODES, f"1 to {MOST_MODES}")
_BOTH = Limit(lambda count: count in {0, 2}, "a value for each of the two gimbals", of_count=True)

Shape = Annotated[Literal["tube", "box"], "Section of the beam."]
Height = Annotated[
    Metre, POSITIVE, "Outer height of the section in the plane of bending; the outer diameter of a tube."
]
Wall = Annotated[Metre, POSITIVE, "Thickness of the walls."]
BoxWidth = Annotated[Metre, NON_NEGATIVE, "Outer width of a box."]
BeamLength = Annotated[Metre, POSITIVE, "Length of the beam."]
Modulus = Annotated[Pascal, POSITIVE, "Young's modulus."]
BeamDensity = Annotated[KilogramPerCubicMetre, POSITIVE, "Density of the beam."]
WeightDensity = Annotated[KilogramPerCubicMetre, NON_NEGATIVE, "Density; 0: the beam has no weight."]
PoissonRatio = Annotated[Number, POISSON_RATIO, "Poisson's ratio."]
GimbalPlaces = Annotated[
    tuple[Metre, Metre],
    NON_NEGATIVE,
    "Distances of the two gimbals from the start of the beam, the nearer first.",
]
PlateMasses = Annotated[tuple[Kilogram, Kilogram], NON_NEGATIVE, "Masses at start and end of the beam."]
GimbalStiffness = Annotated[
    tuple[NewtonPerMetre, ...], POSITIVE, _BOTH, "Stiffness of each gimbal against deflection; left out: rigid."
]
GimbalTurningStiffness = Annotated[
    tuple[NewtonMetrePerRadian, ...],
    POSITIVE,
    _BOTH,
    "Stiffness of each gimbal against turning; left out: the gimbals turn freely.",
]
