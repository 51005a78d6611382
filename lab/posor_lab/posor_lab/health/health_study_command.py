# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""health: monthly health tests of drawn arms, sound, with a creeping probe, and with a bumped beam.

``make health`` simulates 100 sound years of each arm, and each joint and beam changed in turn, with the independent
truth. Exit code 0: no alarm in the sound years; every change is found, and the part that changed is named.
"""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from posor.reporting.command_line_parser import CommandLineParser, whole_number_from
from posor.reporting.program_errors import reports_errors
from posor.reporting.report_table import ReportTable, report_console
from posor_calibration.health.health_chart import REFERENCE_TESTS, chart_tests
from posor_calibration.health.health_history import write_history

from posor_lab.health.ageing_arm import Ageing, AgeingArm
from posor_lab.lab_output import parse_study, write_json
from posor_lab.reports.process_pool import ordered_map

if TYPE_CHECKING:
    from collections.abc import Sequence

ARMS = ("five_axis", "six_axis")
POSES, SEED, MONTHS = 8, 1985, 12
YEARS, LIFE = 100, 10  # sound years of each arm; years of one history
BEGIN = REFERENCE_TESTS + 3  # first test with a change
TESTS = BEGIN + 6  # of an arm with a change
CREEP, BUMP = 1e-6, 20e-6  # [m] a month, [m]


class Outcome(NamedTuple):
    """What the tests of one arm with a change, or of a sound one, give."""

    case: str
    tests: int  # after the reference
    alarms: int
    months: int | None  # from the change to the first alarm; None: no alarm
    named: tuple[str, ...]  # parts that explain the first alarm, the likeliest first
    right: bool  # whether the part that changed is named, or a sound arm has no alarm


@cache  # each worker reads the files once
def _arm(name: str) -> AgeingArm:
    return AgeingArm(name, POSES, SEED)


def cases_of(name: str, seed: int) -> list[tuple[str, Ageing]]:
    """Return the parts that change, and how: a probe of each joint creeps, each beam is bumped in a drawn direction."""
    arm, random = _arm(name), np.random.default_rng(seed)
    found = []
    for joint, posor in arm.health.posors.items():
        probes = [k for k, reading in enumerate(posor.stack.reading_names) if reading.startswith(("gap ", "ring "))]
        reading = int(random.choice(probes))
        part = f"{posor.stack.reading_names[reading]} of {joint}"
        found.append((part, Ageing(BEGIN, creeps={(joint, reading): CREEP})))
    for beam in arm.health.chain.beams:
        direction = random.normal(size=3)
        shift = BUMP * direction / np.linalg.norm(direction)
        found.append((f"beam {beam.name}", Ageing(BEGIN, bumps={beam.name: shift})))
    return found


def run_case(name: str, case: tuple[str, Ageing], tests: int, seed: int) -> Outcome:
    """Return the outcome of the tests of a drawn arm; a case without a name is a sound arm."""
    part, ageing = case
    measured = list(_arm(name).tests(seed, tests, ageing))
    chart = chart_tests(_arm(name).model(measured[0]), measured)
    alarms = chart.alarms + REFERENCE_TESTS
    if not alarms.size:
        return Outcome(part or "sound", len(chart.ratios), 0, None, (), right=not part)
    named = tuple(chart.parts[p].name for p in chart.suspects_at(int(chart.alarms[0])))
    right = bool(part) and alarms[0] >= BEGIN and any(f"{each},".startswith(f"{part},") for each in named)
    return Outcome(part or "sound", len(chart.ratios), len(alarms), int(alarms[0]) - BEGIN + 1, named, right=right)


def study(name: str, years: int) -> list[Outcome]:
    """Return the outcomes of sound years and of all changes of an arm."""
    sound = [("", Ageing())] * -(-years // LIFE)
    jobs = [(case, LIFE * MONTHS + REFERENCE_TESTS) for case in sound] + [
        (case, TESTS) for case in cases_of(name, SEED)
    ]
    return ordered_map(partial(_run, name), list(enumerate(jobs)))


def _run(name: str, job: tuple[int, tuple[tuple[str, Ageing], int]]) -> Outcome:
    number, (case, tests) = job
    return run_case(name, case, tests, SEED + number)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    parser = CommandLineParser(prog="health", description="Health tests of arms that age, simulated.")
    text = "simulated sound years of each arm, ten for each drawn arm (default: %(default)s)"
    parser.add_argument("--years", type=whole_number_from(LIFE), default=YEARS, help=text)
    parser.add_argument("--arm", action="append", choices=ARMS, help="only this arm; may be repeated")
    text = "write a history in which a probe creeps, in place of the study: creep.parquet"
    parser.add_argument("--files", type=Path, metavar="FOLDER", help=text)
    options = parse_study(parser, "build/health.json", arguments)
    if options.files is not None:
        name = (options.arm or ARMS)[0]
        part, ageing = cases_of(name, SEED)[2]
        options.files.mkdir(parents=True, exist_ok=True)
        write_history(options.files / "creep.parquet", _arm(name).history(_arm(name).tests(SEED, TESTS, ageing)))
        print(f"creep.parquet: {TESTS} tests of {name}, {part} creeps")
        return 0
    found = {name: study(name, options.years) for name in options.arm or ARMS}
    for name, outcomes in found.items():
        sound = [each for each in outcomes if each.case == "sound"]
        alarms, tests = sum(each.alarms for each in sound), sum(each.tests for each in sound)
        rows = [["sound", f"{tests // MONTHS} years, {tests} tests", f"{alarms} alarms", "", _verdict(sound)]]
        rows += [
            [
                f"{each.case} {'creeps 1 µm a month' if ' of ' in each.case else 'bumped by 20 µm'}",
                f"{each.tests} tests",
                "not found" if each.months is None else f"after {each.months} months",
                "; ".join(each.named),
                _verdict([each]),
            ]
            for each in outcomes
            if each not in sound
        ]
        title = f"Simulated: {name}, monthly health tests in {POSES} postures"
        ReportTable(title, ("arm", "tests", "alarm", "named", "right"), rows).print(report_console(160))
    write_json(options.output, {name: [each._asdict() for each in outcomes] for name, outcomes in found.items()})
    return 0 if all(each.right for outcomes in found.values() for each in outcomes) else 1


def _verdict(outcomes: Sequence[Outcome]) -> str:
    return "yes" if all(each.right for each in outcomes) else "NO"
