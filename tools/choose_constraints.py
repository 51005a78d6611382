"""Write pip constraints for an environment that sees an installed ROS: keep what is there, pin what is not.

Called by the set-up with the environment's own Python, which has pip: FILE LOCK [LOCK ...]
"""

from __future__ import annotations

import importlib.metadata
import sys
from pathlib import Path

from pip._vendor.packaging.version import Version

LINKED_AGAINST = {"numpy"}  # the installed ROS messages are compiled for the numpy that came with them


def constraint(name: str, pin: str) -> str:
    """Return the constraint for one library of the lock files.

    Args:
        name: Distribution name.
        pin: Locked version.

    Returns:
        The locked version if the library is not installed; else a line that lets pip keep it, or replace a version
        that is too old by no newer one than the locked; nothing for one that is newer than the locked.

    """
    try:
        installed = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return f"{name}=={pin}"
    if name in LINKED_AGAINST:
        return f"{name}=={installed}"
    return f"{name}<={pin}" if Version(installed) <= Version(pin) else ""


def main() -> None:
    """Read the lock files and write the constraints."""
    target, *locks = map(Path, sys.argv[1:])
    lines = [line for lock in locks for line in lock.read_text(encoding="utf-8").splitlines()]
    pins = dict(line.split("==") for line in lines if "==" in line and not line.startswith("#"))
    chosen = (constraint(name, pin) for name, pin in sorted(pins.items()))
    target.write_text("".join(f"{line}\n" for line in chosen if line), encoding="utf-8")


if __name__ == "__main__":
    main()
