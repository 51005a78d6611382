# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The configuration for ros2_control: names of the arm, and keys and types that ros2_control of Jazzy knows."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml
from posor.ros_names import JOINT_STATES_TOPIC
from posor_bringup.arms import load_checked_arm

CONFIG = Path(__file__).resolve().parent.parent / "config"
XACRO = "{http://www.ros.org/wiki/xacro}"
ROOT = ET.parse(CONFIG / "five_axis.ros2_control.xacro").getroot()  # noqa: S314  a file of the repository
CONTROLLERS: dict[str, dict[str, Any]] = {
    name.rpartition("/")[2]: section["ros__parameters"]
    for name, section in yaml.safe_load((CONFIG / "controllers.yaml").read_text(encoding="utf-8")).items()
}
# Parameters by node, of the branches jazzy: controller_manager/src/controller_manager_parameters.yaml of ros2_control,
# joint_state_broadcaster/src/joint_state_broadcaster_parameters.yaml of ros2_controllers.
TEXTS = list[str]
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
}
PLUGINS = {
    "joint_state_broadcaster/JointStateBroadcaster",
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


@pytest.mark.parametrize("node", PARAMETERS)
def test_parameters_are_known_and_of_their_types(node: str) -> None:
    own = dict(CONTROLLERS[node])
    controllers = {name: own.pop(name) for name in set(own) & set(CONTROLLERS)}
    for name, value in own.items():
        assert is_of(value, PARAMETERS[node][name]), name
    for name, content in controllers.items():
        assert content["type"] in PLUGINS, name
    if node == "joint_state_broadcaster":  # one of the two alone has no effect
        assert own.keys() >= {"joints", "interfaces"}


def test_every_section_is_of_the_manager_or_of_a_controller_that_it_loads() -> None:
    manager = CONTROLLERS["controller_manager"]
    assert {name for name in CONTROLLERS if name not in manager} == {"controller_manager"}
    assert CONTROLLERS.keys() == PARAMETERS.keys()


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
