# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from posor.arm_names import installed_arms
from posor.chain.arm_file import load_arm_file
from posor.errors import CalibrationError, ChainError, ParameterError
from posor_lab.harness.case_tables import cases, edited, refusal


@pytest.fixture
def path(tmp_path: Path) -> Path:
    folder = shutil.copytree(Path(__file__).with_name("two_joints"), tmp_path / "arm")
    return folder / "arm.yaml"


def replace(path: Path, old: str, new: str) -> None:
    path.write_text(edited(path.read_text(encoding="utf-8"), old, new), encoding="utf-8")


def test_paths_are_relative_to_the_arm_file(path: Path) -> None:
    arm = load_arm_file(path)
    folder = path.parent
    assert (arm.name, arm.urdf, arm.endpoint_frame) == ("two", folder / "two.urdf", "t2")
    assert (arm.beams, arm.scenario) == (None, None)
    assert dict(arm.calibrations) == {name: folder / f"calibrations/{name}.yaml" for name in ("shoulder", "elbow")}
    assert dict(arm.sessions) == {"shoulder": "", "elbow": "morning"}
    assert arm.driver.parameters == {"bag.path": "recorded", "rate": 0.5}
    assert [joint.name for joint in arm.chain().joints] == ["shoulder", "elbow"]
    assert "elbow.yaml" in refusal(CalibrationError, arm.calibration, "elbow").where  # there is none


@pytest.mark.parametrize(**cases(__file__, "arm_mistakes.yaml"))
def test_a_wrong_arm_file_is_refused_with_its_line(path: Path, old: str, new: str, sentence: str) -> None:
    replace(path, old, new)
    error = refusal(CalibrationError, load_arm_file, path)
    assert error.where.startswith(str(path))
    assert sentence in str(error)


@pytest.mark.parametrize("name", ["five_axis", "none.yaml", "."])
def test_a_missing_arm_file_is_named(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    error = refusal(ParameterError, load_arm_file, tmp_path / name)
    assert str(error) == f"arm '{tmp_path / name}': no such arm; expected the path of an arm file."


def test_an_arm_is_found_by_name_in_the_first_workspace(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file or folder of the name comes first; an empty entry of the path is not the current folder."""
    workspaces = [path.parent / "over", path.parent / "under"]
    for n, workspace in enumerate([*workspaces, path.parent]):
        for name in ("both", f"only_{n}"):
            (folder := workspace / "share" / "cell" / "arms" / name).mkdir(parents=True)
            shutil.copy(path, folder / "arm.yaml")
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(["", *map(str, workspaces), "/nowhere"]))
    monkeypatch.chdir(path.parent)
    assert list(installed_arms()) == ["both", "only_0", "only_1"]
    assert load_arm_file("both").path == workspaces[0] / "share" / "cell" / "arms" / "both" / "arm.yaml"
    assert load_arm_file(Path("only_1")).path.is_relative_to(workspaces[1])
    (path.parent / "both").mkdir()
    shutil.copy(path, path.parent / "both" / "arm.yaml")
    assert load_arm_file("both").path == Path("both") / "arm.yaml"
    assert "expected the path of an arm file, or one of both, only_0, only_1." in str(
        refusal(ParameterError, load_arm_file, "bot")
    )


def test_its_joints_are_the_floating_joints_of_the_urdf(path: Path) -> None:
    replace(path, "  elbow: {", "  wrist: {")
    error = refusal(ChainError, load_arm_file(path).chain)
    line = next(n for n, each in enumerate(path.read_text(encoding="utf-8").splitlines(), 1) if each == "joints:")
    assert error.where == f"{path}, line {line}, key joints"
    assert error.expected == f"shoulder, elbow, the floating joints of {path.parent / 'two.urdf'}"
