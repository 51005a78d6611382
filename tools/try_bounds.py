# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Try POSOR with the lowest and with the newest versions of its libraries that the requirements admit: ``make bounds``.

pip installs both sets into virtual environments below ``build/bounds``, together with the plain packages ``posor`` and
``posor_design``.
There ``bounds_check.py`` must pass, and its poses must be those of this workspace. Exit code 1: a set fails.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LIBRARY, DESIGN = ROOT / "ros2_ws/src/posor", ROOT / "ros2_ws/src/posor_design"
FOLDER = ROOT / "build/bounds"
CHECK = ROOT / "tools/bounds_check.py"
BOUND = re.compile(r"(?P<name>[A-Za-z][\w-]*)>=(?P<lowest>[\d.]+)(?:,<(?P<limit>[\d.]+))?")
TOLERANCE = 1e-12
"""Largest difference of a position [m] and of a component of a quaternion."""


def bounds(path: Path) -> dict[str, re.Match[str]]:
    """Return the bounds that a list of requirements or a setup.cfg states, by library."""
    return {match["name"]: match for match in BOUND.finditer(path.read_text(encoding="utf-8"))}


def requirements() -> dict[str, list[str]]:
    """Return the two sets of requirements."""
    stated = bounds(ROOT / "requirements/base.in") | bounds(LIBRARY / "setup.cfg")
    lowest = [f"{name}=={match['lowest']}" for name, match in stated.items()]
    return {"lowest": lowest, "newest": [match.group() for match in stated.values()]}


def install(name: str, lines: list[str]) -> Path:
    """Install a set of requirements and the packages into a virtual environment of its own; return its Python."""
    venv = FOLDER / name / "venv"
    subprocess.run([sys.executable, "-I", "-m", "venv", str(venv)], check=True)
    pip = [
        str(venv / "bin/pip"),
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--prefer-binary",
        "--no-compile",
    ]
    subprocess.run([*pip, *lines, f"{LIBRARY}[reports,tables]", str(DESIGN)], check=True)
    return venv / "bin/python"


def poses(*command: str | Path) -> list[list[float]]:
    """Return the poses that a command prints in its last line."""
    run = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    found: list[list[float]] = json.loads(run.stdout.splitlines()[-1])
    return found


def largest_difference(one: list[list[float]], other: list[list[float]]) -> float:
    """Return the largest difference of corresponding numbers."""
    return max(abs(a - b) for row, others in zip(one, other, strict=True) for a, b in zip(row, others, strict=True))


def main() -> int:
    """Try both sets, or the named ones."""
    known, failed = poses(sys.executable, CHECK, "--poses"), False
    for name, lines in requirements().items():
        if name not in (sys.argv[1:] or requirements()):
            continue
        shutil.rmtree(FOLDER / name, ignore_errors=True)
        try:
            difference = largest_difference(poses(install(name, lines), "-I", CHECK), known)
        except (subprocess.CalledProcessError, ValueError, IndexError) as error:
            print(f"make bounds: the {name} versions fail, {error}")
            failed = True
            continue
        failed |= difference > TOLERANCE
        print(f"make bounds: the {name} versions differ by {difference:g} from this workspace; allowed: {TOLERANCE:g}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
