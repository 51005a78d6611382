# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""shop: endpoint of an arm in a shop whose temperature changes by +-10 K, with and without thermometers.

``make shop`` draws arms of five_axis with the independent truth. Exit code 0: with thermometers the error is at most a
tenth, both cases are inside their 95 % region as often as stated, and the control with the wrong sign is not.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.chain.arm_file import load_arm_file
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console

from posor_lab.lab_output import end_study, parse_study
from posor_lab.shop.shop_arm import write_shop_arm
from posor_lab.shop.shop_study import SWING_K, WITH, WITHOUT, WRONG_SIGN, sample_shop

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor_lab.shop.shop_study import CaseSample

ARMS, POSES, SEED, MIN_ARMS = 1000, 6, 1985, 2
SHIFT_ARMS, SHIFT_POSES = 20, 48  # of the shift in which the temperature swings
LEAST_GAIN = 10.0  # error without thermometers over that with them
STATED, TOLERANCE = 0.95, 0.02  # share of the poses inside their 95 % region


def figures(samples: Mapping[str, CaseSample]) -> dict[str, Any]:
    """Return the figures of each case."""
    return {
        case: {"rms_m": sample.rms_m, "inside": sample.inside.value, "inside_sigma": sample.inside.sigma}
        for case, sample in samples.items()
    }


def failures(drawn: Mapping[str, Any], shift: Mapping[str, Any]) -> list[str]:
    """Return what does not hold, one clause each.

    No coverage is judged of a ``shift``, whose temperature is not drawn.
    """
    found = []
    for name, cases in (("drawn temperatures", drawn), ("shift", shift)):
        gain = cases[WITHOUT]["rms_m"] / cases[WITH]["rms_m"]
        if not gain >= LEAST_GAIN:
            found.append(f"{name}: the error falls to 1/{gain:.1f}; expected 1/{LEAST_GAIN:g} at most")
    found += [
        f"{case}: {drawn[case]['inside']:.1%} inside; expected {STATED:.0%} +- {TOLERANCE:.0%}"
        for case in (WITH, WITHOUT)
        if not abs(drawn[case]["inside"] - STATED) <= TOLERANCE
    ]
    if not drawn[WRONG_SIGN]["inside"] < STATED - TOLERANCE:
        found.append(f"the control {WRONG_SIGN} is not found: {drawn[WRONG_SIGN]['inside']:.1%} inside")
    return found


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    parser = CommandLineParser(prog="shop", description="Endpoint in a shop whose temperature changes, simulated.")
    count = whole_number_from(MIN_ARMS)
    parser.add_argument("--arms", type=count, default=ARMS, help="arms with drawn temperatures (default: %(default)s)")
    text = "arms during a shift (default: %(default)s)"
    parser.add_argument("--shift-arms", type=count, default=SHIFT_ARMS, help=text)
    options = parse_study(parser, "build/shop.json", arguments)
    with tempfile.TemporaryDirectory() as folder:
        path = write_shop_arm(load_arm_file("five_axis"), Path(folder))
        drawn = figures(sample_shop(path, options.arms, POSES, SEED))
        shift = figures(sample_shop(path, options.shift_arms, SHIFT_POSES, SEED, swing=True))
    rows = [
        [case, *(f"{1e6 * cases[case]['rms_m']:.1f}" for cases in (drawn, shift)), f"{drawn[case]['inside']:.1%}"]
        for case in drawn
    ]
    header = ("case", "rms, drawn temperatures [µm]", f"rms, shift of +-{SWING_K:g} K [µm]", "inside 95 % region")
    title = f"Simulated: five_axis, {options.arms} arms at {POSES} poses; a shift of {options.shift_arms} arms"
    ReportTable(title, header, rows).print(report_console(140))
    return end_study("shop", failures(drawn, shift), options.output, {"drawn": drawn, "shift": shift})
