# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Command-line options and output folders of the programs that start a graph."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError
from pathlib import Path
from typing import TYPE_CHECKING, cast

from posor.bags.result_folder import prepare_outputs
from posor.calibration.yaml_document import parse_yaml
from posor.errors import CalibrationError, ParameterError
from posor.output_files import writing
from posor_ros.parameter_files import OPTION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_bringup.supervisor import Parameter

LOGS = "logs"  # name of the folder for log files in an output folder


def _parse_parameter(text: str) -> tuple[str, Parameter]:
    """Return name and value of ``name:=value``; the value is YAML, as on a ROS command line."""
    name, separator, value = text.partition(":=")
    try:
        parsed = parse_yaml(value, "option -p")[1]
    except CalibrationError:
        parsed = None
    entries = parsed if isinstance(parsed, list) else [parsed]
    if not (name and separator and all(isinstance(entry, bool | int | float | str) for entry in entries)):
        raise ArgumentTypeError(f"'{text}' is not a parameter, name:=value")
    return name, cast("Parameter", parsed)


def add_namespace(parser: ArgumentParser) -> None:
    """Add the option ``--namespace``."""
    text = "namespace around that of the arm, such as cell1, for two arms of one name; default: none"
    parser.add_argument("--namespace", default="", metavar="NAME", help=text)


def add_arm_parameters(parser: ArgumentParser) -> None:
    """Add the options of the nodes' parameters, and ``--no-driver``."""
    parser.add_argument("--no-driver", action="store_true", help="without drivers: the scans come from elsewhere")
    add_driver_parameters(parser)
    text = "ROS parameter file, whose sections name nodes of the arm; may be repeated"
    parser.add_argument(OPTION, action="append", default=[], type=Path, metavar="FILE", help=text)


def add_driver_parameters(parser: ArgumentParser) -> None:
    """Add the repeatable option ``-p name:=value``; ``parameters`` becomes a list of names and values."""
    parser.add_argument(
        "-p",
        action="append",
        default=[],
        type=_parse_parameter,
        dest="parameters",
        metavar="NAME:=VALUE",
        help="parameter of all drivers, such as simulated.sag:=false; may be repeated",
    )


def parse_driver_parameters(text: str) -> dict[str, Parameter]:
    """Return the parameters ``name:=value name:=value ...`` of a launch argument.

    Raises ParameterError: a part of the text is not a parameter.
    """
    try:
        return dict(_parse_parameter(part) for part in text.split())
    except ArgumentTypeError as error:
        raise ParameterError(str(error), where="launch argument 'driver_parameters'") from None


def prepare_output_folder(folder: Path, outputs: Sequence[str]) -> Path:
    """Create an output folder with an empty folder for logs; replace the outputs of an earlier run.

    The other files of the folder stay. Raises OutputError: the folder holds one of these names, but not from an earlier
    run; or it cannot be written.
    """
    prepare_outputs(folder, (*outputs, LOGS))
    with writing(folder):
        (folder / LOGS).mkdir()
    return folder
