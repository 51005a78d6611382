# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""posor: one command for the programs that a user starts; ``posor SUBCOMMAND --help`` lists the options of each."""

from __future__ import annotations

import re
import sys
from contextlib import redirect_stdout, suppress
from importlib import import_module
from io import StringIO
from typing import TYPE_CHECKING, NamedTuple

from posor.errors import ParameterError, similar_name
from posor.lazy_program import LazyProgram
from posor.library_programs import correct, dcc, recover, reprocess
from posor.reporting.program_errors import reports_errors
from posor_calibration.calibration_programs import calibrate
from posor_design.design_programs import budget, design
from posor_drivers.driver_programs import import_table, instruments, record

from posor_bringup.bringup_programs import (
    arm,
    bringup,
    calibrate_arm,
    commission,
    encoders,
    health,
    iso9283,
    statement,
    view,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


class Subcommand(NamedTuple):
    """A subcommand: the program that it starts, and one line about it."""

    program: Callable[[], int]
    summary: str
    arguments: tuple[str, ...] = ()  # of the program, before those of the command line


COMPLETION = """\
declare -gA _posor_words
_posor() {{
    local words="{names}" key="${{COMP_WORDS[*]:1:COMP_CWORD > 2 ? 2 : 1}}"
    if [ "$COMP_CWORD" -gt 1 ]; then
        [ -n "${{_posor_words[$key]+known}}" ] || _posor_words[$key]=$("$1" completion $key 2>/dev/null)
        words=${{_posor_words[$key]}}
    fi
    COMPREPLY=($(compgen -W "$words" -- "$2"))
}}
complete -o default -F _posor posor
"""
"""Asks this program for the words of a subcommand, once in a shell; without a match bash completes file names."""
_OPTION = re.compile(r"(?<![\w-])--?[a-zA-Z][\w-]*")
_LISTED = re.compile(r"^ {2,4}([a-z][\w-]*)(?: {2,}\S.*)?$", re.MULTILINE)
_CHOICES = re.compile(r"\{([\w,]+)\}")
_INSTALLED = re.compile(r"name of an installed arm: ((?:\w+, )*\w+)")


def _print_completion() -> int:
    """Print the completion for bash, or with arguments the words that may follow them."""
    if len(sys.argv) == 1:
        sys.stdout.write(COMPLETION.format(names=" ".join(SUBCOMMANDS)))
    elif sys.argv[1] in SUBCOMMANDS:
        sys.stdout.write(" ".join(words_after(*sys.argv[1:])) + "\n")
    return 0


def words_after(name: str, action: str = "") -> list[str]:
    """Return options, actions and installed arms that may follow a subcommand, as its help lists them.

    ``action``: the word after the subcommand, such as the name of a calibration procedure; any other word is ignored.
    """
    words = _words_of(_help(name))
    return _words_of(_help(name, action)) if action in words and not action.startswith("-") else words


def _words_of(text: str) -> list[str]:
    choices = (choice for group in _CHOICES.findall(text) for choice in group.split(","))
    arms = (arm for group in _INSTALLED.findall(" ".join(text.split())) for arm in group.split(", "))
    return sorted({*_OPTION.findall(text), *_LISTED.findall(text), *choices, *arms})


def _help(name: str, *arguments: str) -> str:
    """Return the help of a subcommand."""
    subcommand, before, output = SUBCOMMANDS[name], sys.argv, StringIO()
    if not isinstance(subcommand.program, LazyProgram):
        return ""
    sys.argv = [name, *subcommand.arguments, *arguments, "--help"]
    try:
        with redirect_stdout(output), suppress(SystemExit):
            import_module(subcommand.program.module).main()
    finally:
        sys.argv = before
    return output.getvalue()


SUBCOMMANDS = {
    "arm": Subcommand(arm, "make the files of a new arm, check those of an arm"),
    "bringup": Subcommand(bringup, "start all nodes of an arm"),
    "view": Subcommand(view, "show an arm or a bag in the browser"),
    "commission": Subcommand(commission, "check plugs, motions and files of an arm, record its identity"),
    "instruments": Subcommand(instruments, "list, try and watch the devices of an instruments file"),
    "import": Subcommand(import_table, "make a bag of a table: CSV, Parquet, TDMS or MATLAB"),
    "record": Subcommand(record, "record topics into a bag"),
    "reprocess": Subcommand(reprocess, "compute transforms and endpoint poses from recorded scans"),
    "recover": Subcommand(recover, "write what is whole in a damaged bag to a new bag"),
    "calibrate": Subcommand(calibrate, "fit a calibration file to a bag, list the procedures, compare files"),
    "calibrate-arm": Subcommand(
        calibrate_arm, "calibrate POSORs, beams, base and tool of an arm from a laser tracker, ball bar or artefact"
    ),
    "health": Subcommand(health, "find parts of an arm that have changed, by short tests at an artefact over years"),
    "check": Subcommand(calibrate, "check whether a calibration file still explains a bag", ("check",)),
    "correct": Subcommand(correct, "correct a recorded robot program by the endpoints measured while it ran"),
    "statement": Subcommand(statement, "state the uncertainty of an arm's endpoint for a customer: page, PDF, JSON"),
    "dcc": Subcommand(dcc, "make the certificate file of a Digital Calibration Certificate, check a certificate"),
    "iso9283": Subcommand(iso9283, "accuracy and repeatability of poses, distances and paths from a bag (ISO 9283)"),
    "encoders": Subcommand(encoders, "encoder minus POSOR of each joint by angle and direction, from a bag"),
    "budget": Subcommand(budget, "compute the error budget of a calibration file ('statement': of an arm's endpoint)"),
    "design": Subcommand(design, "compute a part of a POSOR or of its structure from dimensions"),
    "completion": Subcommand(
        _print_completion, 'complete subcommands, options, arms, procedures in bash: eval "$(posor completion)"'
    ),
}


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Start the program of a subcommand with the further arguments; return its exit code."""
    name, *others = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if name in {"-h", "--help"}:
        sys.stdout.write("usage: posor SUBCOMMAND [arguments]\n\n")
        sys.stdout.writelines(f"  {each:<14}{subcommand.summary}\n" for each, subcommand in SUBCOMMANDS.items())
        sys.stdout.write("\n'posor SUBCOMMAND --help' lists the arguments of a subcommand.\n")
        return 0
    if name not in SUBCOMMANDS:
        expected = similar_name(name, SUBCOMMANDS, f"one of {', '.join(SUBCOMMANDS)}")
        raise ParameterError(f"there is no subcommand '{name}'", where="posor", expected=expected)
    subcommand = SUBCOMMANDS[name]
    sys.argv = [name, *subcommand.arguments, *others]
    return subcommand.program()
