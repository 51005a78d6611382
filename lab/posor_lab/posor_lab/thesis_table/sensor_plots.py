"""Figures of chapters 4 and 7: distance sensors, diode noise, air, and deviations of the diode curves."""

from __future__ import annotations

import math

import numpy as np
from posor.reporting.figure_style import BLUE, GREEN, ORANGE
from posor.reporting.plot import Plot
from posor.uncertainty.air_index import ICE_POINT
from posor_design.distance_sensors import capacitance_probe, fibre_lever
from posor_design.interferometry import air_effects
from posor_design.sensor_noise import diode_noise
from scipy.constants import inch

from posor_lab.thesis_data import data_path, read_table
from posor_lab.thesis_table.printed_units import INCH_OF_MERCURY, UIN

MM, UM = 1e-3, 1e-6
_COLOURS = (BLUE, ORANGE, GREEN)


def sensor_plots() -> list[Plot]:
    """Return the curves of chapter 4; dimensions that the thesis does not print are assumed, and named in the title."""
    return [_fibre_lever(), _capacitance_probe(), _diode_noise(), _humidity()]


def _fibre_lever() -> Plot:
    plot = Plot(
        "4.2.1: fibre optic lever of seven fibres (assumed: cores of 0.1 mm radius, axes 0.25 mm apart)",
        "distance [mm]",
        "received over transmitted power",
    )
    distances = np.linspace(0.0, 1.0 * MM, 101)
    for aperture, colour in zip((0.3, 0.4, 0.5), _COLOURS, strict=True):
        curve = [fibre_lever(float(z), 0.1 * MM, 0.25 * MM, math.asin(aperture)).collected for z in distances]
        plot.curve(f"numerical aperture {aperture}", distances / MM, curve, colour)
    return plot


def _capacitance_probe() -> Plot:
    plot = Plot("4.2.2: capacitance probe (assumed: radius 5 mm)", "gap [mm]", "capacitance [pF]")
    gaps = np.linspace(0.1 * MM, 0.05 * inch, 101)
    guarded = [capacitance_probe(float(gap), 5.0 * MM).capacitance for gap in gaps]
    near = gaps[gaps <= 1.0 * MM]
    free = [capacitance_probe(float(gap), 5.0 * MM, edge="free").capacitance for gap in near]
    plot.curve("with guard", gaps / MM, np.array(guarded) / 1e-12, BLUE)
    plot.curve("free disc", near / MM, np.array(free) / 1e-12, ORANGE, dash="dashed")
    return plot


def _diode_noise() -> Plot:
    plot = Plot("4.3: resolution of the diode over its light", "power [mW]", "resolution [uin]", x_log=True, y_log=True)
    powers = np.logspace(-5, -2, 61)
    for bandwidth, colour in zip((250.0, 2500.0, 25000.0), _COLOURS, strict=True):
        curve = [
            diode_noise(1.25 * inch, float(power), 0.25, 1000.0, 10e-9, bandwidth).resolution / UIN for power in powers
        ]
        plot.curve(f"{bandwidth:g} Hz", powers / 1e-3, curve, colour)
    return plot


def _humidity() -> Plot:
    plot = Plot("4A: change of the index of air", "temperature [C]", "change [ppm]")
    temperatures = np.linspace(10.0, 50.0, 41)
    changes = {
        "1 K": (1.0, 0.0, 0.0),
        "0.1 inHg": (0.0, 0.1 * INCH_OF_MERCURY, 0.0),
        "30 % relative humidity": (0.0, 0.0, 0.3),
    }
    for (name, change), colour in zip(changes.items(), _COLOURS, strict=True):
        effects = [
            air_effects(*change, temperature=ICE_POINT + float(celsius), relative_humidity=0.3).total
            for celsius in temperatures
        ]
        plot.curve(name, temperatures, np.abs(effects) / 1e-6, colour)
    plot.horizontal("printed: 1 ppm", 1.0)
    return plot


def residual_plots() -> list[Plot]:
    """Return figures 7.18 to 7.20: deviations of the diode curves of orders 7 to 9, from tables 7.3 to 7.5.

    Raises:
        DataFileError: The table cannot be read.

    """
    table = read_table(data_path("linearization_residuals_tables_7_3_to_7_5.csv"), ["axis", "position", "order9_uin"])
    plots = []
    for number, axis in enumerate(("1X", "1Y", "2X"), start=18):
        own = [row for row in table if row["axis"] == axis]
        plot = Plot(
            f"7.4.2, figure 7.{number}: deviations of the curves of diode {axis}", "curve", "standard deviation [uin]"
        )
        for order, colour in zip((7, 8, 9), _COLOURS, strict=True):
            deviations = [float(row[f"order{order}_uin"]) for row in own]
            plot.curve(f"order {order}", [float(row["position"]) for row in own], deviations, colour, marker="circle")
        plots.append(plot)
    return plots
