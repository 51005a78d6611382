"""What the programs of this package share: their command lines and the folders they write."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

from posor_estimator.errors import ParameterError
from posor_estimator.reporting.command_line import Parser

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

__all__ = ["LOGS", "Parser", "prepare"]

LOGS = "logs"
"""Folder, in a folder of output, for what the programs of a graph write."""


def prepare(folder: Path, made_here: Sequence[str], program: str) -> Path:
    """Make a folder of output with an empty folder for logs, without what an earlier run left there.

    Args:
        folder: What to make.
        made_here: Files and folders that the program makes in it; an earlier one of these is removed, anything else
            left alone.
        program: What to call the program in complaints.

    Raises:
        ParameterError: The folder cannot be made.

    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in (*made_here, LOGS):
            entry = folder / name
            if entry.is_dir():
                shutil.rmtree(entry)
            else:
                entry.unlink(missing_ok=True)
        (folder / LOGS).mkdir()
    except OSError as error:
        raise ParameterError(
            f"cannot be made: {error.strerror}", where=f"{program}, --output, {folder}", expected="a folder to write to"
        ) from error
    return folder
