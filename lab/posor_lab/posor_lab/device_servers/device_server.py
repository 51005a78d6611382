# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Base of all servers of this package."""

from __future__ import annotations

import socket
from contextlib import suppress
from threading import Event, Thread
from typing import TYPE_CHECKING, Self

from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

HOST = "127.0.0.1"
POLL_S = 0.02


def free_port() -> int:
    """Return a TCP port of this host that is free."""
    with socket.create_server((HOST, 0)) as free:
        port: int = free.getsockname()[1]
    return port


def read_in_turn(
    voltages: Callable[[int], Sequence[float]], begin_ns: int, channels: Sequence[int], interval_s: float
) -> list[float]:
    """Return the voltages of channels that are read one after another from a ROS time on [ns]; 0: all at that time."""
    if interval_s == 0.0:
        now = voltages(begin_ns)
        return [now[channel] for channel in channels]
    return [voltages(begin_ns + round(k * interval_s * NS))[channel] for k, channel in enumerate(channels)]


class DeviceServer:
    """Runs from ``start`` to ``stop``, which sets ``stopping``, or in a ``with`` block; once if it has ports."""

    def __init__(self) -> None:
        self.stopping = Event()
        self._tasks: list[Callable[[], None]] = []
        self._threads: list[Thread] = []

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self.stop()

    def open_port(self, serve: Callable[[socket.socket], None]) -> int:
        """Open a TCP port until ``stop`` and return it; ``serve`` is called with one client after another."""
        listener = socket.create_server((HOST, 0))
        self.add_task(lambda: self._accept(listener, serve))
        port: int = listener.getsockname()[1]
        return port

    def add_task(self, task: Callable[[], None]) -> None:
        """Add a task that ``start`` runs in a thread; it ends when ``stopping`` is set."""
        self._tasks.append(task)

    def start(self) -> None:
        """Accept connections."""
        self.stopping.clear()
        self._threads = [Thread(target=task, daemon=True) for task in self._tasks]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Close all connections, and accept no more."""
        self.stopping.set()
        for thread in self._threads:
            thread.join()

    def _accept(self, listener: socket.socket, serve: Callable[[socket.socket], None]) -> None:
        with listener:
            listener.settimeout(POLL_S)
            while not self.stopping.is_set():
                try:
                    client, _ = listener.accept()
                except TimeoutError:
                    continue
                with client, suppress(ConnectionError):
                    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    serve(client)
