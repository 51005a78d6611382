"""Correct the paths in the CMake files of the ROS wheels.

The wheels' exported targets hold the paths of the machine that built them: its Python headers and its site-packages.
Here they become those of the virtual environment at hand.
"""

from __future__ import annotations

import re
import sysconfig
from typing import TYPE_CHECKING

from environment import SetupError

if TYPE_CHECKING:
    from pathlib import Path

BUILDER = re.compile(r"/opt/python/cp3\d+-cp3\d+/(?P<kind>include|lib)/python3\.\d+(?P<site>/site-packages)?")


def rewrite_cmake_paths(venv: Path) -> int:
    """Rewrite every CMake file below ``share`` of a virtual environment.

    Args:
        venv: Virtual environment made by this interpreter.

    Returns:
        Number of files changed; 0 on a second call.

    Raises:
        SetupError: A path of the building machine is left that is neither headers nor site-packages.

    """
    headers = sysconfig.get_path("include")
    site_packages = sysconfig.get_path("purelib", "venv", vars={"base": str(venv)})
    changed = 0
    for file in sorted((venv / "share").rglob("*.cmake")):
        text = file.read_text(encoding="utf-8")
        fresh = BUILDER.sub(lambda match: headers if match["kind"] == "include" else site_packages, text)
        if "/opt/python/cp3" in fresh:
            raise SetupError(
                f"{file}: holds a path of the machine that built the wheel which this set-up cannot translate."
            )
        if fresh != text:
            file.write_text(fresh, encoding="utf-8")
            changed += 1
    return changed
