from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from posor.chain.arm_file import load_arm_file
from posor.errors import CalibrationError, ChainError
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
def test_a_missing_arm_file_is_named(tmp_path: Path, name: str) -> None:
    assert str(refusal(CalibrationError, load_arm_file, tmp_path / name)) == (
        f"arm file {tmp_path / name}: does not exist; expected the path of an arm file, "
        "such as share/posor_bringup/arms/five_axis/arm.yaml."
    )


def test_its_joints_are_the_floating_joints_of_the_urdf(path: Path) -> None:
    replace(path, "  elbow: {", "  wrist: {")
    error = refusal(ChainError, load_arm_file(path).chain)
    line = next(n for n, each in enumerate(path.read_text(encoding="utf-8").splitlines(), 1) if each == "joints:")
    assert error.where == f"{path}, line {line}, key joints"
    assert error.expected == f"shoulder, elbow, the floating joints of {path.parent / 'two.urdf'}"
