"""Starts the programs of a graph as processes of their own, watches over them and ends them."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Self

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from posor_estimator.errors import PosorError
from posor_estimator.starting import INTERRUPTED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from types import TracebackType

END_TIMEOUT_S = 20.0
"""How long a program may take to end after SIGINT before it is killed; a recorder has files to close."""

STOPPED = (0, INTERRUPTED, -signal.SIGINT)
"""How a program may end that was asked to."""

_LOG_PREFIX = re.compile(r"^\[\w+\] \[[\d.]+\] \[[^\]]+\]: ")

Parameter = bool | int | float | str | list[str]


class ProcessError(PosorError):
    """A program cannot be started, or ended when or how it should not."""


@dataclass(frozen=True)
class Program:
    """What to start.

    Attributes:
        name: What to call it, also the name of its log file.
        package: ROS package that installs it.
        executable: Its name there.
        arguments: Command line of the executable's own.
        namespace: ROS namespace, such as ``/joint1``; empty: the root.
        parameters: ROS parameters by name.
        ends: Whether it ends by itself when its work is done.

    """

    name: str
    package: str
    executable: str
    arguments: Sequence[str] = ()
    namespace: str = ""
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    ends: bool = False

    def command(self) -> list[str]:
        """Return the command line.

        Raises:
            ProcessError: The package or its executable is not installed.

        """
        arguments = [*self.arguments, "--ros-args", *(["-r", f"__ns:={self.namespace}"] if self.namespace else [])]
        for name, value in self.parameters.items():
            arguments += ["-p", f"{name}:={json.dumps(value)}"]  # ROS reads values as YAML, which JSON is
        return [*self._beginning(), *arguments]

    def _beginning(self) -> list[str]:
        """Return what is executed, without arguments."""
        try:
            path = Path(get_package_prefix(self.package), "lib", self.package, self.executable)
        except PackageNotFoundError:
            raise ProcessError(
                f"package '{self.package}' is not installed", where=self.name, expected="a built and sourced workspace"
            ) from None
        if not path.is_file():
            raise ProcessError(
                f"package '{self.package}' has no executable '{self.executable}'",
                where=self.name,
                expected=f"it at {path}",
            )
        return [str(path)]


@dataclass(frozen=True)
class Script(Program):
    """A Python file to start; ``executable`` is its path, ``package`` is not used."""

    def _beginning(self) -> list[str]:
        if not Path(self.executable).is_file():
            raise ProcessError(f"there is no file {self.executable}", where=self.name, expected="a Python program")
        return [sys.executable, self.executable]


class RunningProgram:
    """One started program; what it writes goes to its log file."""

    def __init__(self, program: Program, log: Path) -> None:
        self.program = program
        self.log = log
        with log.open("wb") as file:
            # A session of its own: Ctrl-C in the terminal reaches the supervisor only, which then ends all in order.
            self.process = subprocess.Popen(
                program.command(), stdin=subprocess.DEVNULL, stdout=file, stderr=file, start_new_session=True
            )

    @property
    def has_ended(self) -> bool:
        """Whether it has ended."""
        return self.process.poll() is not None

    def last_sentence(self) -> str:
        """Return the last line that the program wrote, without what ROS puts before a log message."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
        last = next((line.strip() for line in reversed(lines) if line.strip()), "it wrote nothing")
        return _LOG_PREFIX.sub("", last).rstrip(".")

    def check(self, *, asked_to_end: bool = False) -> None:
        """Complain if it ended in another way than it should.

        Raises:
            ProcessError: It ended with an error, or by itself although it should run on.

        """
        code = self.process.poll()
        # SIGINT may have come before the program could do more than break off.
        if code is None or code in (STOPPED if asked_to_end else (0,) if self.program.ends else ()):
            return
        last = self.last_sentence()
        # Who is ended by a signal has had no time to say why: its last words are of before.
        how = (
            f"was ended by {signal.Signals(-code).name}; until then: {last}"
            if code < 0
            else f"ended with exit code {code}: {last}"
        )
        raise ProcessError(how, where=self.program.name)


class Supervisor:
    """Runs programs; used in a ``with`` statement, it leaves none behind."""

    def __init__(self, logs: Path) -> None:
        """Supervise from now on.

        Args:
            logs: Existing folder for one log file for each program.

        """
        self._logs = logs
        self._running: list[RunningProgram] = []

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all programs; complain of how they end only if nothing else is wrong."""
        try:
            self.end(self._running)
        except ProcessError:
            if error is None:
                raise

    def start(self, program: Program) -> RunningProgram:
        """Start a program.

        Raises:
            ProcessError: It is not installed.

        """
        running = RunningProgram(program, self._logs / f"{program.name.replace('/', '.')}.log")
        self._running.append(running)
        return running

    def check(self) -> None:
        """Complain if a program ended in another way than it should.

        Raises:
            ProcessError: The first that did, with the last sentence it wrote.

        """
        for running in self._running:
            running.check()

    def end(self, programs: Sequence[RunningProgram]) -> None:
        """End programs by SIGINT, all at the same time, and wait until they have ended.

        Raises:
            ProcessError: One did not end, or not as ``STOPPED`` says.

        """
        programs = list(programs)
        self._running = [running for running in self._running if running not in programs]
        for running in programs:
            running.process.send_signal(signal.SIGINT)
        slow = [running.program.name for running in programs if not _ends_in_time(running.process)]
        if slow:
            raise ProcessError(f"did not end within {END_TIMEOUT_S:g} s of SIGINT and was killed", where=slow[0])
        for running in programs:
            running.check(asked_to_end=True)

    def kill(self, running: RunningProgram) -> None:
        """Kill a program as a crash would (SIGKILL) and forget it."""
        self._running.remove(running)
        running.process.kill()
        running.process.wait()


def _ends_in_time(process: subprocess.Popen[bytes]) -> bool:
    try:
        process.wait(END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False
    return True
