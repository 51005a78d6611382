# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""``driver_node`` for tests, as a program; a double underscore in a parameter's name stands for the dot."""

from __future__ import annotations

from typing import Any

from posor_lab.harness.program import Program, installed
from posor_ros.ros_arguments import ros_arguments

LOSSLESS: dict[str, Any] = {"lossless": True}


def driver_program(namespace: str = "/joint1", **parameters: object) -> Program:
    names = {name.replace("__", "."): value for name, value in parameters.items()}
    return Program([*installed("posor_drivers", "driver_node"), *ros_arguments(names, namespace)])
