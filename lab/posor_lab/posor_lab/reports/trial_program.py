# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The skeleton of programs that judge nodes: options, isolated network, findings, JSON file, exit code."""

from __future__ import annotations

import math
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from posor.errors import ParameterError
from posor.reporting.command_line_parser import CommandLineParser
from posor_ros.node_program import non_ros_arguments, ros_context
from rich.console import Console

from posor_lab.harness.ros_domain import isolated_network
from posor_lab.lab_output import check_writable, write_json
from posor_lab.reports.console_progress import StageProgress, interruption_check
from posor_lab.reports.findings import FIGURE_HEADINGS, exit_code_of_findings, print_findings, print_verdict

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Callable, Mapping, Sequence

    from posor_lab.reports.findings import Findings

_METAVARS: Mapping[type, str] = {int: "N", float: "X", str: "TEXT", type(Path()): "FILE"}


class Option(NamedTuple):
    """An option of a program, of the type of its default; False: a flag."""

    name: str  # such as ``--seed``
    default: Any
    text: str  # for --help
    least: float = -math.inf
    most: float = math.inf
    choices: Sequence[str] = ()


def parse_options(
    prog: str, description: str, options: Sequence[Option], arguments: Sequence[str], help_call: str = ""
) -> Namespace:
    """Return the values of options on a command line.

    Raises ParameterError: an option is unknown or its value is invalid.
    """
    parser = CommandLineParser(prog=prog, description=description, help_call=help_call)
    for option in options:
        if option.default is False:
            parser.add_argument(option.name, action="store_true", help=option.text)
            continue
        kind = type(option.default)
        parser.add_argument(
            option.name,
            type=kind,
            default=option.default,
            choices=option.choices or None,
            metavar=None if option.choices else _METAVARS[kind],
            help=option.text if option.default == "" else f"{option.text} (default: {option.default})",
        )
    found = parser.parse_args(list(arguments))
    for option in options:
        value = getattr(found, option.name.removeprefix("--").replace("-", "_"))
        is_given = isinstance(value, (int, float)) and value != option.default
        if is_given and not option.least <= value <= option.most:
            expected = f"{option.least:g} to {option.most:g}" if option.most < math.inf else f"{option.least:g} or more"
            raise ParameterError(f"{option.name} {value:g}", where=prog, expected=expected)
    return found


@dataclass(frozen=True)
class Trial:
    """A running program: its options, an existing empty folder, and where it shows its progress."""

    options: Namespace
    folder: Path
    progress: StageProgress
    console: Console
    interrupted: Callable[[], bool]

    def subfolder(self, title: str) -> Path:
        """Return a new folder for one part of the program."""
        folder = self.folder / title.replace(", ", "_").replace(" ", "_")
        folder.mkdir()
        return folder


@dataclass(frozen=True)
class TrialProgram:
    """A program that judges nodes in a network of their own."""

    name: str
    description: str  # sentence for --help
    options: Sequence[Option]  # ``--output`` is added if ``output`` is not empty
    run: Callable[[Trial], tuple[Findings, Mapping[str, Any]]]  # returns findings and content of the output file
    title: str  # title of the findings
    output: str = ""  # default of the output file; empty: no file is written
    check: Callable[[Namespace], None] = lambda _: None  # changes the options, or raises ParameterError

    def parse(self, arguments: Sequence[str]) -> Namespace:
        """Return the options. Raises ParameterError: an option is unknown or its value is invalid."""
        output = [Option("--output", Path(self.output), "file of the figures")] if self.output else []
        options = parse_options(self.name, self.description, [*self.options, *output], arguments)
        self.check(options)
        return options

    def main(self, arguments: Sequence[str] | None = None) -> int:
        """Run the program; the exit code is 0 if every aim is reached."""
        argv = list(sys.argv if arguments is None else arguments)
        return exit_code_of_findings(lambda: self._run(self.parse(non_ros_arguments(argv)), argv))

    def _run(self, options: Namespace, argv: Sequence[str]) -> Findings:
        console = Console(highlight=False, soft_wrap=True)
        if self.output:
            check_writable(options.output)
        with (
            tempfile.TemporaryDirectory(prefix=f"{self.name}-") as folder,
            isolated_network(),
            ros_context(argv) as stop,
            StageProgress(console, interruption_check(stop, self.name)) as progress,
        ):
            trial = Trial(options, Path(folder), progress, console, lambda: stop.requested)
            findings, content = self.run(trial)
        print_findings(findings, console, self.title, FIGURE_HEADINGS)
        if self.output:
            write_json(options.output, content)
        print_verdict(findings, console)
        return findings
