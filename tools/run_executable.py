"""Run an installed executable with the workspace's environment: what ``ros2 run`` is where ros2cli is absent.

Replaces itself by the executable, so that signals reach it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from environment import THIS, SetupError, find_executable, official_ros, workspace_environment
from freshness import what_is_missing

USAGE = "usage: ./run PACKAGE EXECUTABLE [arguments]"


def main() -> int:
    """Set the workspace up if need be, then become the executable; return only if that cannot be."""
    try:
        package, name, *arguments = sys.argv[1:]
    except ValueError:
        sys.stderr.write(f"{USAGE}\n")
        return 2
    try:
        if any(what_is_missing(THIS, os.environ, official=official_ros(os.environ))):
            tools = Path(__file__).parent
            command = [tools / "python.sh", tools / "setup_workspace.py"]
            code = subprocess.run(command, stdout=sys.stderr, check=False).returncode
            if code:
                return code
        environ = workspace_environment()
        executable = find_executable(package, name, environ)
    except SetupError as error:
        sys.stderr.write(f"posor run: {error}\n")
        return 2
    except OSError as error:
        sys.stderr.write(f"posor run: {error.filename}: {error.strerror}.\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("posor run: interrupted.\n")
        return 130
    ros2 = shutil.which("ros2")
    program = [ros2, "run", package, name] if ros2 else [str(executable)]
    return os.execve(program[0], [*program, *arguments], environ)  # noqa: S606 - no shell in between is the point


if __name__ == "__main__":
    sys.exit(main())
