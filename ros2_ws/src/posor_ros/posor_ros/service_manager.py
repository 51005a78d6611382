# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages to the service manager, the protocol of ``sd_notify(3)``: ready, alive, stopping.

Without the variable NOTIFY_SOCKET, which systemd sets for services with ``Type=notify``, nothing is sent.
"""

from __future__ import annotations

import os
import socket
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING

from posor.errors import SystemRefusal

if TYPE_CHECKING:
    from collections.abc import Mapping


class ServiceManager:
    """The connection to the service manager."""

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        """Connect, as the environment of the process says.

        WATCHDOG_USEC is the longest time between two signs of life that the manager accepts [us]; WATCHDOG_PID, if set,
        is the process that sends them. Raises SystemRefusal: there is no such socket, or it refuses the connection.
        """
        self._socket: socket.socket | None = None
        self._period_s = self._due_s = float("inf")
        path = environ.get("NOTIFY_SOCKET", "")
        if not path:
            return
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._socket.connect(f"\0{path[1:]}" if path.startswith("@") else path)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise SystemRefusal(reason, where=f"NOTIFY_SOCKET {path}", expected="the service manager's") from None
        if environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid()):
            self._period_s = int(environ.get("WATCHDOG_USEC", "0")) / 2e6 or self._period_s

    def report_ready(self) -> None:
        """Report that all nodes are started; signs of life are due from now on."""
        self._send("READY=1")
        self._due_s = monotonic() + self._period_s

    def report_alive(self) -> None:
        """Send a sign of life if one is due, twice in the longest time; takes a tenth of a microsecond else."""
        now_s = monotonic()
        if now_s >= self._due_s:
            self._due_s = now_s + self._period_s
            self._send("WATCHDOG=1")

    def close(self) -> None:
        """Report that the nodes are being stopped, and disconnect."""
        self._send("STOPPING=1")
        if self._socket is not None:
            self._socket.close()

    def _send(self, message: str) -> None:
        """Send a message; a manager that reads none does not delay the nodes."""
        if self._socket is not None:
            with suppress(BlockingIOError):
                self._socket.send(message.encode(), socket.MSG_DONTWAIT)
