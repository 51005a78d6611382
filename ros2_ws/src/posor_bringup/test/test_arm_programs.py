# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from posor.arm_names import find_arm, installed_arms
from posor.bags.reprocess_command import parser, tasks_of
from posor.bags.reprocess_task import Settings
from posor.chain.arm_file import conflicting_parameters, load_arm_file
from posor.errors import CalibrationError, ChainError, NodeError, ParameterError, PosorError, SeveralErrors
from posor.node_parameters import RECORDING
from posor_bringup.arm_programs import arm_programs, endpoint_frame_of
from posor_bringup.arms import load_checked_arm
from posor_bringup.bringup_options import parse_driver_parameters
from posor_lab.harness.case_tables import refusal
from posor_lab.harness.rig_files import share

JOINTS = ["base_swivel", "shoulder", "elbow", "wrist_roll", "wrist_yaw"]

PARAMETERS = """  source: bag
  parameters:
    bag.path: '{folder}/bags/{arm}_{joint}'
    bag.other_topics: ['/{arm}/truth/{joint}']
    rate: 2.0"""


@pytest.fixture
def rig_copy(tmp_path: Path) -> Path:
    folder = tmp_path / "own"
    shutil.copytree(share() / "arms" / "test_rig", folder)
    return folder


def change(folder: Path, pattern: str, new: str, file: str = "arm.yaml") -> None:
    path = folder / file
    text, count = re.subn(pattern, new, path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert count, pattern
    path.write_text(text, encoding="utf-8")


def test_installed_arms_are_consistent() -> None:
    assert {"five_axis", "six_axis", "test_rig"} <= set(installed_arms())
    for name in installed_arms():
        arm = load_checked_arm(name)
        assert arm.name == name
        programs = arm_programs(arm)
        assert len(programs) == 1 + 2 * len(arm.calibrations)
        for program in programs:
            assert program.command()  # raises if the executable is not installed


def test_five_axis_arm() -> None:
    arm = load_checked_arm("five_axis")
    programs = arm_programs(
        arm,
        driver_parameters={"simulated.sag": False},
        chain_parameters={"max_wait": 2.0},
        parameters={"use_sim_time": True},
    )
    assert [program.name for program in programs] == [
        "chain_node",
        *(f"{joint}/posor_node" for joint in JOINTS),
        *(f"{joint}/driver_node" for joint in JOINTS),
    ]
    chain, elbow, driver = programs[0], programs[3], programs[-1]
    folder = find_arm("five_axis").resolve().parent
    assert chain.namespace == "/five_axis"
    assert chain.parameters == {
        "urdf": str(folder / "five_axis.urdf"),
        "endpoint_frame": "endpoint",
        "beams": str(folder / "beams.yaml"),
        **arm.chain_parameters,
        "max_wait": 2.0,
        "use_sim_time": True,
    }
    assert elbow.namespace == "/five_axis/elbow"
    assert elbow.parameters == {
        "calibration": str(folder / "calibrations" / "elbow.yaml"),
        "session": "",
        "use_sim_time": True,
    }
    assert driver.namespace == "/five_axis/wrist_yaw"
    assert driver.parameters == {
        "source": "simulated",
        "simulated.arm": str(find_arm("five_axis").resolve()),
        "simulated.joint": "wrist_yaw",
        "simulated.sag": False,
        "use_sim_time": True,
    }
    assert [program.ends for program in programs] == [False] * 6 + [True] * 5


def test_driver_parameters_of_a_launch_argument_go_to_all_drivers() -> None:
    parameters = parse_driver_parameters("simulated.sag:=false  simulated.cycles:=2")
    assert parameters == {"simulated.sag": False, "simulated.cycles": 2}
    programs = arm_programs(load_checked_arm("five_axis"), driver_parameters=parameters)
    assert [program.parameters["simulated.sag"] for program in programs if program.ends] == [False] * 5
    assert parse_driver_parameters("") == {}
    given = parse_driver_parameters("time.exposure_offsets:=[0.0,1.0e-5] bag.topics:=[a,b]")
    assert given == {"time.exposure_offsets": [0.0, 1e-5], "bag.topics": ["a", "b"]}
    assert str(refusal(ParameterError, parse_driver_parameters, "simulated.sag=false")) == (
        "launch argument 'driver_parameters': 'simulated.sag=false' is not a parameter, name:=value."
    )


def test_drivers_can_be_left_out() -> None:
    programs = arm_programs(load_checked_arm("five_axis"), drivers=False)
    assert {program.executable for program in programs} == {"chain_node", "posor_node"}


@pytest.mark.parametrize(
    ("parameters", "frame"),
    [
        ({}, "endpoint"),
        ({"frame_prefix": "cell1/"}, "cell1/endpoint"),
        ({"tf_rate": 10.0}, "endpoint"),
        ({"tf_rate": 0.0}, ""),
    ],
)
def test_the_frame_on_tf_is_that_of_the_endpoint(parameters: dict[str, str | float], frame: str) -> None:
    programs = arm_programs(load_checked_arm("five_axis"), chain_parameters=parameters)
    assert endpoint_frame_of(programs) == frame
    assert endpoint_frame_of(programs[1:]) == ""


def test_placeholders_are_filled_in_for_every_joint(rig_copy: Path) -> None:
    change(rig_copy, "^  source: simulated$", PARAMETERS)
    driver = arm_programs(load_arm_file(rig_copy / "arm.yaml"))[-1]
    assert driver.parameters == {
        "source": "bag",
        "bag.path": f"{rig_copy}/bags/test_rig_joint1",
        "bag.other_topics": ["/test_rig/truth/joint1"],
        "rate": 2.0,
        **RECORDING,
    }
    restamped = arm_programs(load_arm_file(rig_copy / "arm.yaml"), driver_parameters={"restamp": True})[-1]
    assert not restamped.parameters.keys() & RECORDING.keys()
    change(rig_copy, r"\{joint\}", "{joints}")
    with pytest.raises(
        ParameterError, match=r"key driver\.parameters\.bag\.path: '\{joints\}' is an unknown placeholder; "
    ):
        arm_programs(load_arm_file(rig_copy / "arm.yaml"))


def test_the_angles_of_the_posors_do_not_confirm_themselves(rig_copy: Path) -> None:
    own = "    parameters: {encoder.sigma: 0.001, encoder.topic: '{namespace}/joint_states'}"
    change(rig_copy, "^  joint1: .*$", f"  joint1:\n    calibration: calibrations/joint1.yaml\n{own}")
    chain = "chain:\n  parameters: {encoders.topic: joint_states, encoders.sigma: [1.0e-6]}\njoints:"
    change(rig_copy, "^joints:", chain)
    with pytest.raises(SeveralErrors) as caught:
        arm_programs(load_arm_file(rig_copy / "arm.yaml"))
    topics = {"encoder.topic: /test_rig/joint_states", "encoders.topic: joint_states"}
    expected = "expected encoders; these are the POSORs' own angles."
    assert {str(each).partition("node: ")[2] for each in caught.value.parts} == {f"{t}; {expected}" for t in topics}


def test_chain_node_takes_lists_of_numbers(rig_copy: Path) -> None:
    change(rig_copy, "^joints:", "chain:\n  parameters: {encoders.topic: drive, encoders.sigma: [1.0e-6]}\njoints:")
    assert arm_programs(load_arm_file(rig_copy / "arm.yaml"))[0].parameters["encoders.sigma"] == [1e-6]
    change(rig_copy, r"\[1.0e-6\]", "[1.0e-6, a]")
    assert "a list of texts or one of numbers" in str(refusal(CalibrationError, load_arm_file, rig_copy / "arm.yaml"))


def test_unknown_parameter_of_chain_node_is_reported_with_its_line(rig_copy: Path) -> None:
    path = rig_copy / "arm.yaml"
    change(rig_copy, "^joints:", "chain:\n  parameters:\n    aceleration_window: 0.1\njoints:")
    line = path.read_text(encoding="utf-8").splitlines().index("    aceleration_window: 0.1") + 1
    error = refusal(NodeError, arm_programs, load_arm_file(path))
    place = f"{path}, line {line}, key chain.parameters.aceleration_window"
    assert str(error) == (
        f"{place}: node chain_node, parameter 'aceleration_window': there is no such parameter; "
        "expected perhaps 'acceleration_window'."
    )
    assert error.exit_code == 2
    with pytest.raises(NodeError, match=re.escape(place)):
        tasks_of(parser().parse_args(["bag", "--arm", str(path)]))
    change(rig_copy, "aceleration_window: 0.1", "use_sim_time: true")
    assert arm_programs(load_arm_file(path))[0].parameters["use_sim_time"] is True
    assert Settings.of_arm(load_arm_file(path)).load_chain() is not None  # offline there is no clock


def test_parameters_of_a_joint_go_to_its_posor_node(rig_copy: Path) -> None:
    path = rig_copy / "arm.yaml"
    own = "    parameters: {encoder.sigma: 0.001, encoder.topic: /test_rig/encoders}"
    change(rig_copy, "^  joint1: .*$", f"  joint1:\n    calibration: calibrations/joint1.yaml\n{own}")
    chain, posor, _ = arm_programs(load_arm_file(path))
    assert (posor.parameters["encoder.sigma"], posor.parameters["encoder.topic"]) == (0.001, "/test_rig/encoders")
    assert not [name for name in chain.parameters if name.startswith("encoder")]
    line = path.read_text(encoding="utf-8").splitlines().index(own) + 1
    for wrong, says in (("0.001", "'encoder.sigma'"), ("encoder.sigma", "there is no such parameter")):
        change(rig_copy, wrong, "-1.0" if wrong == "0.001" else "encoder.sgma")
        with pytest.raises(NodeError, match=re.escape(f"{path}, line {line}, key joints.joint1.parameters")) as caught:
            arm_programs(load_arm_file(path))
        assert says in str(caught.value)
        assert "node joint1/posor_node" in str(caught.value)


@pytest.mark.parametrize(
    ("below", "name", "value"),
    [
        ("joint1", "calibration", "nowhere.yaml"),
        ("joint1", "session", "monday"),
        ("", "urdf", "other.urdf"),
        ("", "beams", "other.yaml"),
        ("", "endpoint_frame", "tip"),
        ("", "commissioning", "commissioning.yaml"),
    ],
)
def test_a_parameter_does_not_replace_a_file_of_the_arm(rig_copy: Path, below: str, name: str, value: str) -> None:
    path = rig_copy / "arm.yaml"
    node = f"/test_rig/{below}/posor_node" if below else "/test_rig/chain_node"
    own = {each.executable: each.parameters for each in arm_programs(load_arm_file(path))}[node.rpartition("/")[2]]
    stated = own.get(name, "")
    file = rig_copy / "parameters.yaml"
    file.write_text(f"{node}: {{ros__parameters: {{{name}: '{stated}'}}}}\n", encoding="utf-8")
    arm_programs(load_arm_file(path), parameter_files=[file])  # as 'ros2 param dump' writes it
    if Path(str(stated)).is_file():
        other = rig_copy / "other" / ".." / Path(str(stated)).relative_to(rig_copy.resolve())
        (rig_copy / "other").mkdir()
        file.write_text(f"{node}: {{ros__parameters: {{{name}: '{other}'}}}}\n", encoding="utf-8")
        arm_programs(load_arm_file(path), parameter_files=[file])  # another spelling of the same file
    file.write_text(f"{node}: {{ros__parameters: {{{name}: {value}}}}}\n", encoding="utf-8")
    error = refusal(NodeError, arm_programs, load_arm_file(path), parameter_files=[file])
    assert (f"{file}, line 1" in error.where, f"{name}: '{value}'" in error.what) == (True, True)
    entry = f"parameters: {{{name}: {value}}}"
    if below:
        change(rig_copy, "^  joint1: .*$", f"  joint1:\n    calibration: calibrations/joint1.yaml\n    {entry}")
    else:
        change(rig_copy, "^joints:", f"chain:\n  {entry}\njoints:")
    error = refusal(NodeError, arm_programs, load_arm_file(path))
    assert str(path) in error.where
    with pytest.raises(NodeError, match=re.escape(error.where)):
        tasks_of(parser().parse_args(["bag", "--arm", str(path)]))


def test_a_text_that_is_no_path_is_not_the_file_of_the_arm(rig_copy: Path) -> None:
    arm = load_arm_file(rig_copy / "arm.yaml")
    (error,) = conflicting_parameters(arm, "joint1", {"calibration": "no\0path", "session": ""})
    assert error.parameter == "calibration"


@pytest.mark.parametrize("name", ["use_sim_time", "start_type_description_service"])
def test_a_switch_of_rclpy_is_true_or_false(rig_copy: Path, name: str) -> None:
    file = rig_copy / "parameters.yaml"
    file.write_text(f"/**: {{ros__parameters: {{{name}: 'true'}}}}\n", encoding="utf-8")
    with pytest.raises(SeveralErrors) as refused:
        arm_programs(load_arm_file(rig_copy / "arm.yaml"), parameter_files=[file])
    assert [name in part.what or name in part.where for part in refused.value.parts] == [True] * 3  # of each node
    change(rig_copy, "^joints:", f"chain:\n  parameters: {{{name}: 'true'}}\njoints:")
    with pytest.raises(NodeError, match=f"parameter '{name}'"):
        tasks_of(parser().parse_args(["bag", "--arm", str(rig_copy)]))


def test_arm_is_found_by_name_file_or_folder(rig_copy: Path) -> None:
    assert find_arm("test_rig") == share() / "arms" / "test_rig" / "arm.yaml"
    assert find_arm(str(rig_copy)) == find_arm(str(rig_copy / "arm.yaml")) == rig_copy / "arm.yaml"
    with pytest.raises(ParameterError, match=r"^arm 'six_fingers': no such arm; expected the path of an arm file, or"):
        find_arm("six_fingers")


@pytest.mark.parametrize("file", ["test_rig.urdf", "beams.yaml", "calibrations/joint1.yaml", "scenario.yaml"])
def test_missing_file_is_named(rig_copy: Path, file: str) -> None:
    (rig_copy / file).unlink()
    with pytest.raises((CalibrationError, ChainError, ParameterError), match=re.escape(file)):
        load_checked_arm(str(rig_copy))


NO_JOINT7 = r"arm\.yaml, line \d+, key joints: joints joint7; expected joint1, the floating joints of .*urdf"
OTHER_JOINT = "measures 'joint1_target' in 'joint2_receiving'; expected 'joint1_target' in"


@pytest.mark.parametrize(
    ("file", "pattern", "replacement", "kind", "says"),
    [
        ("arm.yaml", "^  joint1:", "  joint7:", ChainError, NO_JOINT7),
        ("scenario.yaml", "^seed: .*$", "sead: 1", CalibrationError, "unknown key 'sead'"),
        ("scenario.yaml", "^  joint1:", "  joint9:", CalibrationError, "expected one of joint9"),
        ("calibrations/joint1.yaml", "joint1_receiving", "joint2_receiving", ChainError, OTHER_JOINT),
    ],
)
def test_a_file_that_does_not_fit_is_refused(
    rig_copy: Path, file: str, pattern: str, replacement: str, kind: type[PosorError], says: str
) -> None:
    change(rig_copy, pattern, replacement, file)
    with pytest.raises(kind, match=says):
        load_checked_arm(str(rig_copy))
