"""Waits for what a graph does while its programs are watched."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from posor_estimator.errors import PosorError
from posor_estimator.starting import INTERRUPTED

from posor_bringup.supervisor import ProcessError

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_bringup.receiver import Receiver
    from posor_bringup.supervisor import Supervisor

PATIENCE_S = 60.0
"""A net, not a pace: how long nothing at all may happen before a run is given up."""


class InterruptedRunError(PosorError):
    """SIGINT or SIGTERM came during a run."""

    exit_code = INTERRUPTED


class Watch:
    """Receives while the programs run as they should."""

    def __init__(
        self,
        supervisor: Supervisor,
        receiver: Receiver,
        run: str,
        *,
        on_received: Callable[[], None] = lambda: None,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        """Prepare.

        Args:
            supervisor: Knows the programs.
            receiver: Receives.
            run: What to call the run in complaints, such as ``replay``.
            on_received: Called whenever something has arrived.
            interrupted: Whether to give up.

        """
        self._supervisor = supervisor
        self._receiver = receiver
        self._run = run
        self._on_received = on_received
        self._interrupted = interrupted

    def wait(self, until: Callable[[], bool], lacking: Callable[[], str]) -> None:
        """Receive until a condition holds.

        Args:
            until: The condition.
            lacking: What to say is missing when nothing happens any more.

        Raises:
            InterruptedRunError: The user gives up.
            ProcessError: A program ended as it should not, or nothing arrived for ``PATIENCE_S``.

        """
        received, since = -1, time.monotonic()

        def done() -> bool:
            nonlocal received, since
            if self._interrupted():
                raise InterruptedRunError("interrupted", where=self._run)
            self._supervisor.check()
            if self._receiver.received != received:
                received, since = self._receiver.received, time.monotonic()
                self._on_received()
            if until():
                return True
            if time.monotonic() - since > PATIENCE_S:
                raise ProcessError(f"nothing arrives any more, missing: {lacking()}", where=self._run)
            return False

        self._receiver.receive_until(done)
