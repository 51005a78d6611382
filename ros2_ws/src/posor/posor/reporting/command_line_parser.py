# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Command-line parser that reports a wrong command line as a ParameterError, and types of its options."""

from __future__ import annotations

import argparse
import math
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from posor.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Callable

Number = TypeVar("Number", int, float)


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


def number_from(least: float, most: float = math.inf, unit: str = "") -> Callable[[str], float]:
    """Return the type of an option: a finite number from ``least`` to ``most``, both allowed, in a unit."""
    return partial(_number, float, lambda value: least <= value <= most, f"at least {least:.10g}", most, unit)


def number_above(bound: float, most: float = math.inf, unit: str = "") -> Callable[[str], float]:
    """Return the type of an option: a finite number above ``bound`` and not above ``most``, in a unit."""
    return partial(_number, float, lambda value: bound < value <= most, f"more than {bound:.10g}", most, unit)


def whole_number_from(least: int, most: float = math.inf) -> Callable[[str], int]:
    """Return the type of an option: a whole number from ``least`` to ``most``, both allowed."""
    return partial(_number, int, lambda value: least <= value <= most, f"at least {least}", most, "")


def _number(
    kind: type[Number], holds: Callable[[Number], bool], least: str, most: float, unit: str, text: str
) -> Number:
    """Return the number that a text states. Raises ArgumentTypeError: it is none, not finite, or does not hold."""
    try:
        value = kind(text)
        valid = math.isfinite(value) and holds(value) and text.isascii() and "_" not in text
    except (ValueError, OverflowError):
        valid = False
    if not valid:
        name = "a whole number in digits" if kind is int else "a number"
        limit = f" and at most {most:.10g}" if most < math.inf else ""
        raise argparse.ArgumentTypeError(f"'{text}' is not {name} of {least}{limit} {unit}".rstrip())
    return value
