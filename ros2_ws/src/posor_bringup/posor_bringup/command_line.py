"""What the programs of this package share: their command lines and the folders they write."""

from __future__ import annotations

import argparse
import shutil
from typing import TYPE_CHECKING, cast

import yaml
from posor_estimator.errors import ParameterError
from posor_estimator.reporting.command_line import Parser

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from posor_bringup.supervisor import Parameter

__all__ = ["LOGS", "Parser", "add_driver_parameters", "parameters_in", "prepare"]

LOGS = "logs"
"""Folder, in a folder of output, for what the programs of a graph write."""


def _parameter(text: str) -> tuple[str, Parameter]:
    """Return name and value of ``name:=value``; the value is YAML, as on a ROS command line."""
    name, separator, value = text.partition(":=")
    try:
        read = yaml.safe_load(value)
    except yaml.YAMLError:
        read = None
    is_list = isinstance(read, list) and all(isinstance(entry, str) for entry in read)
    if not (name and separator and (is_list or isinstance(read, bool | int | float | str))):
        raise argparse.ArgumentTypeError(f"'{text}' is no parameter, name:=value")
    return name, cast("Parameter", read)


def add_driver_parameters(parser: argparse.ArgumentParser) -> None:
    """Add the option ``-p name:=value``, which may be repeated, as ``parameters``, a list of names and values."""
    parser.add_argument(
        "-p",
        action="append",
        default=[],
        type=_parameter,
        dest="parameters",
        metavar="NAME:=VALUE",
        help="a parameter for all drivers, such as simulated.sag:=false; may be repeated",
    )


def parameters_in(text: str) -> dict[str, Parameter]:
    """Return the parameters ``name:=value name:=value ...`` of a launch argument.

    Raises:
        ParameterError: A part of the text is no parameter.

    """
    try:
        return dict(_parameter(part) for part in text.split())
    except argparse.ArgumentTypeError as error:
        raise ParameterError(str(error), where="launch argument 'driver_parameters'") from None


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
