"""The command line of a program, wrong ones reported as every other error is."""

from __future__ import annotations

import argparse
from typing import NoReturn

from posor_estimator.errors import ParameterError


class Parser(argparse.ArgumentParser):
    """Reports a wrong command line the way every other error is reported."""

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong.

        Raises:
            ParameterError: Always.

        """
        raise ParameterError(message, where=self.prog, expected=f"options as '{self.prog} --help' lists them")
