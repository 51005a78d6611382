"""Rows of the thesis table for stages, machines and setups: sections 7.2, 7.4, 8.2 and 8.3."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.calibration.calibration_file import load_calibration
from posor.uncertainty.interferometer import ZERO, AirQuantities, Input, Interferometer, correct_reading
from posor_bringup.installed import calibration_path
from posor_calibration.map_basis import doubled_grid_errors
from posor_design.machine_metrology import (
    abbe_error,
    alignment,
    probe_zero,
    straightness_runs,
    thermal_growth,
)
from posor_design.sensor_noise import angle_resolution, converter_resolution
from scipy.constants import arcsec, inch

from posor_lab.thesis_budgets.probe_tables import ALPHA, BUDGET_COLUMNS, table_7_12
from posor_lab.thesis_data import URAD, data_path, read_table
from posor_lab.thesis_table.printed_units import UIN
from posor_lab.thesis_table.sensor_rows import probe_polynomials
from posor_lab.thesis_table.stage_plots import FINISH, GAIN, START, TRAVEL, stage_plots
from posor_lab.thesis_table.thesis_row import ThesisRow

if TYPE_CHECKING:
    from posor.reporting.plot import Plot
    from posor_design.machine_metrology import StraightnessRuns

CAST_IRON = 6.0e-6 * 1.8
"""Thermal expansion [1/K]: 6.0e-6 for each degree Fahrenheit, Machinery's Handbook. The thesis does not print it."""
TEMPERATURE_CHANGE = 0.1 / 1.8
""".1 degree Fahrenheit [K]."""
GAUGE_ERROR = 0.001 * inch
"""Error of a gap that is set by gauge blocks [m], section 8.3.1."""
DIODE_LENGTH = 0.5 * inch
"""Length over which fifteen curves map a diode, section 7.4.2."""


def rows() -> list[ThesisRow]:
    """Return the rows of stages and setups.

    Raises:
        PosorError: A table of the thesis or a file of the rig cannot be read.

    """
    return [
        *_environment_rows(),
        *_straightness_rows(),
        *_alignment_rows(),
        *_abbe_rows(),
        *_reading_rows(),
        *_target_plane_rows(),
        *_zero_rows(),
        _interpolation_row(),
        *_computer_rows(),
    ]


def plots() -> list[Plot]:
    """Return the straightness runs of table 7.1 (figure 7.3), and the error by the zero of a probe.

    Raises:
        DataFileError: A table of the thesis cannot be read.

    """
    return stage_plots()


def _environment_rows() -> list[ThesisRow]:
    lengths = ((0.5, ".3", "impedance probes"), (2.0, "1.2", "diodes, Y"), (10.0, "6.0", "diodes, X"))
    expansion = "with 10.8 ppm/K for cast iron, which is not printed"
    growths = [
        ThesisRow(
            "7.2",
            f"thermal growth over {length:g} in, .1 F: {name}",
            "uin",
            printed,
            thermal_growth(length * inch, CAST_IRON, TEMPERATURE_CHANGE).growth / UIN,
            expansion,
        )
        for length, printed, name in lengths
    ]
    laser_block = thermal_growth(5.0 * inch, 7e-6 * 1.8, 0.15 / 1.8).growth
    aluminium = thermal_growth(5.0 * inch, 23e-6, 0.15 / 1.8).growth
    return [
        *growths,
        ThesisRow(
            "7.4.1",
            "growth of the laser block over 5 in, .15 F, 7 uin/in/F",
            "uin",
            "5.3",
            laser_block / UIN,
            f"the block is of aluminium, whose 23 ppm/K give {aluminium / UIN:.1f} uin; 5.3 uin are .13 um, not 1.4 um",
        ),
        ThesisRow("7.2", "interferometer, .9997300 to .9997350 over 1 in", "uin", "5", _compensation(0.9997350) / UIN),
        ThesisRow("7.2", "interferometer, .9997300 to .9997310 over 1 in", "uin", "1", _compensation(0.9997310) / UIN),
    ]


def _compensation(factor: float) -> float:
    """Return the change of a length of 1 in [m] if the compensation factor changes to this one from .9997300."""
    air = AirQuantities(Input(293.15), Input(101325.0), Input(0.5), Input(450e-6))
    lengths = [
        correct_reading(Interferometer(Input(632.99e-9), 1.0 / each, air, 0.0, dead_path=ZERO), inch).displacement
        for each in (0.9997300, factor)
    ]
    return abs(lengths[1] - lengths[0])


def _runs() -> StraightnessRuns:
    table = read_table(data_path("straightness_table_7_1.csv"), ["b_in", "m", "deviation_in"])
    return straightness_runs(
        tuple(inch * float(row["b_in"]) for row in table),
        tuple(float(row["m"]) for row in table),
        tuple(inch * float(row["deviation_in"]) for row in table),
        TRAVEL,
    )


def _straightness_rows() -> list[ThesisRow]:
    runs = _runs()
    repeatability = (
        "the text gives the order of size; of the runs only their lines are printed, and these lie apart by this much "
        f"over .75 in; the deviations scatter by {runs.deviation_scatter / UIN:.0f} uin"
    )
    return [
        ThesisRow("7.2", "stage: mean deviation from a line, table 7.1", "in", ".000408", runs.mean_deviation / inch),
        ThesisRow("7.2", "stage: repeatability of the straightness", "in", ".001", runs.spread / inch, repeatability),
    ]


def _alignment_rows() -> list[ThesisRow]:
    setup = alignment((0.001, 0.002, 0.005), 0.625 * inch)
    square = alignment((0.002, 0.002), 0.625 * inch)
    one = alignment((0.002,), inch)
    twice = "exact is 1 - cos(.002), 2 uin/in; 4 uin/in is the square of the angle, twice as much"
    orthogonality = (
        "not independent: two axes of .002 fit this number; the scan has .0002 for the first, which gives .0020"
    )
    return [
        ThesisRow("7.2", "cosine error of .002 in/in", "uin/in", "4", one.cosine_error / UIN, twice),
        ThesisRow("7.4", "angle between diode and interferometer", "rad", ".0055", setup.angle),
        ThesisRow("7.4", "cosine error of this angle over .625 in", "uin", "9", setup.cosine_error / UIN),
        ThesisRow("7.4", "orthogonality of the axes of the diodes", "rad", ".0028", square.angle, orthogonality),
    ]


def _abbe_rows() -> list[ThesisRow]:
    yaw = abbe_error(2.0 * inch, 25.0 * URAD).error
    exact = abbe_error(2.0 * inch, 5.0 * arcsec).error
    pitch = abbe_error(2.0 * inch, 2.0 * arcsec).error
    return [
        ThesisRow(
            "7.4.2",
            "Abbe error at 2 in, yaw of 25 urad",
            "uin",
            "50",
            yaw / UIN,
            f"25 urad is rounded: the 5 arcsec of section 7.2 give {exact / UIN:.1f} uin",
        ),
        ThesisRow(
            "7.4.3",
            "Abbe error of the stage",
            "uin",
            "20",
            pitch / UIN,
            "the text gives the order of size; assumed: 2 in of section 7.4.2 and 2 arcsec of section 7.2",
        ),
    ]


def _reading_rows() -> list[ThesisRow]:
    """Return what the readings of the machining centre are worth, at the line 31.5 in from the gimbal (8.2)."""
    readout = angle_resolution(0.0002 * inch, 31.5 * inch).step
    length = 0.3 * inch * angle_resolution(0.010 * inch, 31.5 * inch).step
    return [
        ThesisRow("8.2", "beta, theta: accuracy by .0002 in of the machining centre", "urad", "6", readout / URAD),
        ThesisRow("8.2", "error over .3 in by .010 in of the length", "in", ".0001", length / inch),
    ]


def _target_plane_rows() -> list[ThesisRow]:
    """Return the inclination of the target plane (8.3.1), from the constants of the listings in inch."""
    sensor: Any = load_calibration(calibration_path("section84")).sensors[0]
    about_x, about_z = sorted(np.abs(sensor.target_plane.tilt.array))
    source = "from the constants .133333 and .083333 in of the listings, over the distances of the probes"
    return [
        ThesisRow("8.3.1", "target plane, angle about X", "deg", "2.55", math.degrees(about_x), source),
        ThesisRow("8.3.1", "target plane, angle about Z", "deg", "3.18", math.degrees(about_z), source),
    ]


def _zero_rows() -> list[ThesisRow]:
    """Return the errors that a wrong zero of a probe causes in a motion (8.3.1)."""
    gauge = [probe_zero(each, START, FINISH, GAUGE_ERROR, GAIN) for each in probe_polynomials()]
    computed = [probe_zero(each, START, FINISH, 0.001 * GAIN, GAIN) for each in probe_polynomials()]
    end = START + 0.002 * inch / GAIN
    small = [abs(probe_zero(each, START, end, GAUGE_ERROR, GAIN).motion_error) / UIN for each in probe_polynomials()]
    each_small = ", ".join(f"{error:.1f}" for error in small)
    supply = [
        table_7_12().cell(f"increasing: voltage supply sigma_l{probe}", _column(ALPHA)).computed for probe in (2, 3)
    ]
    table = [
        ThesisRow("8.3.1", "zero error of gauge blocks", "V", ".02", gauge[0].zero_error),
        ThesisRow(
            "8.3.1",
            "error over .002 in of motion by this zero error, largest of the probes",
            "uin",
            "10",
            max(small),
            f"the text gives the order of size; the probes have {each_small} uin from .1 V, the voltage of the text",
        ),
        ThesisRow(
            "8.3.1",
            "alpha by zeros that are computed to .001 V",
            "urad",
            "5",
            math.hypot(*supply),
            "by the rows 21 and 16 uin of table 7.12, whose cells 7 and 5 urad make 8.6; 5 is that of probe 3 alone",
        ),
    ]
    for probe, printed in enumerate(("351", "264", "175")):
        table.append(
            ThesisRow(
                "8.3.1",
                f"probe {probe + 1}: error over .7 V by .02 V of the zero",
                "uin",
                printed,
                abs(gauge[probe].motion_error) / UIN,
            )
        )
    for probe, printed in enumerate(("18", "21", "16")):
        table.append(
            ThesisRow(
                "8.3.1",
                f"probe {probe + 1}: error over .7 V by .001 V of the zero",
                "uin",
                printed,
                abs(computed[probe].motion_error) / UIN,
                f"a twentieth of .02 V leaves about a twentieth of {('351', '264', '175')[probe]} uin; no voltages are "
                "printed for this row",
            )
        )
    return table


def _column(output: str) -> str:
    """Return the column of table 7.12 with an output."""
    return next(column for column, name in BUDGET_COLUMNS.items() if name == output)


def _interpolation_row() -> ThesisRow:
    """Return the error of the grid of a diode over that of the doubled grid, on a simulated diode."""
    error = {}
    for count in (15, 29):
        at = np.linspace(0.0, DIODE_LENGTH, count)
        zero = np.zeros(count)
        cubic = 1e-3 * np.cos(at / (0.3 * inch))
        curves = np.column_stack([zero, zero + 0.3 * inch, zero, cubic])
        errors = doubled_grid_errors(curves, at, np.linspace(-0.8, 0.8, 33))
        error[count] = float(np.sqrt(np.mean(errors**2)))
    return ThesisRow(
        "8.3.3",
        "interpolation error of a grid over that of the doubled grid",
        "1",
        ".25",
        error[29] / error[15],
        "simulated diode whose cubic term changes smoothly; the maps of 1985, and so the 35, 25, 25 and 30 uin of "
        "section 7.4.2, cannot be recomputed: their coefficients are lost",
    )


def _computer_rows() -> list[ThesisRow]:
    """Return the time of a computer of 1985 for a scan (8.3.3)."""
    multiplications = 1.1 * (8.0 * _multiplications(9) + 3.0 * _multiplications(4))
    conversion = converter_resolution(inch, 1.0, 2.0**-16, samples=11, sample_time=100e-6).time
    return [
        ThesisRow(
            "8.3.3",
            "multiplications for eight polynomials of order 9 and three of order 4, and 10 %",
            "1",
            "430",
            multiplications,
            "each power is multiplied out by itself; the scheme of Horner needs 84 and 10 %",
        ),
        ThesisRow("8.3.3", "time of these multiplications, 30 us each", "s", ".013", multiplications * 30e-6),
        ThesisRow(
            "8.3.3",
            "time of 11 conversions of 100 us",
            "s",
            ".002",
            conversion,
            "11 times 100 us are .0011 s, which the text rounds up",
        ),
    ]


def _multiplications(order: int) -> int:
    """Return the multiplications of a polynomial whose powers are multiplied out one by one."""
    return sum(range(order + 1))
