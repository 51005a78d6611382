# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of programs: one sentence on standard error, and an exit code; none where the reader of a pipe has ended."""

from __future__ import annotations

import os
import select
import sys
from functools import wraps
from typing import TYPE_CHECKING, ParamSpec

from posor.errors import PosorError

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
NOT_READ = 1  # exit code: the reader of the output ended before its end, as ``head`` does


def reports_errors(main: Callable[P, int]) -> Callable[P, int]:
    """Decorate the function of a program: a PosorError is written to standard error, and its exit code returned.

    An error that sums up several is written as one sentence for each. A closed pipe as standard output ends the program
    with ``NOT_READ``.
    """

    @wraps(main)
    def run(*arguments: P.args, **named: P.kwargs) -> int:
        try:
            try:
                return main(*arguments, **named)
            finally:
                sys.stdout.flush()  # Python would do so too late to change the exit code
        except PosorError as error:
            sys.stderr.writelines(f"{part}\n" for part in error.parts)
            return error.exit_code
        except BrokenPipeError:
            output = select.poll()
            output.register(sys.stdout, 0)
            if not any(event & select.POLLERR for _, event in output.poll(0)):
                raise
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is left in the buffer
            return NOT_READ

    return run
