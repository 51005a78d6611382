# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Console of programs that print a report."""

from __future__ import annotations

import sys

from rich.console import Console


def report_console(width: int) -> Console:
    """Return a console on standard output, as wide as the terminal, elsewhere of ``width`` columns."""
    return Console(highlight=False, emoji=False, width=None if sys.stdout.isatty() else width)
