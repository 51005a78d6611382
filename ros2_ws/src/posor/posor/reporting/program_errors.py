# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of programs: one sentence on standard error, and an exit code."""

from __future__ import annotations

import sys
from functools import wraps
from typing import TYPE_CHECKING, ParamSpec

from posor.errors import PosorError

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")


def reports_errors(main: Callable[P, int]) -> Callable[P, int]:
    """Decorate the function of a program: a PosorError is written to standard error, and its exit code returned.

    An error that sums up several is written as one sentence for each.
    """

    @wraps(main)
    def run(*arguments: P.args, **named: P.kwargs) -> int:
        try:
            return main(*arguments, **named)
        except PosorError as error:
            sys.stderr.writelines(f"{part}\n" for part in error.parts)
            return error.exit_code

    return run
