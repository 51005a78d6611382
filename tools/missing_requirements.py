# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""List the locked libraries that are missing in an environment which sees an installed ROS.

The set-up calls this script with the Python of the virtual environment, which has pip. Arguments: TARGET, then .in
and .txt files of requirements/; of two versions in .txt files the later counts. The script walks the dependencies of
the libraries in the .in files. It keeps installed libraries that are recent enough, and writes the locked version of
every other library to TARGET. Dependencies of a new library are known after its installation: repeat until TARGET is
empty.
"""

from __future__ import annotations

import importlib.metadata
import sys
from pathlib import Path

from pip._vendor.packaging.requirements import Requirement
from pip._vendor.packaging.utils import canonicalize_name

NEVER_REPLACED = {"numpy"}  # the installed ROS messages are compiled against the numpy of their system


def marker_applies(requirement: Requirement, extras: set[str]) -> bool:
    """Return whether the marker of a requirement holds here, for a library installed with these extras."""
    return requirement.marker is None or any(requirement.marker.evaluate({"extra": extra}) for extra in extras | {""})


def find_missing(named: list[Requirement], locked: dict[str, str]) -> set[str]:
    """Return the canonical names of the libraries that are absent or too old.

    Args:
        named: Libraries that the project names.
        locked: Version of each library in the lock files, by canonical name. Other libraries are ignored.

    """
    queue = [(requirement, {""}) for requirement in named]
    missing: set[str] = set()
    visited: set[str] = set()
    while queue:
        requirement, extras = queue.pop()
        name = str(canonicalize_name(requirement.name))
        if str(requirement) in visited or name not in locked or not marker_applies(requirement, extras):
            continue
        visited.add(str(requirement))
        try:
            version = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            missing.add(name)
            continue
        recent_enough = requirement.specifier.contains(version, prereleases=True) or version == locked[name]
        if not recent_enough and name not in NEVER_REPLACED:
            missing.add(name)
            continue
        requirements = importlib.metadata.requires(name) or []
        queue += [(Requirement(text), set(requirement.extras)) for text in requirements]
    return missing


def read_entries(files: list[Path], suffix: str) -> list[str]:
    """Return the lines of the files with a suffix, without comments."""
    lines = [line for file in files if file.suffix == suffix for line in file.read_text(encoding="utf-8").splitlines()]
    return [entry for line in lines if (entry := line.partition("#")[0].strip())]


def main() -> None:
    """Write the target file."""
    target, *files = map(Path, sys.argv[1:])
    pins = [line.split("==") for line in read_entries(files, ".txt")]
    locked = {str(canonicalize_name(name)): version for name, version in pins}
    missing = find_missing([Requirement(line) for line in read_entries(files, ".in")], locked)
    target.write_text("".join(f"{name}=={locked[name]}\n" for name in sorted(missing)), encoding="utf-8")


if __name__ == "__main__":
    main()
