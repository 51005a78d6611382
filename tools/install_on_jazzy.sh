#!/bin/sh
# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
# Install the libraries of POSOR beside an official ROS 2 Jazzy on Ubuntu 24.04, and build the workspace for them:
# what rosdep knows from apt, the rest by pip into ros2_ws/venv, which sees the libraries of the system.
set -eu
cd "$(dirname "$0")/.."
sudo=$([ "$(id -u)" = 0 ] || echo sudo)
if [ "${ROS_DISTRO:-}" != jazzy ]; then
    echo "tools/install_on_jazzy.sh: ROS_DISTRO is '${ROS_DISTRO:-}', expected 'jazzy': source /opt/ros/jazzy/setup.sh first." >&2
    exit 2
fi
$sudo apt-get update
$sudo apt-get install -y python3-venv python-is-python3 python3-colcon-common-extensions python3-rosdep
[ -e /etc/ros/rosdep/sources.list.d/20-default.list ] || $sudo rosdep init
rosdep update --rosdistro jazzy
rosdep install --from-paths ros2_ws/src --ignore-src --rosdistro jazzy -y

# Into the system itself pip installs nothing (PEP 668). The lock file keeps the numpy of the system, for which the ROS
# messages are compiled.
python3 -m venv --system-site-packages ros2_ws/venv
touch ros2_ws/venv/COLCON_IGNORE
ros2_ws/venv/bin/python -m pip install -r requirements/noble.txt

# `python -m colcon` writes the Python of the environment into the first line of every program; plain `colcon` would
# write /usr/bin/python3, which does not find its libraries.
cd ros2_ws
venv/bin/python -m colcon build --symlink-install
echo "Ready: source ros2_ws/install/setup.bash, then e.g. ros2 run posor_bringup bringup five_axis"
