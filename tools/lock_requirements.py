# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Resolve requirements/*.in, the libraries that the project names, and write exact versions to requirements/*.txt.

All lists are resolved together first, so that they share one version of each library. A list with exact versions of its
own (noble.in) takes no part; its lock differs from the others by these versions only, if the libraries allow it.
The oldest supported Python resolves the lists, because libraries drop old Pythons but keep new ones.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile

from environment import THIS, exit_with

OLDEST_PYTHON = (3, 11)
FOLDER = THIS.root / "requirements"
PIN = re.compile(r"^([\w.-]+)==", re.MULTILINE)
HEADER = "# Written by `make lock` from {name}.in: edit that file, not this one.\n"


def resolve_versions(*options: str) -> dict[str, str]:
    """Return the distributions and versions that pip would install into an empty environment."""
    pip = [sys.executable, "-I", "-m", "pip", "install", "--dry-run", "--ignore-installed", "-qq", "--report", "-"]
    report = subprocess.run(
        [*pip, "--disable-pip-version-check", *options], stdout=subprocess.PIPE, text=True, check=True
    )
    distributions = [entry["metadata"] for entry in json.loads(report.stdout)["install"]]
    return {distribution["name"]: distribution["version"] for distribution in distributions}


def format_pins(versions: dict[str, str]) -> str:
    """Return one line ``name==version`` for each distribution, in alphabetical order."""
    return "".join(f"{name}=={versions[name]}\n" for name in sorted(versions, key=str.lower))


def main() -> int:
    """Resolve and write all lock files."""
    if sys.version_info[:2] != OLDEST_PYTHON:
        oldest = ".".join(map(str, OLDEST_PYTHON))
        sys.stderr.write(f"make lock: needs Python {oldest}, the oldest supported: make lock PYTHON=python{oldest}.\n")
        return 1
    lists = {path: PIN.findall(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.in"))}
    all_versions = resolve_versions(*(f"--requirement={path}" for path, own in lists.items() if not own))
    for path, own in lists.items():
        with tempfile.NamedTemporaryFile("w", encoding="utf-8", suffix=".txt") as constraints:
            constraints.write(format_pins({name: all_versions[name] for name in all_versions.keys() - set(own)}))
            constraints.flush()
            versions = resolve_versions(f"--requirement={path}", f"--constraint={constraints.name}")
        path.with_suffix(".txt").write_text(HEADER.format(name=path.stem) + format_pins(versions), encoding="utf-8")
        sys.stdout.write(f"{path.stem}: {len(versions)} libraries\n")
    return 0


if __name__ == "__main__":
    exit_with("make lock", main)
