# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Program ``health``: adds a short test at an artefact to the history of an arm, and says which part has changed."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from posor.arm_names import describe_argument
from posor.bags.offline_pipeline import load_arm
from posor.bags.result_folder import prepare_outputs
from posor.errors import DataFileError, OutputError, ParameterError
from posor.output_files import write_files
from posor.reporting.command_line_parser import CommandLineParser, number_from, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.tables.table_readings import load_readings
from posor_calibration.arm.endpoint_references import Uncertainty, references_of
from posor_calibration.commissioning.file_checks import arm_identity
from posor_calibration.health.health_chart import FALSE_ALARM, REFERENCE_TESTS, chart_tests
from posor_calibration.health.health_history import HealthHistory, content_of, read_history, write_history
from posor_calibration.health.health_model import HealthModel
from posor_calibration.health.health_report import HealthReport
from posor_calibration.health.health_test import HealthArm, date_text
from posor_design.arm_uncertainty import chain_at

from posor_bringup.reference_options import PLACE_LIMITS, UNCERTAINTY_LIMITS, check_names, named_numbers

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from posor.bags.offline_pipeline import Arm
    from posor.calibration.calibration_file import Calibration
    from posor.chain.kinematic_chain import Chain

WHERE = "health"
PAGE, NUMBERS = "report.html", "report.json"
CHANGED = 3
"""Exit code of an arm that has changed."""
NO_VERDICT = 4
"""Exit code while there are too few tests."""
POINT = 3
DAY_NS = 86_400 * 10**9


def parse_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options. Raises ParameterError: an option is unknown or invalid, or options do not fit together."""
    description = "Add a health test to the history of an arm, and say which part has changed."
    parser = CommandLineParser(prog="posor health", description=description)
    parser.add_argument("arm", metavar="ARM", help=describe_argument())
    text = "history of the arm; the first test makes it"
    parser.add_argument("--history", type=Path, required=True, metavar="FILE.parquet", help=text)
    text = "raw scans of the test: the arm at rest, its ball in a seat, at the times of the table"
    parser.add_argument("--bag", type=Path, help=f"{text}; default: judge the tests of the history")
    text = "time of each dwell and place of its seat"
    parser.add_argument("--table", type=Path, metavar="FILE", help=text)
    parser.add_argument("--map", type=Path, metavar="MAP.yaml", help="map of the columns of the table")
    text = "standard uncertainty with which a ball of the map rests in its seat again [m], per metre; may be repeated"
    parser.add_argument("--uncertainty", action="append", default=[], metavar="BALL=M[,PER_METRE]", help=text)
    text = "ball in the endpoint [m]; default: at the endpoint; may be repeated"
    parser.add_argument("--tool", action="append", default=[], metavar="BALL=X,Y,Z", help=text)
    text = "scans this long before and after the time of a dwell are averaged [s] (default: %(default)g)"
    parser.add_argument("--window", type=number_from(0.0, unit="s"), default=0.1, metavar="S", help=text)
    text = "the beams deviate by at most this from the temperature of the URDF (default: as the beams file states)"
    parser.add_argument("--temperature-deviation", type=number_from(0.0, unit="K"), metavar="K", help=text)
    text = "the mean of the first N tests is the reference (default: %(default)d)"
    parser.add_argument("--reference-tests", type=whole_number_from(1), default=REFERENCE_TESTS, metavar="N", help=text)
    text = "probability that a test of a sound arm gives an alarm (default: %(default)g)"
    parser.add_argument("--false-alarm", type=number_from(1e-15, 0.1), default=FALSE_ALARM, metavar="P", help=text)
    parser.add_argument("--output", type=Path, metavar="FOLDER", help="default: build/health/<name of the arm>")
    options = parser.parse_args(arguments)
    given = [name for name in ("bag", "table", "map") if getattr(options, name) is not None]
    if given and len(given) < POINT:
        what = " and ".join(f"--{name}" for name in given)
        raise ParameterError(f"{what} alone", where=WHERE, expected="--bag, --table and --map together")
    named = named_numbers(f"{WHERE}, --uncertainty", options.uncertainty, (1, 2), UNCERTAINTY_LIMITS)
    options.uncertainty = {name: Uncertainty(*numbers) for name, numbers in named.items()}
    options.tool = named_numbers(f"{WHERE}, --tool", options.tool, (POINT,), PLACE_LIMITS)
    return options


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; exit code 0: no part has changed; 3: one has; 4: too few tests for a verdict."""
    options = parse_options(arguments)
    arm = load_arm(options.arm)
    chain = chain_at(arm, options.temperature_deviation)
    calibrations = {joint.name: arm.calibration(joint.name) for joint in chain.path_joints}
    folder = options.output or Path("build/health") / arm.name
    prepare_outputs(folder, (PAGE, NUMBERS))
    before = content_of(options.history)
    history = _known_history(options.history, arm, calibrations)
    if options.bag is not None:
        if not options.history.resolve().parent.is_dir():
            raise OutputError("its folder does not exist", where=str(options.history), expected="an existing folder")
        history = _with_test(options, arm, chain, calibrations, history)
        write_history(options.history, history, before)
    if history is None:
        raise DataFileError(
            "does not exist", where=str(options.history), expected="a first test: --bag, --table, --map"
        )
    missing = options.reference_tests + 1 - len(history.tests)
    if missing > 0:
        print(f"{len(history.tests)} tests of {arm.name}: {missing} more and there is a verdict")
        return NO_VERDICT
    balls = {name: np.array(place) for name, place in history.balls.items()}
    model = HealthModel(HealthArm(chain, calibrations, balls), history.tests[0], history.T_artefact_base)
    report = HealthReport(arm.name, chart_tests(model, history.tests, options.reference_tests, options.false_alarm))
    write_files({folder / PAGE: report.to_page(), folder / NUMBERS: report.to_json()})
    print(report.sentence)
    print(f"advice: {report.advice}")
    print(f"page {folder / PAGE}, numbers {folder / NUMBERS}")
    return CHANGED if report.suspects else 0


def _known_history(path: Path, arm: Arm, calibrations: dict[str, Calibration]) -> HealthHistory | None:
    """Return the history in a file; None: there is none. Raises DataFileError: it is of another arm or other files."""
    if not path.exists():
        return None
    history = read_history(path)
    if history.arm != arm.name:
        raise DataFileError(f"is the history of arm '{history.arm}'", where=str(path), expected=f"that of '{arm.name}'")
    changed = arm_identity(arm, calibrations).differences(history.identity)
    if changed:
        expected = "the files of its tests; after a calibration begin a new history"
        raise DataFileError("; ".join(changed.values()), where=str(path), expected=expected)
    return history


def _with_test(
    options: argparse.Namespace,
    arm: Arm,
    chain: Chain,
    calibrations: dict[str, Calibration],
    history: HealthHistory | None,
) -> HealthHistory:
    """Return the history with the test of the options, or a new history."""
    table = load_readings(options.table, options.map, needs_joints=False)
    references = references_of(table, options.uncertainty, str(options.table))
    for option in ("uncertainty", "tool"):
        check_names(f"{WHERE}, --{option}", getattr(options, option), references.reflectors)
    balls = {name: options.tool.get(name, [0.0] * POINT) for name in references.reflectors}
    if history is not None and balls != dict(history.balls):
        what = f"balls {balls}"
        raise ParameterError(what, where=f"{WHERE}, --tool", expected=f"those of the first test, {dict(history.balls)}")
    health_arm = HealthArm(chain, calibrations, {name: np.array(place) for name, place in balls.items()})
    estimates = arm.estimate(options.bag, false_alarm=0.0)  # the charts judge the residuals
    first = None if history is None else history.T_artefact_base
    test, T = health_arm.measure(estimates, references, options.window, str(options.bag), first)
    if test.stamp_ns > (now_ns := time.time_ns()) + DAY_NS:  # no later test could follow
        what, expected = f"the test is of {date_text(test.stamp_ns)}", f"one before now, {date_text(now_ns)}"
        raise DataFileError(what, where=str(options.bag), expected=expected)
    history = history or HealthHistory(arm.name, arm_identity(arm, calibrations), T, balls)
    return history.with_test(test, str(options.bag))
