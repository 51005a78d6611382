# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Output files of the programs of this package, and the explaining texts of their pages."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from posor.errors import ParameterError
from posor.output_files import write_files

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace


def check_writable(path: Path) -> Path:
    """Create the folder of an output file; return the path.

    Raises ParameterError: the folder or the file cannot be written, or the path is that of a folder.
    """
    if path.is_dir():
        raise ParameterError("cannot be written: is a folder", where=f"--output {path}", expected="a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            path.open("ab").close()  # refuses a file without write permission
    except OSError as error:
        raise ParameterError(f"cannot be written: {error.strerror}", where=f"--output {path}") from error
    return path


def parse_study(parser: ArgumentParser, output: str, arguments: Sequence[str] | None) -> Namespace:
    """Return the options of a study with ``--output``, its JSON file; ``output``: the default.

    Raises ParameterError: an option is unknown or invalid, or the file cannot be written.
    """
    parser.add_argument("--output", type=Path, default=Path(output), help="JSON file to write (default: %(default)s)")
    options = parser.parse_args(arguments)
    check_writable(options.output)
    return options


def write_json(path: Path, content: Any) -> None:
    """Write figures as JSON and print the path. Raises OutputError: the file cannot be written."""
    write_files({path: json.dumps(content, indent=2) + "\n"})
    print(f"figures written to {path}")


def end_study(name: str, failures: Sequence[str], output: Path, figures: Any) -> int:
    """Write what does not hold, one clause each, to standard error, and the figures as JSON; return the exit code.

    Raises OutputError: the file cannot be written.
    """
    for clause in failures:
        sys.stderr.write(f"{name}: {clause}\n")
    write_json(output, figures)
    return 1 if failures else 0


@cache
def page_notes(page: str) -> dict[str, Any]:
    """Return the explaining texts of a report page by their names, from ``page_notes.yaml``."""
    text = Path(__file__).with_name("page_notes.yaml").read_text(encoding="utf-8")
    content: dict[str, dict[str, Any]] = yaml.safe_load(text)
    return content[page]


def figures_of(source: object, names: Mapping[str, Any]) -> dict[str, Any]:
    """Return figures for JSON by key; a name is the path of an attribute (``inside.value``), or a mapping of names."""
    return {
        key: figures_of(source, name) if isinstance(name, Mapping) else attrgetter(name)(source)
        for key, name in names.items()
    }
