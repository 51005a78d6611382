# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Starts all nodes of an arm: chain_node, and posor_node and driver_node of each joint.

``ros2 launch posor_bringup arm.launch.py arm:=five_axis`` or ``arm:=path/of/arm.yaml``. Further parameters of all
drivers: ``driver_parameters:='simulated.sag:=false simulated.noise:=false'``. ``view:=rviz`` or ``view:=plotjuggler``
starts that tool with a view of the arm, ``view:=foxglove`` the bridge for Foxglove; ``view_folder`` receives the views.
Two arms of one name: ``namespace:=cell1 frame_prefix:=cell1/`` each, or ``PushRosNamespace`` around this file.

As with ``bringup``, the launch ends if a node ends, except for a driver that has played all its scans (exit code 0).
No node is started again: a chain without a joint, or a joint that lost its count, needs a person.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, RegisterEventHandler, Shutdown
from launch.event_handlers import OnShutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from posor.chain.arm_file import CHAIN_NODE
from posor_bringup.arm_programs import endpoint_frame_of, frame_prefix_of, full_name
from posor_bringup.arms import check_arm
from posor_bringup.bringup_options import parse_driver_parameters
from posor_bringup.graph_observer import GraphObserver, enclave_of_arm
from posor_bringup.tool_views import VIEWS, write_views

if TYPE_CHECKING:
    from collections.abc import Mapping

    from launch import LaunchContext, LaunchDescriptionEntity
    from launch.events.process import ProcessExited


def view_nodes(view: str, files: Mapping[str, Path]) -> list[Node]:
    """Return the node of a tool with its view."""
    if view == "rviz":
        return [Node(package="rviz2", executable="rviz2", arguments=["-d", str(files["rviz"])])]
    if view == "plotjuggler":
        return [Node(package="plotjuggler", executable="plotjuggler", arguments=["-l", str(files["plotjuggler"])])]
    return [Node(package="foxglove_bridge", executable="foxglove_bridge")]


def end_of_node(event: ProcessExited, _context: LaunchContext) -> Shutdown:
    """Return the end of the launch, because a node has ended."""
    return Shutdown(reason=f"{event.process_name} ended with exit code {event.returncode}")


def end_of_driver(event: ProcessExited, context: LaunchContext) -> Shutdown | None:
    """Return the end of the launch, unless a driver has played all its scans."""
    return end_of_node(event, context) if event.returncode else None


def arm_nodes(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """Return the nodes of the arm, and of the view."""

    def value(argument: str) -> str:
        return str(LaunchConfiguration(argument).perform(context))

    pushed = context.launch_configurations.get("ros_namespace", "")  # by PushRosNamespace
    prefix = value("frame_prefix")
    view, files = value("view"), [Path(path) for path in value("params_file").split()]
    namespace = f"{pushed.rstrip('/')}/{value('namespace').lstrip('/')}"
    with GraphObserver(enclave_of_arm(value("arm"), namespace, CHAIN_NODE)) as graph:
        checked = check_arm(
            value("arm"),
            namespace=namespace,
            drivers=value("drivers") == "true",
            driver_parameters=parse_driver_parameters(value("driver_parameters")),
            chain_parameters={"frame_prefix": prefix} if prefix else {},
            parameters={"use_sim_time": value("use_sim_time") == "true"},
            parameter_files=files,
        )
        arm, programs = checked.arm, checked.programs
        claim = graph.claim(arm.namespace, endpoint_frame_of(programs))
        graph.refuse_running([full_name(program) for program in programs])
    tools: list[LaunchDescriptionEntity] = [
        RegisterEventHandler(OnShutdown(on_shutdown=lambda _event, _context: claim.close()))
    ]
    if view != "none":
        folder = Path(value("view_folder")) / arm.namespace.lstrip("/")
        folder.mkdir(parents=True, exist_ok=True)
        views = write_views(arm, folder, frame_prefix_of(programs))
        tools += [LogInfo(msg=f"views of {arm.name}: {folder}"), *view_nodes(view, views)]
    return tools + [
        Node(
            package=program.package,
            executable=program.executable,
            namespace=program.namespace,
            parameters=[dict(program.parameters)],
            ros_arguments=["--enclave", program.enclave],
            on_exit=end_of_driver if program.ends else end_of_node,
            output="screen",
        )
        for program in programs
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("arm", default_value="five_axis", description="name or path of an arm file"),
            DeclareLaunchArgument("namespace", default_value="", description="namespace around that of the arm"),
            DeclareLaunchArgument("frame_prefix", default_value="", description="prefix of the frames of chain_node"),
            DeclareLaunchArgument("drivers", default_value="true", choices=["true", "false"]),
            DeclareLaunchArgument("driver_parameters", default_value="", description="name:=value name:=value ..."),
            DeclareLaunchArgument("params_file", default_value="", description="ROS parameter files of the nodes"),
            DeclareLaunchArgument("view", default_value="none", choices=["none", *VIEWS]),
            DeclareLaunchArgument("view_folder", default_value="build/views", description="folder for views"),
            DeclareLaunchArgument("use_sim_time", default_value="false", choices=["true", "false"]),
            OpaqueFunction(function=arm_nodes),
        ]
    )
