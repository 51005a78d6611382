# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Options of programs that also write a Digital Calibration Certificate of their results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from posor.certificates.certificate_file import load_certificate_file
from posor.certificates.dcc_document import check_new
from posor.errors import ParameterError

if TYPE_CHECKING:
    import argparse

    from posor.certificates.certificate_file import CertificateFile


def add_dcc_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--dcc`` and ``--certificate``."""
    parser.add_argument("--dcc", type=Path, metavar="FILE.xml", help="write a Digital Calibration Certificate, too")
    text = "laboratory, persons and customer of --dcc; 'posor dcc new' makes this file"
    parser.add_argument("--certificate", type=Path, metavar="FILE.yaml", help=text)


def read_dcc_options(options: argparse.Namespace, where: str) -> CertificateFile | None:
    """Return the certificate file of ``--certificate``; None: no certificate is wanted. ``where``: the program.

    Raises ParameterError: one option without the other; CalibrationError: the file is invalid; OutputError: the
    certificate exists already.
    """
    if (options.dcc is None) != (options.certificate is None):
        given, missing = ("dcc", "certificate") if options.certificate is None else ("certificate", "dcc")
        raise ParameterError(f"--{given} without --{missing}", where=where, expected="both")
    if options.dcc is None:
        return None
    check_new(options.dcc)
    return load_certificate_file(options.certificate)
