# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Mutations of the model: the table fits the source, the unchanged model agrees, a few mutations are noticed."""

from __future__ import annotations

import importlib.util
import json
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any

import pytest
from posor import chain
from posor.chain import measuring_beam
from posor.errors import ParameterError, PosorError
from posor_lab.mutations import mutations_command
from posor_lab.mutations.model_checks import CheckResult
from posor_lab.mutations.mutated_model import MutatingFinder, Mutation, load_mutations
from posor_lab.mutations.mutations_command import OPTIONS, main, mutation_finding, run_mutation, select_mutations
from posor_lab.reports.findings import Verdict
from posor_lab.reports.trial_program import parse_options

SIGN_OF_THE_SAG = load_mutations()[0]


def test_each_mutation_changes_one_place_of_the_source() -> None:
    mutations = load_mutations()
    assert len({each.name for each in mutations}) == len(mutations) >= 20
    for each in mutations:
        spec = importlib.util.find_spec(each.module)
        assert spec is not None
        assert spec.origin is not None
        source = Path(spec.origin).read_text(encoding="utf-8")
        assert source.count(each.text) == 1, each.name
        compile(source.replace(each.text, each.by), spec.origin, "exec")
        assert each.by not in source or each.by in each.text, each.name


def test_a_mutation_from_end_to_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mutations_command, "QUICK", 1)
    output = tmp_path / "mutations.json"
    assert main(["--quick", "--seed", "1", "--output", str(output)]) == 0
    assert "1 of 1 mutations noticed (simulated)" in capsys.readouterr().out
    figures: dict[str, Any] = json.loads(output.read_text())
    assert len(figures["mutations"]) == 1
    assert all(check["figure"] <= check["limit"] for check in figures["unchanged"].values())


def test_a_mutation_without_effect_is_not_noticed() -> None:
    checks = run_mutation(SIGN_OF_THE_SAG._replace(by=SIGN_OF_THE_SAG.text + "  # unchanged"))
    finding = mutation_finding(SIGN_OF_THE_SAG, checks)
    assert (finding.verdict, finding.computed) == (Verdict.FAILS, "not noticed")


def test_a_mutation_that_does_not_fit_the_source_is_an_error() -> None:
    spec = MutatingFinder(SIGN_OF_THE_SAG._replace(text="no such text")).find_spec(
        measuring_beam.__name__, chain.__path__
    )
    assert spec is not None
    assert isinstance(spec.loader, SourceFileLoader)
    with pytest.raises(SystemExit, match=r"0 places of posor\.chain.measuring_beam have the text; expected 1"):
        spec.loader.get_code(measuring_beam.__name__)
    with pytest.raises(PosorError, match="no_such_name"):
        run_mutation(SIGN_OF_THE_SAG._replace(by="gain[:3] = no_such_name"))


def test_the_finding_shows_the_clearest_checks_and_counts_the_others() -> None:
    checks = {
        "a": CheckResult(0.2, 0.1),
        "b": CheckResult(float("inf"), 0.0, "no pose"),
        "c": CheckResult(3.0, 0.1),
        "d": CheckResult(0.0, 0.1),
    }
    finding = mutation_finding(Mutation("m", "", "", ""), checks)
    assert finding.computed == "noticed by c (3), a (0.2) and 1 more"


def test_an_unknown_row_is_refused() -> None:
    with pytest.raises(ParameterError, match="--rows 'sag of the moon'"):
        select_mutations(parse_options("mutations", "", OPTIONS, ["--rows", "sag of the moon"]))
