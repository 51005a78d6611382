"""The set-up's report: a line for each step, a log file for the output of its commands."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from typing import TYPE_CHECKING

from environment import SetupError, Workspace

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

LOG_TAIL_LINES = 15
OFFLINE = (
    "NewConnectionError",
    "ConnectTimeoutError",
    "ProxyError",
    "Name or service not known",
    "Network is unreachable",
)


class Report:
    """Prints one line for each step, with the seconds it took, and runs the step's commands into a log file."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.log = workspace.logs / "setup.log"

    @contextlib.contextmanager
    def step(self, what: str, log_name: str) -> Iterator[None]:
        """Announce a step and say how long it took."""
        self.workspace.logs.mkdir(parents=True, exist_ok=True)
        self.log = self.workspace.logs / log_name
        self.log.write_bytes(b"")
        sys.stdout.write(f"set-up: {what} ... ")
        sys.stdout.flush()
        start = time.monotonic()
        try:
            yield
        except BaseException:
            sys.stdout.write("failed\n")
            raise
        sys.stdout.write(f"{time.monotonic() - start:.1f} s\n")

    def run(self, command: Sequence[str | Path], environ: Mapping[str, str], failure: str) -> None:
        """Run a command of the present step.

        Args:
            command: Program and arguments.
            environ: Its environment.
            failure: What to say if it fails, without a full stop.

        Raises:
            SetupError: It failed; the end of its log has been printed.

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
                check=False,
            ).returncode
        if code:
            text = self.log.read_text(encoding="utf-8", errors="replace")
            sys.stderr.write("\n" + "".join(f"  | {line}\n" for line in text.splitlines()[-LOG_TAIL_LINES:]))
            if any(sign in text for sign in OFFLINE):
                failure = (
                    "the Python package index cannot be reached: check the network (or pip's proxy and index settings)"
                )
            raise SetupError(
                f"{failure} (exit code {code}; all of its output is in {self.log.relative_to(self.workspace.root)})."
            )
