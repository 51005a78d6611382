# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Runs the nodes of a composition file in one process: ``ros2 launch posor_bringup compose.launch.py file:=FILE``."""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Return the argument and the process."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("file", description="composition file"),
            Node(
                package="posor_estimator",
                executable="compose",
                arguments=[LaunchConfiguration("file")],
                output="screen",
            ),
        ]
    )
