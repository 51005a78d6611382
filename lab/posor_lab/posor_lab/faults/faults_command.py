# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""faults: injects every fault of the fault table into nodes and estimator, and a storm of all of them.

Prints fault, expected and seen behaviour, time to naming, and wrong poses published as valid; writes ``faults.json``.
The exit code is 0 only if every aim is reached; the aims are in ``docs/how_to/faults.md``.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.errors import ParameterError
from posor.estimation.posor import Posor
from posor.model.fault import Fault
from posor.ros_names import TRANSFORM_TOPIC
from posor_bringup.arm_programs import arm_programs, group_programs
from posor_drivers.simulator.arm_simulation import ArmSimulation
from rich.table import Table
from scipy.stats import betabinom

from posor_lab.faults.availability import OK_SHARE, Availability, arm_availability
from posor_lab.faults.cause_faults import SCANS, run_causes
from posor_lab.faults.device_run import DeviceRun
from posor_lab.faults.fault_table import (
    CYCLE_S,
    FAULT_TABLE,
    IMPERFECTION_PARAMETERS,
    IMPERFECTIONS,
    RATES,
    write_fault_arm,
)
from posor_lab.faults.injection_run import ReadingRun
from posor_lab.faults.levels_at_rest import AIMS, DEVIATION_K, RestingArm, levels_at_rest
from posor_lab.faults.message_run import MessageRun
from posor_lab.faults.motion_coverage import LEAST, LevelCoverage, motion_coverage
from posor_lab.faults.node_storm import run_node_storm
from posor_lab.faults.offline_faults import CASES, run_ambient, run_hidden, run_slips
from posor_lab.faults.offline_time import run_offline_times
from posor_lab.faults.process_run import ProcessRun
from posor_lab.faults.storm import run_storm, storm_calibrations
from posor_lab.faults.time_run import AgedRun, ScatterRun, TimeRun
from posor_lab.reports.arrival_receiver import ArrivalReceiver
from posor_lab.reports.findings import Finding, Findings, Verdict
from posor_lab.reports.graph_receiver import running_graph
from posor_lab.reports.trial_program import Option, TrialProgram

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from posor_lab.faults.fault_table import ArmName, FaultRow, RowResult
    from posor_lab.faults.injection_run import InjectionRun
    from posor_lab.faults.storm import StormCount
    from posor_lab.reports.trial_program import Trial

EXPECTED_SCANS = 100_000  # simulated scans of each joint from which the rate of false alarms is expected
BAND = 0.95


@dataclass(frozen=True)
class AlarmFigures:
    """Figures of a run without faults."""

    arm: str
    errors: tuple[str, ...]  # messages of the diagnostics at the level ERROR, without repetition
    scans: int  # transforms that came
    alarms: int  # of these, rejected by the test of the redundant readings
    band: tuple[int, int]  # least and most alarms in the 95 % band of the expected rate, which is itself an estimate

    @property
    def holds(self) -> bool:
        """Whether there was no error, and the number of alarms is as expected."""
        return not self.errors and self.is_in_band

    @property
    def is_in_band(self) -> bool:
        """Whether the number of alarms is as expected."""
        return self.band[0] <= self.alarms <= self.band[1]


def run_without_faults(
    arm: ArmName, seconds: float, folder: Path, seed: int, interrupted: Callable[[], bool]
) -> AlarmFigures:
    """Run an arm without faults and return its figures.

    The same sensors in other simulated scans give the expected rate: the errors of one calibration shift it from
    the probability that the test states over all calibrations.

    Raises ProcessError: a node failed, or the arm has no poses.
    """
    simulation = ArmSimulation(write_fault_arm(arm, folder / "arm", CYCLE_S, seed), IMPERFECTIONS)
    topics = [f"{joint}/{TRANSFORM_TOPIC}" for joint in simulation.joints]
    others, expected_alarms = EXPECTED_SCANS // (CYCLE_S * RATES[arm]) * CYCLE_S * RATES[arm], 0
    for joint in simulation.joints:
        scans = simulation.scans(joint, np.arange(others)).scans
        estimates = Posor(simulation.calibrations[joint]).estimate_all(scans)
        expected_alarms += int(np.count_nonzero(estimates.faults & int(Fault.RESIDUAL)))
    receiver = ArrivalReceiver(simulation.arm.name, simulation.joints)
    programs = arm_programs(simulation.arm, driver_parameters=IMPERFECTION_PARAMETERS)
    programs = group_programs(programs, "drivers_apart", folder)
    with running_graph(programs, receiver, folder, "faults", interrupted) as watch:
        watch.wait(lambda: receiver.usable_endpoints(RATES[arm]), lambda: "endpoint poses")
        receiver.diagnostics.clear()
        begin = {topic: receiver.count(topic) for topic in topics}
        receiver.receive_for(seconds)
        errors = {status.message for _, status in receiver.diagnostics if status.level == status.ERROR}
        flags = [each.message.faults for topic in topics for each in receiver.since(topic, begin[topic])]
    without_alarm = others * len(topics) - expected_alarms
    low, high = betabinom.interval(BAND, len(flags), expected_alarms + 1, without_alarm + 1)
    alarms = sum(bool(each & Fault.RESIDUAL) for each in flags)
    return AlarmFigures(arm, tuple(sorted(errors)), len(flags), alarms, (int(low), int(high)))


SOUND_ARMS: tuple[ArmName, ...] = ("five_axis", "six_axis")
DRAWN_ARMS: tuple[ArmName, ...] = ("six_axis", "five_axis_checked")
QUICK_INJECTED, QUICK_CASES, QUICK_SCANS = 6_000, 50, 40
OPTIONS = (
    Option("--seed", 1985, "of motion, noise and faults", least=0),
    Option("--rows", "", "only rows whose name contains TEXT; no storm"),
    Option("--no-rows", default=False, text="storms, drawn arms and runs without faults only"),
    Option("--quick", default=False, text="a few rows and a short storm, for less than 30 s"),
    Option("--storm", 1_000_000, "faulty scans of the storm through the estimator, of all stacks together", least=0),
    Option("--node-storm", 100_000, "faulty scans of the storm through nodes", least=0),
    Option("--arms", 100, "drawn arms of each design without faults, every one of which must be OK", least=0),
    Option("--motion", 100_000, "scans of drawn arms of each design in fast motion", least=0),
    Option("--soak", 30.0, "duration of each run without faults [s]; 600 for the full test", least=0),
)
LIVE_RUNS: Mapping[str, type[InjectionRun]] = {  # live runs by section of the table
    "readings": ReadingRun,
    "messages": MessageRun,
    "times": TimeRun,
    "stamps": ScatterRun,
    "aged": AgedRun,
    "processes": ProcessRun,
    "devices": DeviceRun,
}
TITLES = {  # titles of the runs by section of the table; rows of the same title share a run
    **{name: run.TITLE for name, run in LIVE_RUNS.items()},
    "hidden": "hidden faults",
    "causes": "causes of faults",
    "slips": "slips of sources",
    "ambient": "ambient light",
    "offline_times": "time of {0.arm} without nodes",
}


def shorten(options: Namespace) -> None:
    """Disable the parts that ``--rows`` and ``--quick`` do not run."""
    if options.quick or options.rows:
        options.soak, options.node_storm, options.arms, options.motion = 0.0, 0, 0, 0
        options.storm = 0 if options.rows else min(options.storm, QUICK_INJECTED)


def run_rows(trial: Trial) -> list[RowResult]:
    """Run the selected rows and return their results.

    Raises ParameterError: no row is selected. Raises ProcessError: a node failed. Raises InterruptedRunError: the user
    interrupted the run.
    """
    options, groups = trial.options, defaultdict[str, list["FaultRow"]](list)
    if options.no_rows:
        return []
    for row in FAULT_TABLE:
        if options.rows in row.title and (row.quick or not options.quick):
            groups[TITLES[row.run].format(row)].append(row)
    if not groups:
        raise ParameterError(f"--rows '{options.rows}'", where="faults", expected="part of the name of a row")
    results = []
    for title, rows in groups.items():
        with trial.progress.stage(title, len(rows)) as on_done:
            found = _run_group(rows, title, trial)
            on_done(len(rows))
        for each in found:
            trial.progress.line(describe_row(each))
        results += found
    return results


def _run_group(rows: Sequence[FaultRow], title: str, trial: Trial) -> list[RowResult]:
    options, run = trial.options, rows[0].run
    if run in LIVE_RUNS:
        return LIVE_RUNS[run](rows, trial.subfolder(title), options.seed, trial.interrupted).run()
    if run == "causes":
        return [run_causes(row, options.seed, QUICK_SCANS if options.quick else SCANS) for row in rows]
    if run == "offline_times":
        return run_offline_times(rows, trial.subfolder(title), options.seed)
    if run in {"slips", "ambient"}:
        of_row = run_slips if run == "slips" else run_ambient
        return [of_row(row, options.seed) for row in rows]
    return [run_hidden(row, options.seed, QUICK_CASES if options.quick else CASES) for row in rows]


def run_soaks(trial: Trial) -> list[AlarmFigures]:
    """Return the figures of the runs without faults.

    Raises ProcessError: a node failed. Raises InterruptedRunError: the user interrupted the run.
    """
    soaks = []
    for arm in SOUND_ARMS if trial.options.soak else ():
        with trial.progress.stage(f"{arm} without faults", 1) as on_done:
            folder = trial.subfolder(f"soak {arm}")
            soaks.append(run_without_faults(arm, trial.options.soak, folder, trial.options.seed, trial.interrupted))
            on_done()
    return soaks


def run_drawn_arms(trial: Trial) -> tuple[list[Availability], list[LevelCoverage]]:
    """Return the figures of drawn arms: of sound scans, and of the level in fast motion."""
    options, sound, moving = trial.options, list[Availability](), list[LevelCoverage]()
    for arm in DRAWN_ARMS if options.arms else ():
        with trial.progress.stage(f"drawn arms of {arm}", options.arms) as on_done:
            sound.append(arm_availability(arm, options.arms, options.seed, on_done))
    for arm in DRAWN_ARMS if options.motion else ():
        with trial.progress.stage(f"{arm} in fast motion", options.motion) as on_done:
            moving.append(motion_coverage(arm, options.motion, options.seed, trial.subfolder(f"motion {arm}"), on_done))
    return sound, moving


def run_storms(trial: Trial) -> dict[str, StormCount]:
    """Return the figures of the storm of each stack, through the estimator and through nodes.

    Raises ProcessError: a node failed. Raises InterruptedRunError: the user interrupted the run.
    """
    calibrations, storms, options = storm_calibrations(), {}, trial.options
    for name, calibration in calibrations.items():
        if injected := options.storm // len(calibrations):
            with trial.progress.stage(f"storm of {name}", injected) as on_done:
                storms[name] = run_storm(calibration, injected, options.seed, on_done)
        if injected := options.node_storm // len(calibrations):
            title = f"{name} through nodes"
            with trial.progress.stage(f"storm of {title}", injected) as on_done:
                storms[title] = run_node_storm(calibration, injected, options.seed, trial.folder, on_done)
    return storms


def run_faults(trial: Trial) -> tuple[Findings, Mapping[str, Any]]:
    """Return the findings and the content of ``faults.json``."""
    results, soaks, storms = run_rows(trial), run_soaks(trial), run_storms(trial)
    sound, moving = run_drawn_arms(trial)
    if trial.console.is_terminal:
        trial.console.print(rows_table(results))
    content = {
        "faults": [each.as_json() for each in results],
        "without_faults": [{**vars(each), "holds": each.holds} for each in soaks],
        "drawn_arms": [vars(each) for each in sound],
        "motion": [{**vars(each), "share": each.share} for each in moving],
        "storm": storm_json(storms),
    }
    resting = [levels_at_rest(arm) for arm in AIMS] if trial.options.arms else []
    found = fault_findings(results, soaks, storms)
    arms = (*map(describe_arms, sound), *map(describe_motion, moving), *map(describe_rest, resting))
    return Findings((*found.findings, *arms)), content


def describe_rest(found: RestingArm) -> Finding:
    """Return the verdict on the levels of an arm at rest."""
    quantity = f"{found.arm} at rest, temperatures within {DEVIATION_K:g} K: largest protection level"
    worst, remark = found.describe(found.worst), f"median {found.describe(found.median)}"
    aim = " and ".join(f"{1e6 * each:g} {unit}" for each, unit in zip(AIMS[found.arm], ("um", "urad"), strict=True))
    return Finding.judged(quantity, worst, f"at most {aim}", holds=found.holds, remark=remark)


def describe_arms(found: Availability) -> Finding:
    """Return the verdict on drawn arms without faults."""
    quantity, worst = f"{found.arm}: sound scans that are OK, worst arm", f"{100.0 * min(found.shares):.3f} %"
    aim = f"at least {100.0 * OK_SHARE:g} %"
    return Finding.judged(quantity, worst, aim, holds=found.holds, remark=found.describe())


def describe_motion(found: LevelCoverage) -> Finding:
    """Return the verdict on the level in fast motion."""
    quantity, share = f"{found.arm} in fast motion: within the protection level", f"{100.0 * found.share:.3f} %"
    aim = f"at least {100.0 * LEAST:g} %"
    return Finding.judged(quantity, share, aim, holds=found.share >= LEAST, remark=found.describe())


def fault_findings(
    results: Sequence[RowResult], soaks: Sequence[AlarmFigures], storms: Mapping[str, StormCount]
) -> Findings:
    """Return the verdicts on rows, runs without faults, and storms."""
    failed = [each for each in results if each.failures]
    found = [Finding(each.row.title, "; ".join(each.failures), verdict=Verdict.FAILS) for each in failed]
    held = len(results) - len(failed)
    found.append(Finding.judged("rows that hold", f"{held}", f"{len(results)}", holds=not failed))
    for soak in soaks:
        title, errors = f"{soak.arm} without faults", "; ".join(soak.errors)
        quantity = f"{title}: errors in the diagnostics"
        found.append(Finding.judged(quantity, f"{len(soak.errors)}", "0", holds=not errors, remark=errors))
        band, remark = f"{soak.band[0]} to {soak.band[1]}", f"of {soak.scans} scans; 95 % band of the expected rate"
        quantity = f"{title}: false alarms"
        found.append(Finding.judged(quantity, f"{soak.alarms}", band, holds=soak.is_in_band, remark=remark))
    for name, storm in storms.items():
        worst = ", ".join(f"{fault} {count}" for fault, count in sorted(storm.wrong_by_fault.items()))
        wrong = f"storm of {name}: wrong poses published as valid"
        remark = f"{storm.injected} faulty of {storm.scans} scans; {worst or 'none wrong'}"
        found.append(Finding(wrong, f"{storm.wrong_ok}", remark=remark))
        found.append(Finding.none_of(f"{wrong}, not covered by the protection level", storm.uncovered))
        if "nodes" in name:
            found.append(Finding.none_of(f"storm of {name}: transforms unlike the estimator's", storm.different))
        found.append(
            Finding.judged(
                f"storm of {name}: sound scans that are OK",
                f"{100.0 * storm.sound_ok_share:.3f} %",
                f"at least {100.0 * OK_SHARE:g} %",
                holds=storm.sound_ok_share >= OK_SHARE,
                remark=f"of {storm.sound}; {storm.latched} more in latched periods",
            )
        )
    return Findings(tuple(found))


def storm_json(storms: Mapping[str, StormCount]) -> dict[str, Any]:
    """Return the storms as in ``faults.json``: the sums, and the figures of each stack."""
    stacks = {name: {**vars(storm), "sound_ok_share": storm.sound_ok_share} for name, storm in storms.items()}
    names = ("scans", "injected", "wrong_ok", "uncovered", "sound", "sound_ok")
    return {**{name: sum(getattr(storm, name) for storm in storms.values()) for name in names}, "stacks": stacks}


def describe_row(result: RowResult) -> str:
    """Return a row as one line."""
    verdict = Verdict.of(holds=not result.failures).value
    naming = "" if result.naming_s is None else f"; named after {result.naming_s:.3f} s"
    return f"{verdict:<6} {result.row.title}: {result.seen}{naming}; {result.wrong_ok} wrong and OK"


def rows_table(results: Sequence[RowResult]) -> Table:
    """Return the fault table for the terminal."""
    table = Table(title="fault table", header_style="bold")
    for heading in ("fault", "expected", "seen", "naming [s]", "wrong and OK"):
        table.add_column(heading, overflow="fold")
    for each in results:
        naming = "" if each.naming_s is None else f"{each.naming_s:.3f}"
        cells = each.row.title, each.row.expected, each.seen, naming, f"{each.wrong_ok}"
        table.add_row(*cells, style="red" if each.failures else "")
    return table


DESCRIPTION = "Inject faults and count wrong poses published as valid."
PROGRAM = TrialProgram("faults", DESCRIPTION, OPTIONS, run_faults, "fault table", "build/faults.json", shorten)
main = PROGRAM.main
