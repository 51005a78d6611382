# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The configuration for ros2_control: names of the arm, and keys and types that ros2_control of Jazzy knows."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml
from posor.correction.joint_correction import CorrectionLimits
from posor.ros_names import JOINT_STATES_TOPIC
from posor_bringup.arms import load_checked_arm

CONFIG = Path(__file__).resolve().parent.parent / "config"
DEAD_TIME_S, ERROR = 0.12, 1e-3  # of the robot [s], of a joint [rad]
XACRO = "{http://www.ros.org/wiki/xacro}"
ROOT = ET.parse(CONFIG / "five_axis.ros2_control.xacro").getroot()  # noqa: S314  a file of the repository


def controllers_of(name: str) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node in a file."""
    sections = yaml.safe_load((CONFIG / name).read_text(encoding="utf-8"))
    return {node.rpartition("/")[2]: section["ros__parameters"] for node, section in sections.items()}


CONTROLLERS = controllers_of("controllers.yaml")
CORRECTION = controllers_of("correction_controllers.yaml")
FILES = {"controllers.yaml": CONTROLLERS, "correction_controllers.yaml": CORRECTION}
# Parameters by node, of the branches jazzy: controller_manager/src/controller_manager_parameters.yaml of ros2_control,
# joint_state_broadcaster/src/joint_state_broadcaster_parameters.yaml, pid_controller/src/pid_controller.yaml and
# joint_trajectory_controller/src/joint_trajectory_controller_parameters.yaml of ros2_controllers.
TEXTS = list[str]
PID_GAINS: dict[str, object] = {
    **dict.fromkeys(("p", "i", "d", "u_clamp_max", "u_clamp_min", "feedforward_gain", "error_deadband"), float),
    "antiwindup_strategy": str,
    "angle_wraparound": bool,
}
PARAMETERS: dict[str, dict[str, object]] = {
    "controller_manager": {"update_rate": int, "enforce_command_limits": bool, "handle_exceptions": bool},
    "joint_state_broadcaster": {
        "use_local_topics": bool,
        "joints": TEXTS,
        "extra_joints": TEXTS,
        "interfaces": TEXTS,
        "frame_id": str,
        "use_urdf_to_filter": bool,
        "publish_dynamic_joint_states": bool,
    },
    "joint_trajectory_controller": {
        **dict.fromkeys(("joints", "command_joints", "command_interfaces", "state_interfaces"), TEXTS),
        "interpolate_from_desired_state": bool,
    },
    "angle_controller": {
        **dict.fromkeys(("dof_names", "reference_and_state_dof_names", "reference_and_state_interfaces"), TEXTS),
        "command_interface": str,
        "enable_feedforward": bool,
        "gains": PID_GAINS,
    },
}
PLUGINS = {
    "joint_state_broadcaster/JointStateBroadcaster",
    "joint_trajectory_controller/JointTrajectoryController",
    "pid_controller/PidController",
    "joint_state_topic_hardware_interface/JointStateTopicSystem",
}
# Elements of <ros2_control> by their parent (hardware_interface/src/component_parser.cpp), parameters of the plugin
# (joint_state_topic_hardware_interface/README.md), and interfaces of its joints.
ELEMENTS = {"ros2_control": {"hardware", "joint"}, "hardware": {"plugin", "param"}, "joint": {"state_interface"}}
PARAMS = {"joint_commands_topic", "joint_states_topic", "trigger_joint_command_threshold", "sum_wrapped_joint_states"}


def is_of(value: object, kind: object) -> bool:
    if kind == TEXTS:
        return isinstance(value, list) and all(isinstance(each, str) for each in value)
    return type(value) is kind


def test_names_of_joints_and_topic_are_those_of_the_arm() -> None:
    arm = load_checked_arm("five_axis")
    (control,) = ROOT.iter("ros2_control")
    joints = [joint.name for joint in arm.chain().joints]
    assert [each.attrib["name"] for each in control.iter(f"{XACRO}measured_joint")] == joints
    assert [each.text for each in control.iter("param")] == [f"{arm.namespace}/{JOINT_STATES_TOPIC}"]
    (included,) = ROOT.iter(f"{XACRO}include")
    assert arm.urdf.as_posix().endswith(included.attrib["filename"].removeprefix("$(find posor_bringup)/"))
    assert CONTROLLERS["joint_state_broadcaster"]["joints"] == joints


@pytest.mark.parametrize(("file", "node"), [(file, node) for file, content in FILES.items() for node in content])
def test_parameters_are_known_and_of_their_types(file: str, node: str) -> None:
    own = dict(FILES[file][node])
    controllers = {name: own.pop(name) for name in set(own) & set(FILES[file])}
    if gains := own.pop("gains", None):
        assert list(gains) == own["dof_names"]
        assert all(is_of(value, PID_GAINS[name]) for each in gains.values() for name, value in each.items())
    for name, value in own.items():
        assert is_of(value, PARAMETERS[node][name]), name
    for name, content in controllers.items():
        assert content["type"] in PLUGINS, name
    if node == "joint_state_broadcaster":  # one of the two alone has no effect
        assert own.keys() >= {"joints", "interfaces"}


def test_every_section_is_of_the_manager_or_of_a_controller_that_it_loads() -> None:
    for controllers in FILES.values():
        manager = controllers["controller_manager"]
        assert {name for name in controllers if name not in manager} == {"controller_manager"}
    assert {name for controllers in FILES.values() for name in controllers} == PARAMETERS.keys()


def test_the_chain_takes_the_measured_joints_and_is_stable_with_its_dead_time() -> None:
    trajectory, angles = CORRECTION["joint_trajectory_controller"], CORRECTION["angle_controller"]
    joints = CONTROLLERS["joint_state_broadcaster"]["joints"]
    assert trajectory["joints"] == angles["reference_and_state_dof_names"] == joints
    assert trajectory["command_joints"] == [f"angle_controller/{name}" for name in joints]
    assert len(angles["dof_names"]) == len(joints)
    rate = CORRECTION["controller_manager"]["update_rate"]
    delay = round(DEAD_TIME_S * rate)  # measured = offset a dead time ago, plus a constant error
    for gains in angles["gains"].values():
        offsets = [0.0] * (delay + 1)
        for _ in range(4 * rate):
            offsets.append(offsets[-1] + gains["i"] / rate * (ERROR - offsets[-1 - delay]))
        assert gains["u_clamp_max"] == -gains["u_clamp_min"] == CorrectionLimits().max_offset
        assert max(offsets) < 1.001 * ERROR
        assert offsets[rate:] == pytest.approx([ERROR] * (len(offsets) - rate), rel=0.05)


def test_description_has_only_elements_and_interfaces_of_the_plugin() -> None:
    (control,) = ROOT.iter("ros2_control")
    assert control.attrib == {"name": "posor", "type": "system"}
    (macro,) = ROOT.iter(f"{XACRO}macro")
    for parent in (control, *control.iter("hardware"), *macro.iter("joint")):
        named = {child.tag for child in parent if not child.tag.startswith(XACRO)}
        assert named <= ELEMENTS[parent.tag]
    assert [each.text for each in control.iter("plugin")] == [
        "joint_state_topic_hardware_interface/JointStateTopicSystem"
    ]
    assert {each.attrib["name"] for each in control.iter("param")} <= PARAMS
    (interface,) = macro.iter("state_interface")
    assert [interface.attrib["name"]] == CONTROLLERS["joint_state_broadcaster"]["interfaces"]
