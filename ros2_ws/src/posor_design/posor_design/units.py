"""Types of the arguments and results of design calculators: a float with its SI unit.

The command ``posor design`` reads the units from these types. Source: BIPM, The International System of Units (2019).
"""

from __future__ import annotations

from typing import Annotated

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
