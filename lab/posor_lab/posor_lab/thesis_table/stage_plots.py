"""Figures of sections 7.2 and 8.3.1: lines of the straightness runs, error of a motion by the zero of a probe."""

from __future__ import annotations

import numpy as np
from posor.reporting.figure_style import BLUE, GREEN, LIGHT_BLUE, ORANGE
from posor.reporting.plot import Plot
from posor_design.machine_metrology import probe_zero
from scipy.constants import inch

from posor_lab.thesis_data import data_path, read_table
from posor_lab.thesis_table.printed_units import UIN
from posor_lab.thesis_table.sensor_rows import probe_polynomials

TRAVEL = 0.75 * inch
"""Of the stepper stage, section 7.2."""
GAIN = 0.05 * inch
"""Of the probes [m/V], section 8.3.1."""
START, FINISH = 0.1, 0.8
"""Voltages of section 8.3.1."""
_COLOURS = (BLUE, ORANGE, GREEN, LIGHT_BLUE)


def stage_plots() -> list[Plot]:
    """Return the straightness runs of table 7.1 (figure 7.3), and the error by the zero of a probe.

    Raises:
        DataFileError: A table of the thesis cannot be read.

    """
    return [_straightness(), _zero()]


def _straightness() -> Plot:
    plot = Plot("7.2, figure 7.3: lines of the straightness runs, table 7.1", "position [in]", "reading [in]")
    table = read_table(data_path("straightness_table_7_1.csv"), ["run", "b_in", "m"])
    positions = np.linspace(0.0, TRAVEL / inch, 16)
    for number, row in enumerate(table):
        line = float(row["b_in"]) + float(row["m"]) * positions
        dash = "solid" if number < len(_COLOURS) else "dashed"
        plot.curve(f"run {row['run']}", positions, line, _COLOURS[number % len(_COLOURS)], dash=dash)
    return plot


def _zero() -> Plot:
    plot = Plot("8.3.1: error of a motion from .1 to .8 V by the zero of the probe", "zero error [V]", "error [uin]")
    errors = np.linspace(-0.04, 0.04, 81)
    for probe, coefficients in enumerate(probe_polynomials()):
        curve = [probe_zero(coefficients, START, FINISH, GAIN * error, GAIN).motion_error / UIN for error in errors]
        plot.curve(f"probe {probe + 1}", errors, curve, _COLOURS[probe])
    return plot
