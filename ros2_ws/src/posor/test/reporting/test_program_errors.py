# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Ends of programs: the reader of a pipe that has ended is no error of the program, another broken pipe is."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from posor.reporting.program_errors import NOT_READ, reports_errors

PROGRAM = """
import sys
from posor.reporting.program_errors import reports_errors
sys.exit(reports_errors(lambda: [print(n) for n in range(LINES)] and 0)())
"""


@pytest.mark.parametrize("lines", [1, 100_000])  # less and more than a buffer
def test_a_program_whose_output_nobody_reads_ends_without_a_traceback(lines: int) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-c", PROGRAM.replace("LINES", str(lines))]
    try:
        done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False, timeout=60)
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (NOT_READ, "")


def test_another_broken_pipe_is_not_hidden() -> None:
    @reports_errors
    def main() -> int:
        reader, writer = os.pipe()
        os.close(reader)
        with os.fdopen(writer, "wb", buffering=0) as pipe:
            return pipe.write(b"0")

    with pytest.raises(BrokenPipeError):
        main()
