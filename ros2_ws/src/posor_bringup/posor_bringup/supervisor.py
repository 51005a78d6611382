# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Runs the programs of a graph as processes: starts them with log files, detects failures, ends all of them.

``concurrent.futures`` runs Python functions; these are ROS executables that run until SIGINT and must end in order.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from shutil import disk_usage, which
from typing import TYPE_CHECKING, Self

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from posor.errors import PosorError
from posor.lazy_program import EXIT_INTERRUPTED, interrupts_blocked
from posor_ros.ros_arguments import ros_arguments

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from types import TracebackType

END_TIMEOUT_S = 20.0
"""Time from SIGINT until a program is killed; a recorder has files to close."""
LAZY_PACKAGES = ("posor_drivers", "posor_estimator")
"""Packages whose programs are LazyPrograms; others may leave signals blocked that are blocked when they start."""
FULL_BYTES = 4096
"""Free bytes of a disk on which no log can grow."""
EXIT_CODES_AFTER_SIGINT = (0, EXIT_INTERRUPTED, -signal.SIGINT)

_ROS_LOG_PREFIX = re.compile(r"^\[\w+\] \[[\d.]+\] \[[^\]]+\]: ")

Parameter = bool | int | float | str | list[str] | list[float]


class ProcessError(PosorError):
    """A program cannot be started, or ended with an error or too early."""


@dataclass(frozen=True)
class ProgramCommand:
    """A program and its options."""

    name: str  # name in messages and of the log file
    package: str  # ROS package that installs the executable; empty: ``executable`` is the path of a Python file
    executable: str  # name of the executable
    arguments: Sequence[str] = ()  # command line without ROS arguments
    namespace: str = ""  # ROS namespace, such as ``/joint1``; empty: the root
    parameters: Mapping[str, Parameter] = field(default_factory=dict)  # ROS parameters by name
    ends: bool = False  # whether it ends by itself when its work is done
    enclave: str = ""  # identity of the process in a network with SROS 2, such as ``/arm/chain_node``; empty: the root

    def command(self) -> list[str]:
        """Return the command line.

        Raises:
            ProcessError: The package or its executable is not installed, or the Python file is missing.

        """
        own = ros_arguments(self.parameters, self.namespace, enclave=self.enclave)
        return [*self._interpreter_and_path(), *self.arguments, *own]

    def _interpreter_and_path(self) -> list[str]:
        """Return the executable's path, preceded by the interpreter if it is a Python file."""
        if not self.package:
            if not Path(self.executable).is_file():
                raise ProcessError(f"there is no file {self.executable}", where=self.name, expected="a Python program")
            return [sys.executable, self.executable]
        try:
            path = Path(get_package_prefix(self.package), "lib", self.package, self.executable)
        except PackageNotFoundError:
            raise ProcessError(
                f"package '{self.package}' is not installed", where=self.name, expected="a built and sourced workspace"
            ) from None
        if not path.is_file():
            missing = f"package '{self.package}' has no executable '{self.executable}'"
            raise ProcessError(missing, where=self.name, expected=f"it at {path}")
        return [str(path)]


def _ends_with_thread() -> list[str]:
    """Return the start of a command whose program gets SIGINT when the thread that starts it ends (setpriv, Linux)."""
    setpriv = which("setpriv")
    return [setpriv, "--pdeathsig", "INT", "--"] if setpriv else []


class RunningProgram:
    """A started program; its output goes to a log file."""

    def __init__(self, program: ProgramCommand, log: Path) -> None:
        """Start a program with its output in ``log``."""
        self.program = program
        self.log = log
        with log.open("wb") as file:
            command = program.command()
            with interrupts_blocked() if program.package in LAZY_PACKAGES else nullcontext():
                # In its own session: Ctrl-C in the terminal reaches only the supervisor, which ends all in order.
                self.process = subprocess.Popen(
                    [*_ends_with_thread(), *command],
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=file,
                    start_new_session=True,
                )

    @property
    def has_ended(self) -> bool:
        """Whether the process has ended."""
        return self.process.poll() is not None

    def last_sentence(self) -> str:
        """Return the last line of the log without the prefix of ROS log messages; if there is none, the reason.

        The note below a traceback, which names the node of an error, is no sentence of its own.
        """
        lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
        is_full = disk_usage(self.log).free < FULL_BYTES
        nothing = f"it wrote nothing{f', the disk of {self.log.parent} is full' if is_full else ''}"
        written = [line.strip() for line in lines if line.strip()]
        note = written.pop() if len(written) > 1 and written[-1].startswith("in node ") else ""
        last = f"{note}{': ' if note else ''}{written[-1]}" if written else nothing
        return _ROS_LOG_PREFIX.sub("", last).rstrip(".")

    def check(self, *, after_sigint: bool = False) -> None:
        """Check that the program still runs, or has ended as it should.

        Raises:
            ProcessError: It ended with an error, or without SIGINT although it should not end by itself.

        """
        code = self.process.poll()
        if code is None or code in (EXIT_CODES_AFTER_SIGINT if after_sigint else (0,) if self.program.ends else ()):
            return
        last = self.last_sentence()
        by = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        # A program that a signal has ended could not log the reason; its last line is older.
        how = f"was ended by {by}; log: {last}" if code < 0 else f"ended with exit code {code}: {last}"
        raise ProcessError(how, where=self.program.name)

    def wait_or_kill(self) -> bool:
        """Wait for the end; return False if the program had to be killed after ``END_TIMEOUT_S``."""
        try:
            self.process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.kill()
            return False
        return True

    def kill(self) -> None:
        """Kill the program with SIGKILL."""
        self.process.kill()
        self.process.wait()


class Supervisor:
    """Runs programs; leaving its ``with`` block ends all of them."""

    def __init__(self, logs: Path) -> None:
        """Create a supervisor.

        Args:
            logs: Existing folder for the log files, one for each program.

        """
        self._logs = logs
        self._running: list[RunningProgram] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all programs; a ProcessError is added as a note to an earlier error."""
        try:
            self.end(self._running)
        except ProcessError as failure:
            if error is None:
                raise
            error.add_note(f"While the programs were ended: {failure}")

    def start(self, program: ProgramCommand) -> RunningProgram:
        """Start a program, from a thread that lasts until its end: it gets SIGINT when this thread, or process, ends.

        Raises:
            ProcessError: It is not installed.

        """
        running = RunningProgram(program, self._logs / f"{program.name.replace('/', '.')}.log")
        self._running.append(running)
        return running

    def check(self) -> None:
        """Check all programs.

        Raises:
            ProcessError: A program failed; the message quotes its last sentence.

        """
        for running in self._running:
            running.check()

    def end(self, programs: Sequence[RunningProgram]) -> None:
        """Send SIGINT to programs, all at the same time, and wait until they have ended.

        Raises:
            ProcessError: A program had to be killed, or its code is not among ``EXIT_CODES_AFTER_SIGINT``.

        """
        programs = list(programs)
        self._running = [running for running in self._running if running not in programs]
        for running in programs:
            running.process.send_signal(signal.SIGINT)
        killed = [running.program.name for running in programs if not running.wait_or_kill()]
        if killed:
            raise ProcessError(f"did not end within {END_TIMEOUT_S:g} s of SIGINT and was killed", where=killed[0])
        for running in programs:
            running.check(after_sigint=True)

    def kill(self, running: RunningProgram) -> None:
        """Kill a program, as a crash would, and stop supervising it."""
        self._running.remove(running)
        running.kill()
