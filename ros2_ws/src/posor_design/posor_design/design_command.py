# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""design: runs a design calculator with quantities in the units of the user.

``posor design`` lists the calculators; ``posor design NAME --help`` describes one.
"""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from posor.errors import OutputError, ParameterError, similar_name
from posor.output_files import write_files
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors

from posor_design.calculator_signature import read_signature
from posor_design.calculators import CALCULATORS, unit_of
from posor_design.design_page import render_design_page
from posor_design.value_kinds import format_value, name_kind, parse_value, summarise_value

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_design.calculator_signature import CalculatorSignature, Value


PROGRAMS = {
    "posor": "Lay out a POSOR for a requirement, and write files that run",
    "arm": "Allot the required uncertainty of an endpoint to joints and beams",
}
"""Subcommands that are programs of their own, modules such as ``posor_design_command``, and one line about each."""
_VALUES = """\
VALUE is a number with a unit, such as '60 in' or '10.6e6 psi', or several with commas between them; without a unit it
has the unit in brackets. Write a negative value as --name=-3."""


class CalculatorParser(CommandLineParser):
    """Parser of the arguments of a calculator, which may be negative quantities."""

    def error(self, message: str) -> NoReturn:
        """Raise a ParameterError; argparse takes ``-2in`` for an option."""
        option, found, _ = message.removeprefix("argument ").partition(": expected one argument")
        if found:
            where = self.prog.removeprefix("posor ")
            expected = f"a value; a negative one such as {option}=-2in"
            raise ParameterError(f"{option} has no value", where=where, expected=expected)
        super().error(message)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; exit code 0: the calculator has a result."""
    name, *others = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if name in PROGRAMS:
        return int(import_module(f"posor_design.{name}_design_command").main(others))
    if name in {"-h", "--help"}:
        print(list_calculators(), end="")
    elif name not in CALCULATORS:
        expected = similar_name(name, [*PROGRAMS, *CALCULATORS], "a name that 'posor design' lists")
        raise ParameterError(f"there is no calculator '{name}'", where="design", expected=expected)
    else:
        run_calculator(read_signature(name), others)
    return 0


def list_calculators() -> str:
    """Return the names of all programs and calculators with their summaries."""
    names = PROGRAMS | {name: read_signature(name).summary for name in CALCULATORS}
    width = max(map(len, names), default=0)
    return (
        "usage: posor design NAME [--ARGUMENT 'NUMBER UNIT' ...] [--json FILE] [--html FILE]\n\n"
        + "".join(f"  {name:<{width}}  {summary}\n" for name, summary in names.items())
        + "\n'posor design NAME --help' lists the arguments of a calculator.\n"
    )


def run_calculator(signature: CalculatorSignature, arguments: Sequence[str]) -> None:
    """Run a calculator, print its result, and write the files that the command line names.

    Raises PosorError: the command line is wrong, the calculator refuses an argument, or a file cannot be written.
    """
    options = vars(build_parser(signature).parse_args(arguments))
    if options["json"] and options["json"] == options["html"]:
        raise OutputError(
            "is stated twice", where=str(options["json"]), expected="a file for --json and one for --html"
        )
    values = {each.name: options[each.name] for each in signature.arguments}
    result = signature.function(**values)
    results = {each.name: getattr(result, each.name) for each in signature.results}
    _print_values(signature.results, results)
    texts: dict[Path, str] = {}
    if options["json"]:
        content = {
            "calculator": signature.name,
            "arguments": _json_values(signature.arguments, values),
            "result": _json_values(signature.results, results),
        }
        texts[options["json"]] = json.dumps(content, indent=2) + "\n"
    if options["html"]:
        texts[options["html"]] = render_design_page(signature, values, results)
    for path in texts:
        if not path.parent.exists():
            what = f"the folder {path.parent} does not exist"
            raise OutputError(what, where=str(path), expected="an existing folder")
    write_files(texts)


def build_parser(signature: CalculatorSignature) -> CalculatorParser:
    """Return the parser of the arguments of a calculator."""
    results = "\n".join(
        f"  {each.name}: {each.description.rstrip('.')} [{name_kind(each.kind)}]" for each in signature.results
    )
    parser = CalculatorParser(
        prog=f"posor design {signature.name}",
        description=f"{signature.summary}.\n\n{signature.description}".rstrip(),
        epilog=f"{_VALUES}\n\nresults:\n{results}\n\nSource: {signature.source}\n\nExample:\n  {signature.example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    for each in signature.arguments:
        parser.add_argument(
            each.option,
            dest=each.name,
            type=partial(parse_value, each.kind, where=f"design {signature.name}, {each.option}"),
            required=each.required,
            default=None if each.required else each.default,
            metavar="VALUE",
            help=_help_text(each).replace("%", "%%"),
        )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write arguments and results in SI units")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a page")
    return parser


def _help_text(argument: Value) -> str:
    default = "" if argument.required else format_value(argument.kind, argument.default)
    text = f"{argument.description.rstrip('.')} [{name_kind(argument.kind)}]"
    return f"{text}; default: {default}" if default else text


def _print_values(fields: Sequence[Value], values: dict[str, Any]) -> None:
    width = max(len(each.name) for each in fields)
    for each in fields:
        print(f"{each.name:<{width}}  {summarise_value(each.kind, values[each.name])}")


def _json_values(fields: Sequence[Value], values: dict[str, Any]) -> dict[str, Any]:
    return {each.name: {"value": values[each.name], "unit": unit_of(each.kind)} for each in fields}
