# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Command-line parser that reports a wrong command line as a ParameterError."""

from __future__ import annotations

import argparse
from typing import Any, NoReturn

from posor.errors import ParameterError


class CommandLineParser(argparse.ArgumentParser):
    """An argument parser that raises instead of exiting."""

    def __init__(self, *arguments: Any, help_call: str = "", **named: Any) -> None:
        """Create a parser.

        ``help_call``: the command that lists the options; default: the program's name with ``--help``. Other arguments:
        see ``argparse.ArgumentParser``.
        """
        super().__init__(*arguments, **named)
        self.help_call = help_call or f"{self.prog} --help"  # the command that lists the options

    def error(self, message: str) -> NoReturn:
        """Raise a ParameterError with argparse's message, which names the program as other errors do."""
        where = self.prog.removeprefix("posor ")
        raise ParameterError(message, where=where, expected=f"options as '{self.help_call}' lists them")
