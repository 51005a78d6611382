"""Rows and plots of the thesis table for measuring beams: frequencies of 6.2.2 and appendix 6A, sag of 6.2.1."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.reporting.figure_style import BLUE, ORANGE
from posor.reporting.plot import Plot
from posor_design.measuring_beams import beam_frequencies, sag_correction
from posor_design.structures import cantilever_frequencies
from posor_design.torsion import beam_torsion, disc_inertia
from scipy.constants import g, inch, lb, psi

from posor_lab.thesis_table.thesis_row import ThesisRow

if TYPE_CHECKING:
    from posor_design.measuring_beams import BeamFrequencies, SagCorrection
    from posor_design.structures import CantileverFrequencies
    from posor_design.torsion import BeamTorsion

ALUMINIUM: dict[str, float] = {"modulus": 10.6e6 * psi, "density": 0.1 * lb / inch**3}
"""Usual values (assumed): 6.2.2 prints neither; 6.2.3 has 10e6 psi."""
BOX: dict[str, Any] = {"wall": 0.125 * inch, "length": 60.0 * inch, "load_factor": 2.0, **ALUMINIUM}
HEIGHT, WIDTH = 6.0 * inch, 4.0 * inch
TUBE: dict[str, Any] = {
    "shape": "tube",
    "height": 2.0 * inch,
    "wall": 0.125 * inch,
    "length": 30.0 * inch,
    **ALUMINIUM,
}
GIMBALS = (6.0 * inch, 24.0 * inch)
PLATE = disc_inertia(10.0 * inch, 0.5 * inch, ALUMINIUM["density"])
PRINTED_HZ = ("129.798310", "140.721214", "183.779175", "201.010994", "211.716768", "426.793661")
"""Appendix 6A."""
ACCELERATION = 0.1 * g
"""Of the plots."""
LOSS_FACTOR = 0.001
"""Of the plots (assumed)."""
_TURN = 2.0 * math.pi


def rows() -> list[ThesisRow]:
    """Return the rows of 6.2.2, 6.3 and appendix 6A."""
    return [*_structure_rows(), *_appendix_rows(), *_measuring_beam_rows(), *_ratio_rows()]


def plots() -> list[Plot]:
    """Return the mode shapes of appendix 6A, and the error of the sag correction over the frequency."""
    return [_mode_plot(), *_sag_plots()]


def structural_beam(height: float, width: float) -> CantileverFrequencies:
    """Return the frequencies of the box beam of 6.2.2 that bends in the plane of its height."""
    return cantilever_frequencies(height=height, width=width, **BOX)


def measuring_beam(plate_inertia: float = PLATE.diameter_inertia) -> BeamFrequencies:
    """Return the frequencies of the measuring beam of 6.2.2 on rigid gimbals."""
    return beam_frequencies(
        **TUBE, gimbals=GIMBALS, plate_masses=(PLATE.mass, PLATE.mass), plate_inertias=(plate_inertia, plate_inertia)
    )


def measuring_beam_torsion(plate_inertia: float = PLATE.axis_inertia) -> BeamTorsion:
    """Return the torsion of this beam if the gimbal near its start holds it against twist."""
    return beam_torsion(**TUBE, gimbal=GIMBALS[0], plate_inertias=(plate_inertia, plate_inertia))


def _structure_rows() -> list[ThesisRow]:
    result = []
    for plane, beam, printed in (
        ("upright", structural_beam(HEIGHT, WIDTH), ("318", "1994", "5583")),
        ("sideways", structural_beam(WIDTH, HEIGHT), ("235", "1475", "4131")),
    ):
        modes = zip(printed, beam.slender_angular_frequencies, beam.angular_frequencies, strict=True)
        result += [
            ThesisRow(
                "6.2.2",
                f"structural beam {plane}, mode {mode}",
                "rad/s",
                digits,
                slender,
                f"slender beam as in the text; with shear and rotary inertia: {thick:.0f} rad/s",
            )
            for mode, (digits, slender, thick) in enumerate(modes, start=1)
        ]
    return result


def _mode_names() -> tuple[str, ...]:
    torsion = "torsion between the gimbal that holds the twist and the {} plate"
    bending = ("bending 1, upright", "bending 1, sideways", "bending 2, upright", "bending 2, sideways")
    return (*bending, torsion.format("far"), torsion.format("near"))


def _modes() -> tuple[tuple[float, str], ...]:
    """Return frequency [rad/s] and reason of the six modes of appendix 6A."""
    bending = measuring_beam().angular_frequencies
    flat = measuring_beam(plate_inertia=0.0).angular_frequencies
    torsion = measuring_beam_torsion()
    half = measuring_beam_torsion(PLATE.diameter_inertia)
    far, near = torsion.end_angular_frequencies[0], torsion.start_angular_frequencies[0]
    half_far, half_near = half.end_angular_frequencies[0], half.start_angular_frequencies[0]
    sideways = (
        "tube and discs are round, so both planes have one frequency; without the rotary inertia of the plates "
        "the two sideways modes are {:.1f} and {:.1f} Hz"
    ).format(*(each / _TURN for each in flat[:2]))
    twist = (
        f"with the inertia of the plates about a diameter, half of that about the axis: {half_far / _TURN:.1f} and "
        f"{half_near / _TURN:.1f} Hz, ratio {half_near / half_far:.3f}; the printed ratio of modes 6 and 5 is "
        f"{float(PRINTED_HZ[5]) / float(PRINTED_HZ[4]):.3f}"
    )
    return (
        (bending[0], ""),
        (bending[0], sideways),
        (bending[1], ""),
        (bending[1], sideways),
        (far, twist),
        (near, twist),
    )


def _appendix_rows() -> list[ThesisRow]:
    return [
        ThesisRow("App. 6A", f"measuring beam, mode {mode}: {name}", "Hz", digits, frequency / _TURN, reason)
        for mode, (name, digits, (frequency, reason)) in enumerate(
            zip(_mode_names(), PRINTED_HZ, _modes(), strict=True), start=1
        )
    ]


def _measuring_beam_rows() -> list[ThesisRow]:
    modes = _modes()
    printed = (("upright", ("817", "1156", "1332"), (0, 2, 4)), ("sideways", ("886", "1263", "1332"), (1, 3, 4)))
    return [
        ThesisRow(
            "6.2.2",
            f"measuring beam {plane}, {_mode_names()[mode].split(',')[0]}",
            "rad/s",
            digits,
            modes[mode][0],
            modes[mode][1],
        )
        for plane, numbers, places in printed
        for digits, mode in zip(numbers, places, strict=True)
    ]


def _ratio_rows() -> list[ThesisRow]:
    own = measuring_beam().angular_frequencies[0]
    ratios = {
        plane: own / structural_beam(*sides).slender_angular_frequencies[0]
        for plane, sides in (("upright", (HEIGHT, WIDTH)), ("sideways", (WIDTH, HEIGHT)))
    }
    return [
        *(
            ThesisRow("6.2.2", f"first mode of the measuring beam over the structural beam's, {plane}", "1", "3", ratio)
            for plane, ratio in ratios.items()
        ),
        ThesisRow(
            "6.3",
            "first mode of the measuring beam over the structural beam's",
            "1",
            "2",
            ratios["upright"],
            "does not follow: the frequencies that 6.2.2 prints have the ratios "
            f"{817.0 / 318.0:.2f} upright and {886.0 / 235.0:.2f} sideways",
        ),
    ]


def _mode_plot() -> Plot:
    plot = Plot("Appendix 6A: modes of the measuring beam", "distance from the start [in]", "deflection [1]")
    found = measuring_beam()
    positions = np.array(found.positions) / inch
    for number, colour, dash in ((0, BLUE, "solid"), (1, ORANGE, "dashed")):
        plot.curve(f"{found.frequencies[number]:.1f} Hz", positions, found.shapes[number], colour, dash=dash)
    for at in GIMBALS:
        plot.vertical("gimbal", at / inch)
    plot.zero()
    return plot


def _sag_plots() -> list[Plot]:
    frequencies = np.geomspace(1.0, 400.0, 120)
    found = [_sag_correction(float(frequency)) for frequency in frequencies]
    plots = []
    for field, label, unit in (("slope", "orientation", "urad"), ("deflection", "position", "um")):
        plot = Plot(
            f"6.2.2: static sag correction at 0.1 g, {label} of the end",
            "frequency of the acceleration [Hz]",
            f"amplitude [{unit}]",
            x_log=True,
            y_log=True,
        )
        for name, field_name, colour in (("correction", field, BLUE), ("its error", f"{field}_error", ORANGE)):
            plot.curve(name, frequencies, [1e6 * getattr(each, field_name) for each in found], colour)
        plot.vertical("first mode", found[0].first_frequency)
        plots.append(plot)
    return plots


def _sag_correction(frequency: float) -> SagCorrection:
    return sag_correction(
        **TUBE,
        gimbals=GIMBALS,
        plate_masses=(PLATE.mass, PLATE.mass),
        plate_inertias=(PLATE.diameter_inertia, PLATE.diameter_inertia),
        acceleration=ACCELERATION,
        frequency=frequency,
        loss_factor=LOSS_FACTOR,
    )
