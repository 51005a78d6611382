# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Replays a motion test of 1985 through driver, POSOR and chain.

``ros2 launch posor_bringup replay_1985.launch.py bag:=zmo calibration:=section84``
"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare
from posor.node_parameters import RECORDING

LOSSLESS = {"lossless": True, **RECORDING}


def generate_launch_description() -> LaunchDescription:
    """Return posor_node, chain_node and a driver_node that plays the bag once posor_node has subscribed."""
    share = FindPackageShare("posor_bringup")
    bag = LaunchConfiguration("bag")
    calibration = [share, "/config/slocum1985_", LaunchConfiguration("calibration"), ".yaml"]
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", default_value="ymo", choices=["ymo", "yzmo", "zmo"]),
            DeclareLaunchArgument("calibration", default_value="printed", choices=["printed", "section84"]),
            DeclareLaunchArgument("rate", default_value="1.0", description="1 is real time, 0 as fast as possible"),
            Node(
                package="posor_estimator",
                executable="posor_node",
                namespace="joint1",
                parameters=[
                    {
                        "calibration": ParameterValue(calibration, value_type=str),
                        "session": ParameterValue(bag, value_type=str),
                        **LOSSLESS,
                    }
                ],
                output="screen",
            ),
            Node(
                package="posor_estimator",
                executable="chain_node",
                parameters=[{"urdf": ParameterValue([share, "/urdf/slocum1985_rig.urdf"], value_type=str), **LOSSLESS}],
                output="screen",
            ),
            Node(
                package="posor_drivers",
                executable="driver_node",
                namespace="joint1",
                parameters=[
                    {
                        "source": "bag",
                        "bag.path": ParameterValue([share, "/bags/", bag], value_type=str),
                        "bag.other_topics": ["/truth/machining_centre"],
                        "rate": ParameterValue(LaunchConfiguration("rate"), value_type=float),
                        **LOSSLESS,
                    }
                ],
                output="screen",
            ),
        ]
    )
