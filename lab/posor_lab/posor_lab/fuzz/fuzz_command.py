# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""fuzz: damages messages and files at random and counts the results of the programs.

The exit code is 0 only if no damaged message gives a wrong pose, the nodes answer every sound message and their memory
does not grow, and every reader of a file gives a result or one sentence. The rule is in ``docs/integrity.md``.
"""

from __future__ import annotations

import math
import random
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from posor.calibration.calibration_file import load_calibration
from posor.chain.arm_file import load_arm_file
from posor.chain.beams_file import load_beams
from posor.chain.kinematic_chain import load_chain
from posor.errors import PosorError
from posor.tables.table_readings import load_readings
from posor_bringup.arms import load_checked_arm
from posor_drivers.simulator.scenario import load_scenario

from posor_lab.fuzz.message_fuzz import ScanFuzz, TransformFuzz, fuzz_simulation, mutate
from posor_lab.fuzz.node_fuzz import NodeFuzzError, NodeScanFuzz, NodeTransformFuzz
from posor_lab.harness.rig_files import share
from posor_lab.reports.findings import Finding, Findings, Verdict
from posor_lab.reports.trial_program import Option, TrialProgram
from posor_lab.thesis_data import data_path

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from posor_lab.fuzz.message_fuzz import MessageFuzz
    from posor_lab.fuzz.node_fuzz import NodeFuzz
    from posor_lab.reports.trial_program import Trial

LONGEST_S = 5.0  # time that a reader may take


@dataclass
class FileCount:
    """Numbers of damaged files."""

    refused: int = 0  # with one sentence
    read: int = 0
    slowest_s: float = 0.0


class FileFailureError(Exception):
    """A reader raised another error than one for the user, or took too long."""


def readers() -> dict[str, tuple[Path, Callable[[Path], object]]]:
    """Return a file of each format and its reader, by name."""
    arm = share() / "arms" / "five_axis"
    return {
        "calibration": (arm / "calibrations" / "elbow.yaml", load_calibration),
        "beams": (arm / "beams.yaml", load_beams),
        "arm": (arm / "arm.yaml", load_arm_file),
        "scenario": (arm / "scenario.yaml", load_scenario),
        "urdf": (arm / "five_axis.urdf", lambda path: load_chain(path, "endpoint")),
        "table": (data_path("ymo_input.csv"), lambda path: load_readings(path, data_path("table_map.yaml"))),
        "table map": (data_path("table_map.yaml"), lambda path: load_readings(data_path("ymo_input.csv"), path)),
    }


def fuzz_files(name: str, mutations: int, seed: int, folder: Path) -> FileCount:
    """Damage a file of a format, a key of ``readers``, several times and read it; the damaged file is in ``folder``.

    Raises FileFailureError: the reader failed; names the format and keeps the file.
    """
    (source, read), count = readers()[name], FileCount()
    content, path = source.read_bytes(), folder / f"damaged{source.suffix}"
    chance = random.Random(f"{name} {seed}")  # noqa: S311  damage
    for _ in range(mutations):
        data = content
        for _ in range(chance.randint(1, 4)):
            data = mutate(data, chance)
        path.write_bytes(data)
        began, where = time.monotonic(), f"{path}: {name}"
        try:
            read(path)
            count.read += 1
        except PosorError as error:
            if "\n" in str(error):
                raise FileFailureError(f"{where}: more than one line: {error}") from error
            count.refused += 1
        except Exception as error:
            raise FileFailureError(f"{where}: {type(error).__name__}: {error}") from error
        took_s = time.monotonic() - began
        if took_s > LONGEST_S:
            raise FileFailureError(f"{where}: took {took_s:.1f} s; expected at most {LONGEST_S:g} s")
        count.slowest_s = max(count.slowest_s, took_s)
    return count


STEP = 1000  # mutations between two looks at Ctrl-C
MOST_GROWTH_MB = 1.0
OPTIONS = (
    Option("--arm", "six_axis", "a simulated arm"),
    Option("--scans", 1_000_000, "damaged raw scans", least=0),
    Option("--transforms", 1_000_000, "damaged transforms", least=0),
    Option("--nodes", 50_000, "damaged raw scans, and transforms, to nodes", least=0),
    Option("--files", 1000, "damaged files of each format", least=0),
    Option("--seed", 1985, "of the damage"),
)


def run_fuzz(trial: Trial) -> tuple[Findings, Mapping[str, Any]]:
    """Damage messages, messages to nodes, and files; return the findings."""
    options, simulation = trial.options, fuzz_simulation(load_checked_arm(trial.options.arm))
    joints, found, seed = simulation.joints, list[Finding](), options.seed
    scans, nodes = options.scans // len(joints), options.nodes // len(joints)
    for joint in joints if scans else ():
        found += _fuzz_messages(f"raw scans of {joint}", ScanFuzz(simulation, joint, seed), scans, trial)
    if options.transforms:
        found += _fuzz_messages("transforms", TransformFuzz(simulation, seed), options.transforms, trial)
    for joint in joints if nodes else ():
        found += _fuzz_node(f"posor_node of {joint}", NodeScanFuzz(simulation, joint, seed), nodes, trial)
    if options.nodes:
        found += _fuzz_node("chain_node", NodeTransformFuzz(simulation, seed), options.nodes, trial)
    for name in readers() if options.files else ():
        found += _fuzz_format(name, trial)
    return Findings(tuple(found)), {}


def _fuzz_messages(name: str, fuzz: MessageFuzz, mutations: int, trial: Trial) -> Iterator[Finding]:
    with trial.progress.stage(name, mutations) as on_done:
        for begin in range(0, mutations, STEP):
            step = min(STEP, mutations - begin)
            fuzz.run(step)
            on_done(step)
    yield _count_finding(name, fuzz)


def _fuzz_node(name: str, fuzz: NodeFuzz, mutations: int, trial: Trial) -> Iterator[Finding]:
    with trial.progress.stage(name, mutations) as on_done:
        try:
            fuzz.run(mutations, trial.folder, on_done)
        except NodeFuzzError as error:
            yield Finding(name, str(error), verdict=Verdict.FAILS)
    yield _count_finding(name, fuzz.fuzz)
    yield Finding(
        f"{name}: slowest answer", f"{fuzz.slowest_s:.2f} s", remark=f"{fuzz.acknowledged} faults acknowledged"
    )
    growth = f"{name}: growth of the memory"
    if math.isnan(fuzz.growth_mb):
        yield Finding(growth, "not judged", remark="too few messages")
    else:
        holds, limit = fuzz.growth_mb < MOST_GROWTH_MB, f"below {MOST_GROWTH_MB:g} MB"
        yield Finding.judged(growth, f"{fuzz.growth_mb:.2f} MB", limit, holds=holds)


def _fuzz_format(name: str, trial: Trial) -> Iterator[Finding]:
    mutations = trial.options.files
    with trial.progress.stage(f"{name} files", mutations) as on_done:
        try:
            count = fuzz_files(name, mutations, trial.options.seed, trial.folder)
        except FileFailureError as error:
            yield Finding(f"{name} files", str(error), verdict=Verdict.FAILS)
            return
        on_done(mutations)
    text = f"{count.refused} refused, {count.read} read, the slowest in {count.slowest_s:.2f} s"
    yield Finding.judged(f"{name} files", text, "a result or one sentence", holds=True)


def _count_finding(name: str, fuzz: MessageFuzz) -> Finding:
    counts = ", ".join(f"{count} {outcome}" for outcome, count in fuzz.outcomes.items())
    text, wrong = f"{fuzz.outcomes.total()} damaged: {counts}", fuzz.outcomes["wrong"]
    return Finding.judged(name, text, "0 wrong", holds=wrong == 0, if_fails="; ".join(fuzz.examples))


DESCRIPTION = "Damage messages and files and count wrong poses."
PROGRAM = TrialProgram("fuzz", DESCRIPTION, OPTIONS, run_fuzz, "damaged messages and files")
main = PROGRAM.main
