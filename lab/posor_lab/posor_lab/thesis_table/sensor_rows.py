"""Rows of the thesis table for sensors and interferometers: chapters 3 and 4, sections 7.2, 7.4 and 7.5."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.uncertainty.air_index import ICE_POINT
from posor_design.calibration_geometry import axis_offsets, light_source_angles, probe_spacing
from posor_design.interferometry import air_effects
from posor_design.machine_metrology import abbe_error, probe_zero
from posor_design.sensor_noise import angle_resolution, converter_resolution, diode_noise
from scipy.constants import arcsec, inch
from scipy.optimize import brentq

from posor_lab.thesis_budgets.probe_tables import AT_POINT, factor
from posor_lab.thesis_data import URAD, data_path, read_table
from posor_lab.thesis_table.printed_units import INCH_OF_MERCURY, UIN
from posor_lab.thesis_table.sensor_plots import residual_plots, sensor_plots
from posor_lab.thesis_table.thesis_row import ThesisRow

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor.reporting.plot import Plot

PPM = 1e-6
PROBE_TRAVEL = 0.05 * inch
DIODE_TRAVEL = 0.625 * inch
LOWEST = ("1X", "low_order8")
"""Cell of table 7.7 that is not the lowest of its curves."""


def rows() -> list[ThesisRow]:
    """Return the rows of the sensors.

    Raises:
        PosorError: A table of the thesis cannot be read.

    """
    return [
        *_resolution_rows(),
        *_diode_rows(),
        *_interferometer_rows(),
        *_converter_rows(),
        *_spacing_rows(),
        *_axis_rows(),
        *_light_source_rows(),
        *_curve_rows(),
        *_probe_rows(),
    ]


def plots() -> list[Plot]:
    """Return the curves of fibre lever, capacitance probe, diode and air, and figures 7.18 to 7.20.

    Raises:
        PosorError: A table of the thesis cannot be read.

    """
    return [*sensor_plots(), *residual_plots()]


def _resolution_rows() -> list[ThesisRow]:
    """Return the resolutions of section 3.2: probes of 12 bits, the bumpy ring, the diodes."""
    bits_12 = converter_resolution(PROBE_TRAVEL, 1.0, 2.0**-12)
    probes = angle_resolution(bits_12.step, 5.0 * inch).step
    ring = angle_resolution(5.0 * UIN, 2.5 * inch).step
    diodes = angle_resolution(25.0 * UIN, 2.5 * inch).step
    return [
        ThesisRow(
            "3.2.1", "bits of an interferometer of 1 part per million", "bit", "20", math.log2(1.0 / PPM), "rounded"
        ),
        ThesisRow("3.2.2", "alpha, beta: probes of 12 bits over .05 in, 5 in apart", "urad", "2.4", probes / URAD),
        ThesisRow("3.2.2", "alpha, beta: the same in arcsec", "arcsec", ".5", probes / arcsec),
        ThesisRow("3.2.2", "theta: bumps at 45 degrees, probe of 5 uin, ring of 5 in", "urad", "2", ring / URAD),
        ThesisRow(
            "3.2.2",
            "theta: the same in arcsec",
            "arcsec",
            ".5",
            ring / arcsec,
            f"2 urad are {2.0 * URAD / arcsec:.2f} arcsec; .5 is the figure of the probes, 2.4 urad",
        ),
        ThesisRow("3.2.2", "theta: diodes of 25 uin, 2.5 in apart", "urad", "10", diodes / URAD),
    ]


def _diode_rows() -> list[ThesisRow]:
    """Return the noise of a diode (4.3) and the means of section 4.4."""
    noise = diode_noise(
        side=1.25 * inch,
        power=1e-3,
        responsivity=0.25,
        resistance=1000.0,
        amplifier_voltage_noise=10e-9,
        bandwidth=1.0 / 400e-6,
        temperature=300.0,
    )
    means = converter_resolution(PROBE_TRAVEL, 1.0, 2.0**-16, samples=400, sample_time=25e-6)
    return [
        ThesisRow("4.3", "diode: position noise, equation 4.3", "in/Hz^0.5", "5e-8", noise.position_noise / inch),
        ThesisRow("4.3", "diode: resolution with a light period of 400 us", "uin", "2.5", noise.resolution / UIN),
        ThesisRow("4.4", "time of 400 samples of 25 us", "ms", "10", means.time / 1e-3),
    ]


def _interferometer_rows() -> list[ThesisRow]:
    """Return what changes the length that an interferometer shows by 1 part per million (appendix 4A)."""
    found = air_effects(1.0, 0.1 * INCH_OF_MERCURY, 0.3, relative_humidity=0.3)
    printed = "1 part per million has one digit"

    def humidity_effect(celsius: float) -> float:
        return air_effects(0.0, 0.0, 0.3, temperature=ICE_POINT + celsius, relative_humidity=0.3).humidity_effect

    hot = brentq(lambda celsius: humidity_effect(celsius) + PPM, 20.0, 80.0)
    per_ppm = 0.3 * PPM / -found.humidity_effect
    humidity = (
        f"30 % change the index by 1 ppm in air of {hot:.0f} C only; at 20 C, 1 ppm needs {100.0 * per_ppm:.0f} %, "
        "more than there can be, and the 80 % of the HP 5528A user's guide give 1 ppm to one digit"
    )
    return [
        ThesisRow("App. 4A", "index of air, 1 C", "ppm", "1", abs(found.temperature_effect) / PPM, printed),
        ThesisRow("App. 4A", "index of air, .1 in of mercury", "ppm", "1", found.pressure_effect / PPM, printed),
        ThesisRow(
            "App. 4A", "index of air, 30 % relative humidity", "ppm", "1", abs(found.humidity_effect) / PPM, humidity
        ),
    ]


def _converter_rows() -> list[ThesisRow]:
    """Return the resolution of the converter of section 7.2: 65 uV on an input range of 1 V."""
    converter = partial(converter_resolution, input_range=1.0, accuracy=65e-6)
    diode, probe = converter(DIODE_TRAVEL), converter(PROBE_TRAVEL)
    return [
        ThesisRow("7.2", "converter: parts of 65 uV in 1 V", "1", "15385", diode.parts),
        ThesisRow("7.2", "converter: bits", "bit", "14", diode.bits),
        ThesisRow("7.2", "converter: resolution on a diode, .625 in", "uin", "41", diode.step / UIN),
        ThesisRow("7.2", "converter: resolution of a probe, .05 in", "uin", "3", probe.step / UIN),
    ]


def _spacing_rows() -> list[ThesisRow]:
    """Return the largest error of a distance by .001 in of the spacing of the probes (5.3.2), from the model."""
    largest = max(abs(factor(lever, AT_POINT)) for lever in ("sigma_a", "sigma_b"))
    return [
        ThesisRow("5.3.2", "distance at a diode, error by .001 in of a or b", "uin", "14", largest * 0.001 * inch / UIN)
    ]


def _axis_rows() -> list[ThesisRow]:
    """Return the uncertainty of the offsets of the diodes' axes (7.4.4)."""
    found = axis_offsets(
        distance=3.0 * inch,
        angle=math.radians(89.503239),
        angle_uncertainty=math.radians(0.029424),
        x_repeatability=12.0 * UIN,
        y_repeatability=35.0 * UIN,
    )
    assumed = "with the 3 in that the machine moves; the measured distance is not printed"
    return [
        ThesisRow("7.4.4", "sigma of the offset A along X", "in", ".001541", found.x_uncertainty / inch, assumed),
        ThesisRow("7.4.4", "sigma of the offset B along Y", "in", ".000037", found.y_uncertainty / inch, assumed),
    ]


def _light_source_rows() -> list[ThesisRow]:
    """Return the angles of the light sources, table 7.8."""
    table = []
    for row in read_table(data_path("light_sources.csv"), ["phi_rad", "psi_rad", "sigma_phi_rad", "sigma_psi_rad"]):
        azimuth, inclination = float(row["phi_rad"]), float(row["psi_rad"])
        sigmas = float(row["sigma_phi_rad"]), float(row["sigma_psi_rad"])
        found = light_source_angles(azimuth, inclination, *sigmas)
        name = f"table 7.8, light source {row['light_source']}"
        sigma = (
            f"equations 7.8 and 7.10 with the sigmas of the table; added up instead of root sum square: "
            f"{sigmas[1] * abs(math.cos(azimuth)) + _change_of_cosine(azimuth, inclination, sigmas[0]):.6f}"
        )
        at_source_2 = f"not legible in table 7.8, printed in table 7.9; {sigma}"
        table += [
            ThesisRow("7.4.5", f"{name}: alpha", "rad", row["alpha_Xl_rad"], found.alpha),
            ThesisRow(
                "7.4.5",
                f"{name}: beta",
                "rad",
                row["beta_Yl_printed_rad"],
                found.beta,
                f"the table repeats -psi, {-inclination}; equation 7.8 has -psi cos(phi)",
            ),
            ThesisRow("7.4.5", f"{name}: sigma of alpha", "rad", row["sigma_alpha_Xl_rad"], found.alpha_uncertainty),
            ThesisRow(
                "7.4.5",
                f"{name}: sigma of beta",
                "rad",
                row["sigma_beta_Yl_rad"],
                found.beta_uncertainty,
                sigma if row["light_source"] == "1" else at_source_2,
            ),
        ]
    return table


def _change_of_cosine(azimuth: float, inclination: float, change: float) -> float:
    """Return the change of beta by a change of the azimuth, equation 7.10."""
    return light_source_angles(azimuth, inclination, change).beta_uncertainty


def _curve_rows() -> list[ThesisRow]:
    """Return table 7.7: mean, highest and lowest deviation of fifteen curves, of tables 7.3 to 7.5."""
    residuals = read_table(data_path("linearization_residuals_tables_7_3_to_7_5.csv"), ["axis", "order9_uin"])
    printed = {
        row["quantity"]: row for row in read_table(data_path("error_budget_table_7_7_diode_fits.csv"), ["1X_uin"])
    }
    statistics: dict[str, Callable[[list[float]], Any]] = {"mean": np.mean, "high": max, "low": min}
    return [
        ThesisRow(
            "7.4.2",
            f"table 7.7: {name} deviation of the curves of order {order}, diode {axis}",
            "uin",
            printed[f"{name}_order{order}"][f"{axis}_uin"],
            float(statistic([float(row[f"order{order}_uin"]) for row in residuals if row["axis"] == axis])),
            "141 is the deviation of curve 5 in table 7.3, that of curve 2 is lower"
            if (axis, f"{name}_order{order}") == LOWEST
            else "",
        )
        for axis in ("1X", "1Y", "2X")
        for name, statistic in statistics.items()
        for order in (7, 8, 9)
    ]


def _probe_rows() -> list[ThesisRow]:
    """Return the calibration of the probes, section 7.5."""
    about = "the text says about; this is the slope of the polynomial of table 7.10 at 0 V"
    gains = [abs(probe_zero(each, -1e-3, 1e-3, 0.0, 1.0).motion) / 2e-3 for each in probe_polynomials()]
    tilt = 0.05 / 3.0
    spacing = probe_spacing(0.05 * inch, tilt, angle_error=100.0 * URAD, cross_angle=100.0 * URAD, span=3.0 * inch)
    machine_turn = 5.0 * URAD * 0.05  # over .05 in of travel, 5 urad for each inch
    linearity = "linearisation 5 uin and instability {} uin, as independent ones"
    return [
        *(
            ThesisRow("7.5.1", f"gain of probe {probe}", "in/V", ".05", gain / inch, about)
            for probe, gain in enumerate(gains, start=1)
        ),
        ThesisRow(
            "7.5.1",
            "Abbe error of the machine at 15 in",
            "uin",
            "3.8",
            abbe_error(15.0 * inch, machine_turn).error / UIN,
        ),
        ThesisRow("7.5.2", "error of a gap, axes 100 urad out of square", "uin", "5", spacing.gap_error / UIN),
        ThesisRow("7.5.2", "error of D21 by 100 urad in alpha", "in", ".0179", abs(spacing.spacing_error) / inch),
        *(
            ThesisRow(
                "7.5.4",
                f"random error of probe {probe}",
                "uin",
                total,
                math.hypot(5.0, instability),
                linearity.format(instability),
            )
            for probe, instability, total in ((1, 5, "7"), (2, 20, "21"), (3, 24, "25"))
        ),
    ]


def probe_polynomials() -> list[tuple[float, ...]]:
    """Return gap [m] over voltage [V] of each probe, constant first (table 7.10).

    Raises:
        DataFileError: The table cannot be read.

    """
    names = ("A0_in", "A1_in_per_V", "A2_in_per_V2", "A3_in_per_V3", "A4_in_per_V4")
    table = read_table(data_path("probe_linearization.csv"), names)
    return [tuple(inch * float(row[name]) for name in names) for row in table]
