"""Starts all nodes of an arm: chain_node, and posor_node and driver_node of each joint.

``ros2 launch posor_bringup arm.launch.py arm:=five_axis`` or ``arm:=path/of/arm.yaml``. Further parameters of all
drivers: ``driver_parameters:='simulated.sag:=false simulated.noise:=false'``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from posor_bringup.arm_programs import arm_programs
from posor_bringup.arms import load_checked_arm
from posor_bringup.bringup_options import parse_driver_parameters

if TYPE_CHECKING:
    from launch import LaunchContext


def arm_nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes of the arm."""

    def value(argument: str) -> str:
        return str(LaunchConfiguration(argument).perform(context))

    programs = arm_programs(
        load_checked_arm(value("arm")),
        drivers=value("drivers") == "true",
        driver_parameters=parse_driver_parameters(value("driver_parameters")),
        parameters={"use_sim_time": value("use_sim_time") == "true"},
    )
    return [
        Node(
            package=program.package,
            executable=program.executable,
            namespace=program.namespace,
            parameters=[dict(program.parameters)],
            ros_arguments=["--enclave", program.enclave],
            output="screen",
        )
        for program in programs
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("arm", default_value="five_axis", description="name or path of an arm file"),
            DeclareLaunchArgument("drivers", default_value="true", choices=["true", "false"]),
            DeclareLaunchArgument("driver_parameters", default_value="", description="name:=value name:=value ..."),
            DeclareLaunchArgument("use_sim_time", default_value="false", choices=["true", "false"]),
            OpaqueFunction(function=arm_nodes),
        ]
    )
