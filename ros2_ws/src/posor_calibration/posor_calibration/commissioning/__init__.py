# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Commissioning of an arm: a plan of steps, their recording, and the checks of plugs, motions and files. No ROS."""
