# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Arms by name: the arm files that ROS packages install, and the argument ARM of all programs."""

from __future__ import annotations

import os
from pathlib import Path

from posor.errors import ParameterError

ARM_FILE = "arm.yaml"


def installed_arms() -> dict[str, Path]:
    """Return the arm files that packages install as ``share/PACKAGE/arms/NAME/arm.yaml``, by name.

    As everywhere in ROS, the first workspace on ``AMENT_PREFIX_PATH`` comes before the ones below it.
    """
    prefixes = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    files = [path for prefix in reversed(prefixes) for path in Path(prefix).glob(f"share/*/arms/*/{ARM_FILE}")]
    return {path.parent.name: path for path in sorted(files, key=lambda path: path.parent.name)}


def find_arm(arm: str | Path) -> Path:
    """Return the path of an arm file, from its path, its folder's path, or the name of an installed arm.

    Raises ParameterError: there is no such arm.
    """
    installed = installed_arms()
    for path in (Path(arm), Path(arm) / ARM_FILE, installed.get(str(arm))):
        if path is not None and path.is_file():
            return path
    expected = "the path of an arm file" + (f", or one of {', '.join(installed)}" if installed else "")
    raise ParameterError("no such arm", where=f"arm '{arm}'", expected=expected)


def describe_argument() -> str:
    """Return the help of an argument ARM, from which the completion of ``posor`` takes the names."""
    names = ", ".join(installed_arms())
    return "path of an arm file or its folder" + (f", or name of an installed arm: {names}" if names else "")
