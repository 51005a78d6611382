"""Starts all nodes of an arm: chain_node, and posor_node and driver_node of every joint.

``ros2 launch posor_bringup arm.launch.py arm:=five_axis`` or ``arm:=path/of/arm.yaml``; what all drivers get beside
what the arm file says: ``driver_parameters:='simulated.sag:=false simulated.noise:=false'``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from posor_bringup.arm_programs import arm_programs
from posor_bringup.arms import checked_arm
from posor_bringup.command_line import parameters_in

if TYPE_CHECKING:
    from launch import LaunchContext


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes that the arm file asks for."""
    use_sim_time = LaunchConfiguration("use_sim_time").perform(context) == "true"
    programs = arm_programs(
        checked_arm(LaunchConfiguration("arm").perform(context)),
        drivers=LaunchConfiguration("drivers").perform(context) == "true",
        driver_parameters=parameters_in(LaunchConfiguration("driver_parameters").perform(context)),
        parameters={"use_sim_time": use_sim_time},
    )
    return [
        Node(
            package=program.package,
            executable=program.executable,
            namespace=program.namespace,
            parameters=[dict(program.parameters)],
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
            OpaqueFunction(function=nodes),
        ]
    )
