# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Confirmation of a designed POSOR: a sound one is confirmed; a tightened requirement or optimistic file is not."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from posor_design.layout_evaluation import evaluate, extreme_poses
from posor_design.layout_geometry import LayoutKind, Shares, arrange
from posor_design.layout_search import SearchResult
from posor_design.posor_output import REQUIREMENT, output_files, requirement_text, write_design
from posor_design.requirement import Requirement, requirement_content
from posor_lab.accuracy.accuracy_command import confirm_design, main

DRAWS = 100
KIND = LayoutKind("light_ring", 3, 4, gap_outside=True)


@pytest.fixture(scope="module")
def requirement() -> Requirement:
    limits = dict.fromkeys(("x", "y", "gap"), 1e-6) | dict.fromkeys(("alpha", "beta", "theta"), 8e-6)
    motion = {"range.gap": 1e-4, "range.runout": 1e-4, "range.tilt": 1e-3, "range.rotation": 3.14}
    values = {**motion, "outside_diameter": 0.08, "scan_rate": 1000.0, "speed": 1.0}
    return Requirement.model_validate(requirement_content("confirmed", limits, 1.0, values))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, requirement: Requirement) -> Path:
    layout = arrange(requirement, KIND, 0.08, Shares(1.0, 0.0))
    assert layout is not None
    chosen = evaluate(requirement, KIND, layout, extreme_poses(requirement, layout.gap))
    result = SearchResult(requirement, chosen, (chosen,), (chosen,), chosen, 1, "electronics")
    folder = tmp_path_factory.mktemp("design")
    write_design(folder, output_files(result, chosen))
    return folder


@pytest.fixture(scope="module")
def sound(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[int, str, dict[str, Any]]:
    """Exit code, printed text and figures of the sound design."""
    output = tmp_path_factory.mktemp("sound") / "accuracy.json"
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        code = main(["--design", str(folder), "--scale", "0.05", "--output", str(output)])
    return code, printed.getvalue(), json.loads(output.read_text(encoding="utf-8"))["design"]


def test_a_sound_design_is_confirmed(sound: tuple[int, str, dict[str, Any]]) -> None:
    code, printed, figures = sound
    assert code == 0
    assert "All errors are within the requirement." in printed
    assert figures["draws"] == DRAWS
    assert figures["errors"]["theta"] < figures["required"]["theta"]


def test_a_tightened_requirement_is_not_confirmed(
    folder: Path, requirement: Requirement, sound: tuple[int, str, dict[str, Any]], tmp_path: Path
) -> None:
    theta = 0.7 * sound[2]["errors"]["theta"]
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    text = requirement_text(requirement.changed(uncertainty={"theta": theta}))
    (tmp_path / REQUIREMENT).write_text(text, encoding="utf-8")
    confirmation = confirm_design(tmp_path, DRAWS, 1)
    assert not confirmation.within
    assert not confirmation.confirmed


def test_errors_larger_than_stated_are_inconsistent(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from posor.estimation.estimate import Estimates  # noqa: PLC0415  only here
    from posor.estimation.posor import Posor  # noqa: PLC0415  only here

    original = Posor.estimate_each

    def optimistic(*arguments: Any) -> Any:
        found = original(*arguments)
        records = found._records.copy()
        records["systematic"] *= 0.25
        return Estimates(records, found._scans, found._explain)

    monkeypatch.setattr(Posor, "estimate_each", optimistic)
    assert not confirm_design(folder, DRAWS, 1).consistent


def test_a_missing_folder_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--design", str(tmp_path / "none"), "--output", str(tmp_path / "a.json")]) == 1
    assert "requirement.yaml" in capsys.readouterr().err
