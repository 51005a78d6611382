# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Make the bags of the 1985 tests YMO, YZMO and ZMO from the recorded tables.

``make data`` runs it in the environment of the workspace; an optional argument is the output folder. An existing bag is
replaced when the new one is complete. The tables are imported by their map, as ``posor import`` does; every run
gives the same bytes.
"""

from __future__ import annotations

import sys
from pathlib import Path

from posor.errors import PosorError
from posor.tables.table_readings import load_readings
from posor_drivers.import_command import write_bag

HERE = Path(__file__).resolve().parent
TABLES = HERE.parent / "data/slocum1985"
TESTS = ("ymo", "yzmo", "zmo")


def main(folder: Path) -> None:
    """Make all bags in ``folder``."""
    for test in TESTS:
        write_bag(load_readings(TABLES / f"{test}_input.csv", TABLES / "table_map.yaml"), folder / test)
        print(f"made {folder / test}")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
    except PosorError as error:
        sys.exit(str(error))
