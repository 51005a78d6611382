"""Runs the demo of a simulated arm, the program itself, and watches over what it starts."""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from posor_estimator.testing.program import Program, installed

if TYPE_CHECKING:
    from collections.abc import Iterator

PATIENCE_S = 250
"""A net: on a busy machine the demo takes its time."""


@contextmanager
def nothing_left_of(output: Path) -> Iterator[Path]:
    """End whatever still writes into an output folder after a block, and complain; the demo picks its own domain."""
    with pytest.MonkeyPatch.context() as environment:
        environment.delenv("ROS_DOMAIN_ID")
        yield output
    left = list(nodes_of(output))
    for number in left:
        os.kill(number, signal.SIGKILL)
    assert left == []


def nodes_of(output: Path) -> Iterator[int]:
    """Yield the processes that write into the logs of an output folder."""
    for entry in Path("/proc").glob("[0-9]*/fd/1"):
        try:
            if str(output) in str(entry.readlink()):
                yield int(entry.parent.parent.name)
        except OSError:  # it has ended meanwhile
            continue


@contextmanager
def arm(output: Path, *arguments: str) -> Iterator[Program]:
    with Program([*installed("posor_bringup", "arm"), "--output", str(output), *arguments]) as program:
        try:
            yield program
        finally:
            if not program.ended:
                program.end()


def exit_code(program: Program) -> int:
    """Wait for the demo's end."""
    program.process.wait(PATIENCE_S)
    return program.wait()
