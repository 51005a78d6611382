"""Progress of the set-up: one printed line and one log file for each step."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
import time
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
UNKNOWN_LIBRARY = re.compile(r"No matching distribution found for (\S+)")


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
