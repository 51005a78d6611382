# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Program ``dcc``: make a certificate file to be filled in, check a Digital Calibration Certificate."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from posor.certificates.certificate_file import TEMPLATE
from posor.certificates.dcc_check import check_dcc
from posor.certificates.dcc_document import check_new
from posor.output_files import write_files
from posor.reporting.command_line_parser import CommandLineParser
from posor.reporting.program_errors import reports_errors

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence


def parse_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options. Raises ParameterError: an option is unknown or missing."""
    parser = CommandLineParser(prog="posor dcc", description="Digital Calibration Certificates (DCC 3.2.1).")
    actions = parser.add_subparsers(dest="action", required=True, metavar="new|check")
    new = actions.add_parser("new", help="make a certificate file, for laboratory, persons and customer")
    new.add_argument("file", type=Path, metavar="FILE.yaml")
    check = actions.add_parser("check", help="check a certificate against the schema files, without network")
    check.add_argument("file", type=Path, metavar="FILE.xml")
    text = "folder of the schema files of DCC and D-SI, as PTB publishes them"
    check.add_argument("--schema", type=Path, required=True, metavar="FOLDER", help=text)
    return parser.parse_args(arguments)


@reports_errors
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; exit code 0: the file has been written, or the certificate is valid."""
    options = parse_options(arguments)
    if options.action == "new":
        check_new(options.file)
        write_files({options.file: TEMPLATE.read_text(encoding="utf-8")})
        sys.stdout.write(f"{options.file}: fill in the blanks\n")
    else:
        check_dcc(options.file, options.schema)
        sys.stdout.write(f"{options.file}: valid against {options.schema}\n")
    return 0
