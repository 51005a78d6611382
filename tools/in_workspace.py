# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Run Python in the environment of the workspace: ``tools/in_workspace.py SCRIPT [arguments]``."""

from __future__ import annotations

import os
import sys

from environment import THIS, exit_with, workspace_environment


def main() -> int:
    """Replace this process by the Python of the workspace."""
    return os.execve(THIS.python, [str(THIS.python), *sys.argv[1:]], workspace_environment())  # noqa: S606  no shell needed


if __name__ == "__main__":
    exit_with("posor", main)
