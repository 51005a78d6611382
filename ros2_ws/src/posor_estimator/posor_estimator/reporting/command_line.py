"""The command line of a program, wrong ones reported as every other error is."""

from __future__ import annotations

import argparse
from typing import Any, NoReturn

from posor_estimator.errors import ParameterError


class Parser(argparse.ArgumentParser):
    """Reports a wrong command line the way every other error is reported.

    Attributes:
        help_call: What the user types to see the options.

    """

    def __init__(self, *arguments: Any, help_call: str = "", **named: Any) -> None:
        """Take what argparse takes, and ``help_call`` where it is not the program's name with ``--help``."""
        super().__init__(*arguments, **named)
        self.help_call = help_call or f"{self.prog} --help"

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong.

        Raises:
            ParameterError: Always.

        """
        raise ParameterError(message, where=self.prog, expected=f"options as '{self.help_call}' lists them")
