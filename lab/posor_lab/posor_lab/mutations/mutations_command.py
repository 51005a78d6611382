# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""mutations: breaks the estimator's model in every way of a table, and finds the check that notices.

First the unchanged model passes all checks against the independent truth: that states the agreement of both models.
Then each mutation of ``mutation_table.yaml`` runs in a process of its own. The exit code is 0 only if every check holds
for the unchanged model and at least one fails for each mutation. All scans are simulated.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posor.errors import ParameterError, PosorError
from rich.console import Console

from posor_lab.lab_output import check_writable, write_json
from posor_lab.mutations.model_checks import CheckResult, run_checks
from posor_lab.mutations.mutated_model import Mutation, load_mutations
from posor_lab.reports.findings import (
    FIGURE_HEADINGS,
    Finding,
    Findings,
    exit_code_of_findings,
    print_findings,
    print_verdict,
)
from posor_lab.reports.trial_program import Option, parse_options

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Mapping, Sequence

QUICK = 3  # mutations of ``--quick``
TIMEOUT_S = 600.0  # of one mutation
OPTIONS = (
    Option("--rows", "", "only mutations whose name contains TEXT"),
    Option("--quick", default=False, text=f"{QUICK} mutations that the seed selects, without covariances"),
    Option("--seed", 1985, "of the selection", least=0),
    Option("--output", Path("build/mutations.json"), "file of the figures"),
)


def select_mutations(options: Namespace) -> list[Mutation]:
    """Return the mutations that the options name.

    Raises ParameterError: no row of the table contains the text.
    """
    mutations = [each for each in load_mutations() if options.rows in each.name]
    if not mutations:
        raise ParameterError(f"--rows '{options.rows}'", where="mutations", expected="part of the name of a mutation")
    if options.quick:
        short = [each for each in mutations if not each.covariances]
        return random.Random(options.seed).sample(short, min(QUICK, len(short)))  # noqa: S311  not for secrets
    return mutations


def run_mutation(mutation: Mutation) -> dict[str, CheckResult]:
    """Return the checks with a mutated model.

    Raises PosorError: the mutation does not fit the present source, or is not Python.
    """
    process = subprocess.run(
        [sys.executable, "-m", "posor_lab.mutations.mutated_model"],
        input=json.dumps(mutation._asdict()),
        env=os.environ | {"POSOR_KERNELS": "python"},
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT_S,
    )
    if process.returncode:
        last = process.stderr.strip().rpartition("\n")[2]
        raise PosorError(last, where=f"mutation '{mutation.name}'", expected="a source that runs")
    return {name: CheckResult(*values) for name, values in json.loads(process.stdout).items()}


def agreement_findings(checks: Mapping[str, CheckResult]) -> list[Finding]:
    """Return a finding for each check of the unchanged model."""
    return [
        Finding.judged(name, result.error or f"{result.figure:.2g}", f"at most {result.limit:g}", holds=result.holds)
        for name, result in checks.items()
    ]


def mutation_finding(mutation: Mutation, checks: Mapping[str, CheckResult]) -> Finding:
    """Return the finding of a mutation: the checks that notice, the most clear ones first."""
    failed = {name: each for name, each in checks.items() if not each.holds}
    clearest = sorted(
        failed, key=lambda name: (bool(failed[name].error), -failed[name].figure / (failed[name].limit or 1.0))
    )
    shown = [f"{name} ({'no result' if failed[name].error else f'{failed[name].figure:.2g}'})" for name in clearest[:2]]
    more = f" and {len(failed) - 2} more" if len(failed) > 2 else ""  # noqa: PLR2004
    seen = f"noticed by {', '.join(shown)}{more}" if failed else "not noticed"
    return Finding.judged(mutation.name, seen, "noticed", holds=bool(failed))


def _run(options: Namespace) -> Findings:
    console = Console(highlight=False, soft_wrap=True)
    check_writable(options.output)
    mutations = select_mutations(options)
    unchanged = run_checks(covariances=not options.quick)
    agreement = Findings(tuple(agreement_findings(unchanged)))
    print_findings(agreement, console, "agreement of the estimator with the independent truth", FIGURE_HEADINGS)
    findings, figures = [*agreement.findings], dict[str, Any]()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for mutation, checks in zip(mutations, pool.map(run_mutation, mutations), strict=True):
            findings.append(mutation_finding(mutation, checks))
            figures[mutation.name] = {name: each._asdict() for name, each in checks.items()}
            print_findings(Findings((findings[-1],)), console, "mutation", FIGURE_HEADINGS)
    write_json(options.output, {"unchanged": {k: v._asdict() for k, v in unchanged.items()}, "mutations": figures})
    result = Findings(tuple(findings))
    noticed = sum(each.verdict.value == "holds" for each in findings[len(agreement.findings) :])
    console.print(f"{noticed} of {len(mutations)} mutations noticed (simulated)")
    print_verdict(result, console)
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    parse = partial(parse_options, "mutations", "Break the estimator's model and find who notices.", OPTIONS)
    return exit_code_of_findings(lambda: _run(parse(sys.argv[1:] if arguments is None else arguments)))
