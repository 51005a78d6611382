# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Runs one program in a process of its own and waits for its output."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from threading import Condition, Thread
from typing import IO, TYPE_CHECKING, Any, Self

from ament_index_python.packages import get_package_prefix
from posor.node_parameters import RECORDING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

HAND_FED: Mapping[str, Any] = {**RECORDING, "freshness.max_silence": math.inf}
"""Parameters of nodes whose input a test publishes now and then, with stamps of its own."""
END_S = 10.0  # time for a program to end after SIGTERM when its test has failed [s]
TIMEOUT_S = 120.0  # longest wait for an event that should happen at once; not a pace


def installed(package: str, executable: str) -> list[str]:
    """Return the command of an installed executable."""
    return [str(Path(get_package_prefix(package), "lib", package, executable))]


def script(path: Path) -> list[str]:
    """Return the command of a Python file."""
    return [sys.executable, str(path)]


def in_background(command: Sequence[str]) -> list[str]:
    """Return a command that starts another one as a script does with ``nohup`` and ``&``: SIGHUP, SIGINT ignored."""
    return ["sh", "-c", 'trap "" HUP INT; exec "$@"', "sh", *command]


class Program:
    """A running program; leaving the ``with`` block kills a program that has not ended."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        """Start the program; ``environment``: variables to add to those of this process."""
        self._condition = Condition()
        self._lines: dict[str, list[str]] = {"stdout": [], "stderr": []}
        self.process = subprocess.Popen(
            list(command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1", **(environment or {})},
        )
        self._readers = [
            Thread(target=self._read, args=(stream, name), daemon=True)
            for stream, name in ((self.process.stdout, "stdout"), (self.process.stderr, "stderr"))
        ]
        for reader in self._readers:
            reader.start()

    def __enter__(self) -> Self:
        """Return the program."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the program if it is still running, so that it ends the programs that it has started."""
        if self.process.poll() is None:
            self.process.terminate()
            try:
                self.process.wait(END_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
        if self.wait() == -signal.SIGSEGV:  # with the stacks of its threads
            print("\n".join(self.stderr))
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()

    def _read(self, stream: IO[str] | None, name: str) -> None:
        for line in stream or ():
            with self._condition:
                self._lines[name].append(line.rstrip("\n"))
                self._condition.notify_all()

    @property
    def stdout(self) -> list[str]:
        """The lines written to standard output so far."""
        return list(self._lines["stdout"])

    @property
    def stderr(self) -> list[str]:
        """The lines written to standard error so far."""
        return list(self._lines["stderr"])

    @property
    def errors(self) -> list[str]:
        """The lines written to standard error so far, without those that nodes log at the level INFO."""
        return error_lines(self.stderr)

    @property
    def ended(self) -> bool:
        """Whether the program has ended."""
        return self.process.poll() is not None

    def wait_for_line(self, text: str) -> str:
        """Return the first line of either stream that contains ``text``, once there is one.

        Raises AssertionError: the program ended without this line, or the wait timed out.
        """
        deadline = time.monotonic() + TIMEOUT_S
        with self._condition:
            while True:
                ended = self.ended and not any(reader.is_alive() for reader in self._readers)
                for line in self.stdout + self.stderr:
                    if text in line:
                        return line
                if ended or time.monotonic() > deadline:
                    raise AssertionError(f"no line '{text}' but {self.stdout + self.stderr}")
                self._condition.wait(0.2)

    def wait(self) -> int:
        """Wait for the end of the program, and of its output; return the exit code."""
        code = self.process.wait(TIMEOUT_S)
        for reader in self._readers:
            reader.join(TIMEOUT_S)
        return code

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        """Send a signal, wait for the end and return the exit code."""
        self.process.send_signal(number)
        return self.wait()


def error_lines(lines: Sequence[str]) -> list[str]:
    """Return the lines of standard error without those that nodes log at the level INFO."""
    return [line for line in lines if "[INFO]" not in line]


def writes_below(pid: int, text: str) -> bool:
    """Return whether a process has a file open whose path contains a text."""
    try:
        return any(text in str(entry.readlink()) for entry in Path(f"/proc/{pid}/fd").iterdir())
    except FileNotFoundError:  # closed, or ended, meanwhile
        return False


def wait_until(
    condition: Callable[[], bool], what: str, meanwhile: Callable[[], None] = lambda: time.sleep(0.005)
) -> None:
    """Call ``meanwhile`` until ``condition`` holds. Raises AssertionError: the wait for ``what`` timed out."""
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"waited in vain for {what}")
        meanwhile()
