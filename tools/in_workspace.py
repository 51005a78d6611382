"""Become a Python script in the workspace's environment: ``tools/in_workspace.py SCRIPT [arguments]``."""

from __future__ import annotations

import os
import sys

from environment import THIS, SetupError, workspace_environment


def main() -> int:
    """Run the script with the workspace's Python; return only if that cannot be."""
    try:
        environ = workspace_environment()
    except SetupError as error:
        sys.stderr.write(f"posor: {error}\n")
        return 2
    return os.execve(THIS.python, [str(THIS.python), *sys.argv[1:]], environ)  # noqa: S606 - no shell in between


if __name__ == "__main__":
    sys.exit(main())
