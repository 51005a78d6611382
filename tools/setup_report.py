"""The set-up's report: a line for each step, a log file for the output of its commands."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
import time
from typing import TYPE_CHECKING

from environment import SetupError, Workspace

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

LOG_TAIL_LINES = 25
OFFLINE = (
    "ConnectTimeoutError",
    "NameResolutionError",
    "NewConnectionError",
    "ProxyError",
    "ReadTimeoutError",
)  # how pip's log says that it reached no index
UNKNOWN = re.compile(r"No matching distribution found for (\S+)")


class Report:
    """Prints one line for each step, with the seconds it took, and runs the step's commands into a log file.

    Args:
        workspace: The checkout.
        lock: File descriptor of the lock that keeps other set-ups out. The commands inherit it: should the set-up be
            killed and leave a command behind, the next set-up waits for that too.

    """

    def __init__(self, workspace: Workspace, lock: int) -> None:
        self.workspace = workspace
        self.lock = lock
        self.log = workspace.logs / "setup.log"

    @contextlib.contextmanager
    def step(self, what: str, log_name: str) -> Iterator[None]:
        """Announce a step and say how long it took, or show the end of its log."""
        self.workspace.logs.mkdir(parents=True, exist_ok=True)
        self.log = self.workspace.logs / log_name
        self.log.write_bytes(b"")
        print(f"set-up: {what} ... ", end="", flush=True)
        start = time.monotonic()
        try:
            yield
        except BaseException:
            print("failed", flush=True)
            lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
            sys.stderr.write("".join(f"  | {line}\n" for line in lines[-LOG_TAIL_LINES:]))
            raise
        print(f"{time.monotonic() - start:.1f} s", flush=True)

    def run(self, command: Sequence[str | Path], environ: Mapping[str, str], failure: str) -> None:
        """Run a command of the present step.

        Args:
            command: Program and arguments.
            environ: Its environment.
            failure: What to say if it fails, without a full stop.

        Raises:
            SetupError: It failed.

        """
        with self.log.open("ab") as log:
            log.write(f"$ {' '.join(map(str, command))}\n".encode())
            log.flush()
            code = subprocess.run(
                command,
                env=dict(environ),
                cwd=self.workspace.root,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=[self.lock],
                check=False,
            ).returncode
        if code:
            place = self.log.relative_to(self.workspace.root)
            raise SetupError(f"{self.cause() or failure} (exit code {code}; all of its output is in {place}).")

    def cause(self) -> str:
        """Return what pip's log says went wrong with the package index, or nothing."""
        text = self.log.read_text(encoding="utf-8", errors="replace")
        if any(sign in text for sign in OFFLINE):
            return "the Python package index cannot be reached: check the network, or pip's index and proxy"
        unknown = UNKNOWN.search(text)
        if unknown:
            return f"pip's package index has no {unknown[1]} for this Python: check pip's index settings"
        return ""
