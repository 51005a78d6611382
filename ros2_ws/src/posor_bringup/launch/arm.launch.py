"""Starts all nodes of an arm: chain_node, and posor_node and driver_node of each joint.

``ros2 launch posor_bringup arm.launch.py arm:=five_axis`` or ``arm:=path/of/arm.yaml``. Further parameters of all
drivers: ``driver_parameters:='simulated.sag:=false simulated.noise:=false'``. ``view:=rviz`` or ``view:=plotjuggler``
starts that tool with a view of the arm, ``view:=foxglove`` the bridge for Foxglove; ``view_folder`` receives the views.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from posor_bringup.arm_programs import full_name
from posor_bringup.arms import check_arm
from posor_bringup.bringup_options import parse_driver_parameters
from posor_bringup.graph_observer import GraphObserver
from posor_bringup.tool_views import VIEWS, write_views

if TYPE_CHECKING:
    from collections.abc import Mapping

    from launch import LaunchContext, LaunchDescriptionEntity


def view_nodes(view: str, files: Mapping[str, Path]) -> list[Node]:
    """Return the node of a tool with its view."""
    if view == "rviz":
        return [Node(package="rviz2", executable="rviz2", arguments=["-d", str(files["rviz"])])]
    if view == "plotjuggler":
        return [Node(package="plotjuggler", executable="plotjuggler", arguments=["-l", str(files["plotjuggler"])])]
    return [Node(package="foxglove_bridge", executable="foxglove_bridge")]


def arm_nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the nodes of the arm, and of the view."""

    def value(argument: str) -> str:
        return str(LaunchConfiguration(argument).perform(context))

    view, files = value("view"), [Path(path) for path in value("params_file").split()]
    with GraphObserver() as graph:
        checked = check_arm(
            value("arm"),
            drivers=value("drivers") == "true",
            driver_parameters=parse_driver_parameters(value("driver_parameters")),
            parameters={"use_sim_time": value("use_sim_time") == "true"},
            parameter_files=files,
        )
        arm, programs = checked.arm, checked.programs
        graph.refuse_running([full_name(program) for program in programs])
    tools: list[LaunchDescriptionEntity] = []
    if view != "none":
        folder = Path(value("view_folder")) / arm.name
        folder.mkdir(parents=True, exist_ok=True)
        views = write_views(arm, folder)
        tools = [LogInfo(msg=f"views of {arm.name}: {folder}"), *view_nodes(view, views)]
    return tools + [
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
            DeclareLaunchArgument("params_file", default_value="", description="ROS parameter files of the nodes"),
            DeclareLaunchArgument("view", default_value="none", choices=["none", *VIEWS]),
            DeclareLaunchArgument("view_folder", default_value="build/views", description="folder for views"),
            DeclareLaunchArgument("use_sim_time", default_value="false", choices=["true", "false"]),
            OpaqueFunction(function=arm_nodes),
        ]
    )
