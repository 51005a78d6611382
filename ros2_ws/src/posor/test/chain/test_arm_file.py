from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from posor.chain.arm_file import load_arm_file
from posor.errors import CalibrationError, ChainError

if TYPE_CHECKING:
    from pathlib import Path

URDF = """<robot name="two">
  <link name="base"/><link name="t1"/><link name="r2"/><link name="t2"/>
  <joint name="shoulder" type="floating"><parent link="base"/><child link="t1"/></joint>
  <joint name="beam" type="fixed"><parent link="t1"/><child link="r2"/><origin xyz="0.5 0 0" rpy="0 0 0"/></joint>
  <joint name="elbow" type="floating"><parent link="r2"/><child link="t2"/></joint>
</robot>
"""
GOOD = """\
format: posor_arm
version: 1
name: two
provenance: {source: test, method: none, date: none}
urdf: two.urdf
endpoint_frame: t2
joints:
  shoulder: {calibration: calibrations/shoulder.yaml}
  elbow: {calibration: calibrations/elbow.yaml, session: morning}
driver:
  source: bag
  parameters: {bag.path: recorded, rate: 0.5}
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "two.urdf").write_text(URDF, encoding="utf-8")
    return tmp_path / "arm.yaml"


def test_paths_are_relative_to_the_arm_file(path: Path) -> None:
    path.write_text(GOOD, encoding="utf-8")
    arm = load_arm_file(path)
    folder = path.parent
    assert (arm.name, arm.urdf, arm.endpoint_frame) == ("two", folder / "two.urdf", "t2")
    assert (arm.beams, arm.scenario) == (None, None)
    assert dict(arm.calibrations) == {name: folder / f"calibrations/{name}.yaml" for name in ("shoulder", "elbow")}
    assert dict(arm.sessions) == {"shoulder": "", "elbow": "morning"}
    assert arm.driver.parameters == {"bag.path": "recorded", "rate": 0.5}
    assert [joint.name for joint in arm.chain().joints] == ["shoulder", "elbow"]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "name: two",
            "name: /two",
            "line 3, key name: name '/two'; expected a letter, then letters, digits and underscores",
        ),
        ("name: two", "name: two words", "line 3, key name: name 'two words'; expected a letter"),
        ("source: bag", "source: simulated", "line 1: key 'scenario' is missing; expected the simulator's scenario"),
        ("urdf: two.urdf\n", "", "key 'urdf' is missing"),
        ("calibration: calibrations/shoulder.yaml", "file: shoulder.yaml", "unknown key 'file'"),
        (
            "rate: 0.5",
            "rate: {value: 0.5}",
            "key driver.parameters.rate: {'value': 0.5}; expected true, false, a number",
        ),
    ],
)
def test_a_wrong_arm_file_is_refused_with_its_line(path: Path, old: str, new: str, sentence: str) -> None:
    assert old in GOOD
    path.write_text(GOOD.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(CalibrationError) as caught:
        load_arm_file(path)
    assert str(caught.value).startswith(str(path))
    assert sentence in str(caught.value)


@pytest.mark.parametrize("name", ["five_axis", "none.yaml", "."])
def test_a_missing_arm_file_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        load_arm_file(tmp_path / name)
    assert str(caught.value) == (
        f"arm file {tmp_path / name}: does not exist; expected the path of an arm file, "
        "such as share/posor_bringup/arms/five_axis/arm.yaml."
    )


def test_its_joints_are_the_floating_joints_of_the_urdf(path: Path) -> None:
    path.write_text(GOOD.replace("  elbow: {", "  wrist: {"), encoding="utf-8")
    with pytest.raises(ChainError) as caught:
        load_arm_file(path).chain()
    assert str(caught.value) == (
        f"{path}: joints shoulder, wrist; expected shoulder, elbow, the floating joints of {path.parent / 'two.urdf'}."
    )


def test_a_calibration_is_read_with_its_session(path: Path) -> None:
    path.write_text(GOOD, encoding="utf-8")
    with pytest.raises(CalibrationError, match=r"calibration file .*elbow\.yaml: cannot be read"):
        load_arm_file(path).calibration("elbow")
