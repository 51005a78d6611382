"""Run Python in the environment of the workspace: ``tools/in_workspace.py SCRIPT [arguments]``."""

from __future__ import annotations

import os
import sys

from environment import THIS, SetupError, workspace_environment


def main() -> int:
    """Replace this process by the Python of the workspace; return only if the workspace is not built."""
    try:
        environ = workspace_environment()
    except SetupError as error:
        sys.stderr.write(f"posor: {error}\n")
        return 2
    return os.execve(THIS.python, [str(THIS.python), *sys.argv[1:]], environ)  # noqa: S606  no shell needed


if __name__ == "__main__":
    sys.exit(main())
