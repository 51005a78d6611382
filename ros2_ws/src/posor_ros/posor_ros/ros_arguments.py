# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Command-line arguments that give a node its namespace, name, remappings and parameters."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


def ros_arguments(
    parameters: Mapping[str, object],
    namespace: str = "",
    *,
    name: str = "",
    remappings: Mapping[str, str] | None = None,
    enclave: str = "",
) -> list[str]:
    """Return ``--ros-args`` and the arguments of a node; an empty text is left out.

    ``remappings`` give the new name by the old one; ``enclave`` is the identity of the process in a network with SROS
    2.
    """
    rules = {"__ns": namespace, "__node": name} | dict(remappings or {})
    arguments = ["--ros-args"]
    for old, new in rules.items():
        arguments += ["-r", f"{old}:={new}"] if new else []
    arguments += ["--enclave", enclave] if enclave else []
    for parameter, value in parameters.items():
        arguments += ["-p", f"{parameter}:={yaml_text(value)}"]
    return arguments


def yaml_text(value: object) -> str:
    """Return a value as YAML: as JSON, except for numbers that are not finite."""
    if isinstance(value, list):
        return f"[{', '.join(map(yaml_text, value))}]"
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else f"{'-' if value < 0.0 else ''}.inf"
    return json.dumps(value)


def split_ros_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the other arguments of a command line, and those between ``--ros-args`` and ``--``.

    For a program that is no node: unlike rclpy it takes no ``name:=value`` elsewhere for an old remap rule.
    """
    parts: tuple[list[str], list[str]] = ([], [])
    of_ros = False
    for each in arguments:
        if each == "--ros-args" or (each == "--" and of_ros):
            of_ros = each != "--"
        else:
            parts[of_ros].append(each)
    return parts
