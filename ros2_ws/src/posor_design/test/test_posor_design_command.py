# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor design posor: the written files load and agree, and each wrong option is refused."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from posor.arm_names import ARM_FILE
from posor.calibration.calibration_file import load_calibration
from posor.chain.arm_file import load_arm_file
from posor.errors import OutputError
from posor.estimation.posor import Posor
from posor_design.design_command import main
from posor_design.layout_geometry import LayoutKind
from posor_design.posor_design_page import verdict
from posor_design.posor_output import CALIBRATION, JOINT, output_files, write_design
from posor_design.requirement import load_requirement

from .layout_examples import BUMPS, RING_OF_LIGHTS, candidate, example, result_of

OPTIONS = ["--outside-diameter", "80 mm", "--translations", "2 um", "--angles", "20 urad"]

FIVE_AXIS = Path(__file__).resolve().parents[2] / "posor_bringup" / "arms" / "five_axis" / "arm.yaml"


REFUSALS = yaml.safe_load(Path(__file__).with_name("program_refusals.yaml").read_text(encoding="utf-8"))


@pytest.fixture
def one_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search one kind of layouts only, to save time."""
    monkeypatch.setattr("posor_design.layout_search.layout_kinds", lambda _requirement: [RING_OF_LIGHTS])


@pytest.mark.parametrize("kind", [RING_OF_LIGHTS, BUMPS], ids=lambda kind: kind.name)
def test_written_files_load_and_agree(tmp_path: Path, kind: LayoutKind) -> None:
    write_design(tmp_path, output_files(result_of(example(), candidate(kind)), candidate(kind)))
    arm, layout = load_arm_file(tmp_path / ARM_FILE), candidate(kind).layout
    (joint,) = arm.chain().joints
    calibration = arm.calibration(JOINT)
    assert (calibration.frames.parent, calibration.frames.child) == (joint.parent, joint.child)
    assert arm.chain().nominal_joint(JOINT, 0.0).translation[2] == pytest.approx(layout.gap)
    expected = Posor(layout.calibration(example())).stack
    stack = Posor(load_calibration(tmp_path / CALIBRATION)).stack
    np.testing.assert_allclose(stack.parameter_values, expected.parameter_values, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(stack.parameter_sigmas, expected.parameter_sigmas, rtol=1e-9)
    np.testing.assert_allclose(load_requirement(tmp_path / "requirement.yaml").sigmas, example().sigmas)
    figures = json.loads((tmp_path / "design.json").read_text(encoding="utf-8"))
    assert figures["chosen"]["standard_uncertainty"]["theta"] == pytest.approx(candidate(kind).sigmas[5])
    assert arm.chain().urdf.count(f'radius="{0.5 * layout.outside_diameter:.6g}"') == 2


def test_an_earlier_design_is_kept_without_force(tmp_path: Path) -> None:
    texts = {"a.txt": "one", "folder/b.txt": "two"}
    write_design(tmp_path, texts)
    with pytest.raises(OutputError, match=r"a\.txt exists already; expected another folder, or --force"):
        write_design(tmp_path, {**texts, "a.txt": "three"})
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "one"
    write_design(tmp_path, {"a.txt": "three"}, force=True)
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "three"


@pytest.mark.usefixtures("one_kind", "few_draws")
def test_the_command_writes_files_budget_and_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "out"
    assert main(["posor", *OPTIONS, "--uncertainty", "theta=15 urad", "--output", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "(simulated)" in printed
    assert "15 urad" in printed
    assert f"posor bringup {folder / ARM_FILE}" in printed
    assert {path.name for path in folder.iterdir()} == {
        *("arm.yaml", "posor.urdf", "scenario.yaml", "requirement.yaml", "design.html", "design.json"),
        *("calibrations", "budget"),
    }
    budget = json.loads((folder / "budget" / "budget.json").read_text(encoding="utf-8"))
    assert budget["quantities"]["theta"]["full_covariance"] < 15e-6
    page = (folder / "design.html").read_text(encoding="utf-8")
    assert page.index("<td>largest uncertainty of theta</td><td>15 urad</td>") < page.index("Chosen layout")
    assert "<td>motion of theta to either side</td><td>3.14 rad</td>" in page
    assert main(["posor", str(folder / "requirement.yaml"), "--output", str(folder)]) == 1
    assert "arm.yaml exists already" in capsys.readouterr().err
    assert main(["posor", str(folder / "requirement.yaml"), "--output", str(tmp_path / "again")]) == 0
    assert (tmp_path / "again" / CALIBRATION).read_bytes() == (folder / CALIBRATION).read_bytes()


@pytest.mark.parametrize(("command", "sentence"), REFUSALS)
def test_wrong_options_are_refused(
    command: str, sentence: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = {"SIZES": OPTIONS, "ARM": [str(FIVE_AXIS)], "NEEDS": ["--displacement", "9 um", "--orientation", "8 urad"]}
    arguments = [argument for word in shlex.split(command) for argument in words.get(word, [word])]
    assert main([*arguments, "--output", str(tmp_path / "out")]) in {1, 2}
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["posor", "arm"])
def test_a_folder_that_cannot_be_written_is_refused_before_the_search(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for searching in ("layout_search.LayoutSearch.run", "arm_design_command.allot"):
        monkeypatch.setattr(f"posor_design.{searching}", None)  # a search would raise a TypeError
    arm = ["arm", str(FIVE_AXIS), "--displacement", "20 um", "--orientation", "10 urad"]
    arguments = arm if command == "arm" else ["posor", *OPTIONS]
    assert main([*arguments, "--output", ""]) == 2
    assert "--output: ''; expected a folder" in capsys.readouterr().err
    (tmp_path / "file").write_text("kept", encoding="utf-8")
    for output in ("file", "file/out", f"{tmp_path}/file/a/b"):
        assert main([*arguments, "--output", output]) == 1
        assert f"{output}: cannot be written below" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_verdict_states_why_a_layout_was_chosen() -> None:
    shown = candidate()
    hidden = replace(shown, kind=BUMPS)
    causes = {shown.kind: ("growth of gaps",), BUMPS: ("growth of gaps", "reading: ring ring_1")}
    result = replace(result_of(example(), shown), feasible=(hidden, shown, hidden), preference="size", causes=causes)
    expected = (
        "1 of them leave the fewest causes unobservable, 1; these come first, and of these the chosen one is best"
    )
    assert f"{expected} in size." in verdict(result)


@pytest.mark.usefixtures("one_kind")
def test_an_infeasible_requirement_ends_with_its_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [*OPTIONS, "--range-gap", "4 mm", "--output", str(tmp_path / "out")]
    assert main(["posor", *arguments]) == 1
    refusal = capsys.readouterr().err
    assert "range.gap 4 mm: no layout fits with this range of motion; expected range.gap of at most" in refusal
    assert not (tmp_path / "out").exists()
