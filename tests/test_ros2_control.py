"""The configuration for ros2_control names the joints and the topic of the arm."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from posor.ros_names import JOINT_STATES_TOPIC
from posor_bringup.arms import load_checked_arm

CONFIG = Path(__file__).resolve().parent.parent / "ros2_ws/src/posor_ros2_control/config/five_axis.ros2_control.xacro"
XACRO = "{http://www.ros.org/wiki/xacro}"


def test_the_configuration_names_the_joints_and_the_topic_of_the_arm() -> None:
    arm, root = load_checked_arm("five_axis"), ET.parse(CONFIG).getroot()  # noqa: S314  a file of the repository
    (control,) = root.iter("ros2_control")
    joints = [each.attrib["name"] for each in control.iter(f"{XACRO}measured_joint")]
    assert joints == [joint.name for joint in arm.chain().joints]
    (topic,) = control.iter("param")
    assert topic.text == f"/{arm.name}/{JOINT_STATES_TOPIC}"
    (included,) = root.iter(f"{XACRO}include")
    assert arm.urdf.as_posix().endswith(included.attrib["filename"].removeprefix("$(find posor_bringup)/"))
