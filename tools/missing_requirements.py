"""List the locked libraries that an environment which sees an installed ROS still lacks.

Called by the set-up with the environment's own Python, which has pip: TARGET, then .in and .txt files of requirements/.
Walks the dependencies of the libraries named in the .in files; those that are there and recent enough are kept, for
the others the locked version goes into TARGET. What a new library needs is known once it is installed: call again
until TARGET stays empty.
"""

from __future__ import annotations

import importlib.metadata
import sys
from pathlib import Path

from pip._vendor.packaging.requirements import Requirement
from pip._vendor.packaging.utils import canonicalize_name

LINKED_AGAINST = {"numpy"}  # the installed ROS messages are compiled for the numpy that came with them: never replaced


def applies(requirement: Requirement, extras: set[str]) -> bool:
    """Tell whether a requirement's marker holds here, for a library installed with these extras."""
    return requirement.marker is None or any(requirement.marker.evaluate({"extra": extra}) for extra in extras | {""})


def missing(named: list[Requirement], locked: dict[str, str]) -> set[str]:
    """Return the canonical names of the libraries that are absent or too old.

    Args:
        named: The libraries that the project names.
        locked: Version of each library in the lock files, by canonical name; others are not ours to install.

    """
    queue = [(requirement, {""}) for requirement in named]
    lacking: set[str] = set()
    seen: set[str] = set()
    while queue:
        requirement, extras = queue.pop()
        name = str(canonicalize_name(requirement.name))
        if str(requirement) in seen or name not in locked or not applies(requirement, extras):
            continue
        seen.add(str(requirement))
        try:
            version = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            lacking.add(name)
            continue
        fits = requirement.specifier.contains(version, prereleases=True)
        if not fits and version != locked[name] and name not in LINKED_AGAINST:
            lacking.add(name)
            continue
        needs = importlib.metadata.requires(name) or []
        queue += [(Requirement(text), set(requirement.extras)) for text in needs]
    return lacking


def entries(files: list[Path], suffix: str) -> list[str]:
    """Return the lines of the files of one kind, without comments."""
    lines = [line for file in files if file.suffix == suffix for line in file.read_text(encoding="utf-8").splitlines()]
    return [entry for line in lines if (entry := line.partition("#")[0].strip())]


def main() -> None:
    """Write the target file."""
    target, *files = map(Path, sys.argv[1:])
    pins = [line.split("==") for line in entries(files, ".txt")]
    locked = {str(canonicalize_name(name)): version for name, version in pins}
    lacking = missing([Requirement(line) for line in entries(files, ".in")], locked)
    target.write_text("".join(f"{name}=={locked[name]}\n" for name in sorted(lacking)), encoding="utf-8")


if __name__ == "__main__":
    main()
