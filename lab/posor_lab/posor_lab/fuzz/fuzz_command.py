"""fuzz: damages messages and files at random and counts what the programs make of them.

The exit code is 0 only if no damaged message gives a wrong pose, the nodes answer every sound message and their memory
does not grow, and every reader of a file gives a result or one sentence. The rule is in ``docs/integrity.md``.
"""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING, Any

from posor_bringup.arms import load_checked_arm

from posor_lab.fuzz.file_fuzz import FileFailureError, fuzz_files, readers
from posor_lab.fuzz.message_fuzz import ScanFuzz, TransformFuzz, fuzz_simulation
from posor_lab.fuzz.node_fuzz import NodeFuzzError, NodeScanFuzz, NodeTransformFuzz
from posor_lab.reports.findings import Finding, Findings, Verdict
from posor_lab.reports.trial_program import Option, TrialProgram

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from posor_lab.fuzz.message_fuzz import MessageFuzz
    from posor_lab.fuzz.node_fuzz import NodeFuzz
    from posor_lab.reports.trial_program import Trial

STEP = 1000
"""Mutations between two looks at Ctrl-C."""
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

if __name__ == "__main__":
    sys.exit(main())
