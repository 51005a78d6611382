# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Progress of the set-up: one printed line and one log file for each step."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import sys
import threading
import time
from functools import partial
from typing import TYPE_CHECKING

from environment import SetupError, Workspace, run_commands

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

LOG_TAIL_LINES = 25
OFFLINE_SIGNS = (  # in pip's log if it has reached no index
    "ConnectTimeoutError",
    "NameResolutionError",
    "NewConnectionError",
    "ProxyError",
    "ReadTimeoutError",
)
TYPICAL = {
    "venv.log": "some 10 s",
    "pip.log": "one to three minutes",
    "colcon.log": "one to three minutes",
    "kernels.log": "two to five minutes",
}
"""Duration of each step on a first set-up, by the name of its log."""
DURATIONS = "durations.json"
"""File with the durations of the steps of earlier set-ups."""
UNKNOWN_LIBRARY = re.compile(r"No matching distribution found for (\S+)")


def show_elapsed(line: str, start: float, ended: threading.Event) -> None:
    """Show the time since the start of a step once a second on a terminal, until the step has ended."""
    while not ended.wait(1.0):
        print(f"\r{line}{time.monotonic() - start:.0f} s, ", end="", flush=True)


class SetupReport:
    """Prints one line with the duration of each step and runs the commands of the step into its log file.

    Args:
        workspace: The checkout.
        lock: File descriptor of the lock against other set-ups. Commands inherit it: if the set-up is killed and
            leaves a command running, the next set-up waits for that command too.

    """

    def __init__(self, workspace: Workspace, lock: int) -> None:
        self.workspace = workspace
        self.lock = lock
        self.log = workspace.logs / "setup.log"

    @contextlib.contextmanager
    def step(self, what: str, log_name: str) -> Iterator[None]:
        """Print the name and the duration of a step, or the end of its log if it fails."""
        self.workspace.logs.mkdir(parents=True, exist_ok=True)
        self.log = self.workspace.logs / log_name
        self.log.write_bytes(b"")
        known = self.known_durations()
        expected = f"{known[what]:.0f} s" if what in known else TYPICAL.get(log_name, "some time")
        line = f"set-up: {what}, expected {expected} ... "
        print(line, end="", flush=True)
        start = time.monotonic()
        ended = threading.Event()
        if sys.stdout.isatty():
            show = partial(show_elapsed, line, start, ended)
            threading.Thread(target=show, daemon=True).start()
        try:
            yield
        except BaseException:
            ended.set()
            print("failed", flush=True)
            lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
            sys.stderr.write("".join(f"  | {line}\n" for line in lines[-LOG_TAIL_LINES:]))
            raise
        ended.set()
        seconds = time.monotonic() - start
        print(f"{seconds:.1f} s", flush=True)
        text = json.dumps({**known, what: round(seconds, 1)}) + "\n"
        (self.workspace.logs / DURATIONS).write_text(text, encoding="utf-8")

    def known_durations(self) -> dict[str, float]:
        """Return how long each step took last time [s], by its name."""
        try:
            found = json.loads((self.workspace.logs / DURATIONS).read_text(encoding="utf-8"))
            return {str(name): float(seconds) for name, seconds in found.items()}
        except (OSError, ValueError, TypeError, AttributeError):
            return {}

    def run(self, *commands: Sequence[str | Path], environ: Mapping[str, str], failure: str) -> None:
        """Run commands of the current step at the same time.

        Args:
            commands: Program and arguments of each.
            environ: Environment of the commands.
            failure: Error message without a full stop.

        Raises:
            SetupError: A command failed.

        """
        with self.log.open("ab") as log:
            log.writelines(f"$ {' '.join(map(str, command))}\n".encode() for command in commands)
            log.flush()
            code = run_commands(
                *commands,
                env=dict(environ),
                cwd=self.workspace.root,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=[self.lock],
            )
        if code:
            log_name = self.log.relative_to(self.workspace.root)
            raise SetupError(f"{self.index_error() or failure} (exit code {code}; all of its output is in {log_name}).")

    def index_error(self) -> str:
        """Return the failure of the package index according to pip's log, or an empty string."""
        text = self.log.read_text(encoding="utf-8", errors="replace")
        if any(sign in text for sign in OFFLINE_SIGNS):
            return "the Python package index cannot be reached: check the network, or pip's index and proxy"
        unknown = UNKNOWN_LIBRARY.search(text)
        if unknown:
            return f"pip's package index has no {unknown[1]} for this Python: check pip's index settings"
        return ""
