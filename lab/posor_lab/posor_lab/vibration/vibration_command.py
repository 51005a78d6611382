# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""vibration: endpoints of arms whose upper arm oscillates by 250 um at 30 to 150 Hz, against the independent truth.

``make vibration`` draws arms of five_axis with accelerometers on the beams. Exit code 0: below the limit the dynamic
chain has at most a quarter of the error of the static one and is inside its 95 % region as often as stated; beyond the
limit no protection level is bounded; and the control with wrong natural frequencies is not inside.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from posor.chain.arm_file import load_arm_file
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console

from posor_lab.lab_output import check_writable, end_study, parse_study
from posor_lab.vibration.vibrating_arm import write_vibrating_arm
from posor_lab.vibration.vibration_study import AMPLITUDE_M, DYNAMIC, STATIC, VibrationStudy, sample_vibration

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_lab.vibration.vibration_study import Case

ARM, ARMS, SEED, MIN_ARMS = "five_axis", 30, 1985, 2
FREQUENCIES_HZ = (30.0, 45.0, 60.0, 75.0, 85.0, 105.0, 120.0, 135.0, 150.0)  # whole numbers of periods in a run
LEAST_GAIN = 4.0  # error of the static chain over that of the dynamic one
STATED, TOLERANCE = 0.95, 0.03  # least share inside the 95 % region, which contains the largest recent vibration
CONTROL_HZ, CONTROL_ERROR = 75.0, 1.4  # natural frequencies that the chain is given, over the stated ones
EDGE = 0.03  # relative distance from the limit within which the drawn frequency decides


def failures(found: Mapping[float, Mapping[str, Case]], limit_hz: float, control: Case) -> list[str]:
    """Return what does not hold, one clause each; ``control``: with wrong natural frequencies."""
    wrong = []
    for frequency, cases in found.items():
        static, dynamic = cases[STATIC], cases[DYNAMIC]
        if frequency <= (1.0 - EDGE) * limit_hz:
            if not dynamic.rms_m * LEAST_GAIN <= static.rms_m:
                wrong.append(f"{frequency:g} Hz: the error falls to 1/{static.rms_m / dynamic.rms_m:.1f}")
            if not dynamic.inside >= STATED - TOLERANCE:
                wrong.append(f"{frequency:g} Hz: {dynamic.inside:.1%} inside; expected {STATED:.0%} or more")
            if not dynamic.bounded:
                wrong.append(f"{frequency:g} Hz: the protection level is not bounded")
        elif frequency >= (1.0 + EDGE) * limit_hz and dynamic.bounded:
            wrong.append(f"{frequency:g} Hz: {dynamic.bounded:.1%} of the levels bounded beyond the limit")
    if not control.inside < STATED - TOLERANCE:
        wrong.append(f"the control with wrong natural frequencies is not found: {control.inside:.1%} inside")
    return wrong


def draw(found: Mapping[float, Mapping[str, Case]], limit_hz: float, path: Path) -> None:
    """Draw error of both chains and stated uncertainty of the dynamic one against frequency, with the limit."""
    from matplotlib.figure import Figure  # noqa: PLC0415  slow to import

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    panel, frequencies = figure.subplots(), list(found)
    for name, colour in ((STATIC, "tab:red"), (DYNAMIC, "tab:blue")):
        panel.semilogy(frequencies, [1e6 * found[f][name].rms_m for f in frequencies], "o-", color=colour, label=name)
    stated = [1e6 * found[f][DYNAMIC].stated_m for f in frequencies]
    panel.semilogy(frequencies, stated, "--", color="tab:blue", label="stated by the dynamic chain")
    panel.axvline(limit_hz, color="black", linewidth=0.8, label=f"limit, {limit_hz:.0f} Hz")
    panel.set(xlabel="frequency of the vibration [Hz]", ylabel="position of the endpoint, rms [um]")
    panel.set_title(f"simulated: the upper arm oscillates by {1e6 * AMPLITUDE_M:.0f} um", fontsize=10)
    panel.grid(visible=True, which="both", alpha=0.3)
    panel.legend(fontsize=8)
    figure.savefig(path)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    parser = CommandLineParser(prog="vibration", description="Endpoint of an arm that vibrates, simulated.")
    text = "arms drawn at each frequency (default: %(default)s)"
    parser.add_argument("--arms", type=whole_number_from(MIN_ARMS), default=ARMS, help=text)
    parser.add_argument("--figure", type=Path, help="also draw the table into this file (PNG or SVG)")
    options = parse_study(parser, "build/vibration.json", arguments)
    if options.figure is not None:
        check_writable(options.figure)
    with tempfile.TemporaryDirectory() as name:
        arm, folder = load_arm_file(ARM), Path(name)
        path = write_vibrating_arm(arm, folder / "stated")
        limit_hz = VibrationStudy(path).limit_hz
        found = {each: sample_vibration(path, each, options.arms, SEED) for each in FREQUENCIES_HZ}
        wrong = write_vibrating_arm(arm, folder / "wrong", frequency_error=CONTROL_ERROR)
        control = sample_vibration(path, CONTROL_HZ, options.arms, SEED, chain=wrong)[DYNAMIC]
    rows = [
        [
            f"{frequency:g}",
            *(f"{1e6 * value:.1f}" for value in (cases[STATIC].rms_m, cases[DYNAMIC].rms_m, cases[DYNAMIC].stated_m)),
            *(f"{share:.1%}" for share in (cases[STATIC].inside, cases[DYNAMIC].inside, cases[DYNAMIC].bounded)),
        ]
        for frequency, cases in found.items()
    ]
    header = (
        "frequency [Hz]",
        "static, rms [µm]",
        "dynamic, rms [µm]",
        "dynamic, stated [µm]",
        "static, inside 95 %",
        "dynamic, inside 95 %",
        "level bounded",
    )
    title = f"Simulated: {options.arms} arms of {ARM}, upper arm +-{1e6 * AMPLITUDE_M:.0f} µm; limit {limit_hz:.1f} Hz"
    console = report_console(140)
    ReportTable(title, header, rows).print(console)
    text = f"Control, natural frequencies x {CONTROL_ERROR:g} at {CONTROL_HZ:g} Hz: {control.inside:.1%} inside 95 %."
    console.print(text, markup=False)
    if options.figure is not None:
        draw(found, limit_hz, options.figure)
        print(f"figure written to {options.figure}")
    cases = {str(frequency): {name: case._asdict() for name, case in each.items()} for frequency, each in found.items()}
    content = {"arms": options.arms, "limit_hz": limit_hz, "frequencies": cases, "control": control._asdict()}
    return end_study("vibration", failures(found, limit_hz, control), options.output, content)
