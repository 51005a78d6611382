"""budgets: the error budgets of the thesis, tables 5.2, 5.4, 7.9 and 7.12, cell by cell from the measurement model.

Exit code 0 only if every difference to a printed cell is explained.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from posor_estimator.errors import ParameterError, PosorError
from rich.console import Console

from posor_bringup.budgets_view import as_json, print_table, summary
from posor_bringup.command_line import Parser
from posor_bringup.diode_tables import fits_of_linearisation, rig_theta, table_5_4, table_7_9
from posor_bringup.probe_tables import table_5_2, table_7_12

if TYPE_CHECKING:
    from collections.abc import Sequence

WIDTH = 150


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program."""
    parser = Parser(prog="budgets", description="Error budgets of the thesis, cell by cell from the model.")
    parser.add_argument("--output", type=Path, default=Path("build/budgets.json"), help="JSON file to write")
    try:
        options = parser.parse_args(arguments)
        tables = (table_5_2(), table_5_4(), table_7_9(), table_7_12())
        by_x, by_y, theta = rig_theta()
        fits = fits_of_linearisation()
        content = {
            "cells": as_json(tables),
            "derived": {
                "linearisation_of_7_9_and_7_7_uin": fits,
                "rig_theta_by_x_rad_per_in": by_x,
                "rig_theta_by_y_rad_per_in": by_y,
                "rig_theta_total_urad": theta,
            },
        }
        _write(options.output, json.dumps(content, indent=2) + "\n")
    except PosorError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    console = Console(highlight=False) if sys.stdout.isatty() else Console(highlight=False, width=WIDTH)
    for table in tables:
        print_table(table, console)
    printed = tables[2].cell("root mean square: total", "induced_sigma_theta_urad").printed
    console.print(
        f"Derived, not printed: the rig has its spots apart along Y, so that theta goes by X ({by_x:.3f} rad/in) and "
        f"hardly by Y ({by_y:.3f}); the rows of table 7.9 then make {theta:.0f} urad, not {printed.text}."
    )
    console.print(summary(tables))
    console.print(f"cells written to {options.output}", soft_wrap=True, markup=False)
    return 0 if all(table.holds for table in tables) else 1


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ParameterError(
            f"cannot be written: {error.strerror}", where=f"budgets, --output, {path}", expected="a file to write"
        ) from error


if __name__ == "__main__":
    sys.exit(main())
