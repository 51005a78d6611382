"""posor: one command for the programs that a user starts; ``posor SUBCOMMAND --help`` lists the options of each."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, NamedTuple

from posor.errors import ParameterError, similar_name
from posor.library_programs import recover, reprocess
from posor.reporting.program_errors import reports_errors
from posor_calibration.calibration_programs import calibrate
from posor_design.design_programs import budget, design
from posor_drivers.driver_programs import import_table, instruments, record

from posor_bringup.bringup_programs import arm, bringup, commission, view

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


class Subcommand(NamedTuple):
    """A subcommand: the program that it starts, and one line about it."""

    program: Callable[[], int]
    summary: str
    arguments: tuple[str, ...] = ()  # of the program, before those of the command line


def _print_completion() -> int:
    """Print the completion of the subcommands for bash; the further arguments are completed as file names."""
    names = " ".join(SUBCOMMANDS)
    sys.stdout.write(
        "_posor() {\n"
        f'    [ "$COMP_CWORD" -ne 1 ] || COMPREPLY=($(compgen -W "{names}" -- "$2"))\n'
        "}\n"
        "complete -o default -F _posor posor\n"
    )
    return 0


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
    "check": Subcommand(calibrate, "check whether a calibration file still explains a bag", ("check",)),
    "budget": Subcommand(budget, "compute the error budget of a calibration file or an arm"),
    "design": Subcommand(design, "compute a part of a POSOR or of its structure from dimensions"),
    "completion": Subcommand(_print_completion, 'complete subcommands in bash: eval "$(posor completion)"'),
}


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Start the program of a subcommand with the further arguments; return its exit code."""
    name, *others = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if name in {"-h", "--help"}:
        sys.stdout.write("usage: posor SUBCOMMAND [arguments]\n\n")
        sys.stdout.writelines(f"  {each:<13}{subcommand.summary}\n" for each, subcommand in SUBCOMMANDS.items())
        sys.stdout.write("\n'posor SUBCOMMAND --help' lists the arguments of a subcommand.\n")
        return 0
    if name not in SUBCOMMANDS:
        expected = similar_name(name, SUBCOMMANDS, f"one of {', '.join(SUBCOMMANDS)}")
        raise ParameterError(f"there is no subcommand '{name}'", where="posor", expected=expected)
    subcommand = SUBCOMMANDS[name]
    sys.argv = [name, *subcommand.arguments, *others]
    return subcommand.program()


if __name__ == "__main__":
    sys.exit(main())
