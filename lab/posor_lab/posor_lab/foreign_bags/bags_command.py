# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""bags: generates bags as other writers and killed recorders leave them, reads and recovers each, and counts.

The exit code is 0 only if every valid bag is read whole, or read with the rest listed, every message that is whole is
recovered, and every invalid bag is read with a note or refused in one sentence. The record of what the generator wrote
is the judge, never another reader of this stack.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from posor_lab.foreign_bags.bag_judgement import Outcome, judge_reading, judge_recovery
from posor_lab.foreign_bags.generated_bag import generate_bag
from posor_lab.reports.findings import Finding, Findings
from posor_lab.reports.trial_program import Option, TrialProgram

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from posor_lab.reports.trial_program import Trial

EXAMPLES = 5  # wrong bags that are named
OPTIONS = (
    Option("--bags", 10_000, "generated bags", least=1),
    Option("--first", 0, "number of the first bag; each bag follows from seed and number", least=0),
    Option("--seed", 1985, "of the bags"),
)


def judge_bags(
    first: int, count: int, seed: int, on_done: Callable[[], object] = lambda: None
) -> tuple[Counter[Outcome], list[str]]:
    """Generate bags, read and recover them; return the number of each outcome and what is wrong, by bag."""
    outcomes, wrong = Counter[Outcome](), list[str]()
    for number in range(first, first + count):
        with TemporaryDirectory(prefix="posor-generated-") as folder:
            bag = generate_bag(Path(folder), f"{seed} {number}")
            judgements = [judge_reading(bag)]
            if bag.can_be_recovered:
                judgements.append(judge_recovery(bag, Path(folder) / "recovered"))
        outcomes.update(each.outcome for each in judgements)
        options = ", ".join([*bag.options, bag.fault])
        wrong += [f"bag {number} ({options}): {e.reason}" for e in judgements if e.outcome is Outcome.WRONG]
        on_done()
    return outcomes, wrong


def run_bags(trial: Trial) -> tuple[Findings, Mapping[str, Any]]:
    """Judge generated bags; return the findings."""
    options = trial.options
    with trial.progress.stage("bags", options.bags) as on_done:
        outcomes, wrong = judge_bags(options.first, options.bags, options.seed, lambda: on_done(1))
    findings = [Finding(each.value, f"{outcomes[each]}") for each in Outcome if each is not Outcome.WRONG]
    examples = "; ".join(wrong[:EXAMPLES])
    findings.append(Finding.none_of("short in silence, refused or recovered wrongly", len(wrong), if_fails=examples))
    return Findings(tuple(findings)), {}


DESCRIPTION = "Generate bags of other writers and of killed recorders, read and recover each."
PROGRAM = TrialProgram("bags", DESCRIPTION, OPTIONS, run_bags, "generated bags")
main = PROGRAM.main
