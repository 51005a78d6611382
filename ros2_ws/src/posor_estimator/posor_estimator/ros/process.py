"""The health of the process that nodes run in: pauses of the garbage collector, and what the system refused."""

from __future__ import annotations

import gc
import sys
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any

from posor_estimator.ros.diagnostics import Level
from posor_estimator.ros.moments import NS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from posor_estimator.errors import PosorError
    from posor_estimator.ros.diagnostics import Status
    from posor_estimator.ros.parameters import LimitParameters

STATUS = "process"
"""Name of the status line."""
SWITCH_S = 1e-4
"""How long one Python thread holds up another that is due. Python's own 5 ms would be ten periods at 2 kHz; with less
than this, threads that are both busy lose time by changing places."""


class Pauses:
    """Counts what the garbage collector does, and for how long it holds all threads up.

    Attributes:
        count: Collections so far.
        longest_ns: The longest one since the last call of ``take_longest_ns`` [ns].

    """

    def __init__(self) -> None:
        """Begin to count."""
        self.count = 0
        self.longest_ns = 0
        self._begun_ns = 0
        gc.callbacks.append(self._collects)

    def _collects(self, phase: str, _info: dict[str, Any]) -> None:
        if phase == "start":
            self._begun_ns = perf_counter_ns()
            return
        self.count += 1
        self.longest_ns = max(self.longest_ns, perf_counter_ns() - self._begun_ns)

    def take_longest_ns(self) -> int:
        """Return the longest pause since the last call [ns]."""
        longest_ns, self.longest_ns = self.longest_ns, 0
        return longest_ns

    def close(self) -> None:
        """Count no more."""
        gc.callbacks.remove(self._collects)


def settle() -> None:
    """Do what is better done before the first scan: what is there now stays, and is not looked at for garbage again."""
    sys.setswitchinterval(SWITCH_S)
    gc.collect()
    gc.freeze()


class ProcessHealth:
    """The status line of the process, which one of its nodes tells."""

    def __init__(self, status: Status, refusals: Sequence[PosorError], limits: Callable[[], LimitParameters]) -> None:
        """Have it told once a second by ``report``.

        Args:
            status: The line.
            refusals: What the system refused.
            limits: Returns the limits in force.

        """
        self._status = status
        self._refusals = " ".join(map(str, refusals))
        self._limits = limits
        self._pauses = Pauses()
        self.report()

    def report(self) -> None:
        """Bring the line up to date."""
        longest_s = self._pauses.take_longest_ns() / NS
        limit_s = self._limits().pause
        said = [self._refusals] if self._refusals else []
        if longest_s > limit_s:
            said.append(f"the garbage collector held the process up for more than {limit_s:g} s")
        values = {"gc_collections": self._pauses.count, "gc_longest_pause": longest_s}
        self._status.report(Level.WARN if said else Level.OK, " ".join(said) or "ok", values)

    def close(self) -> None:
        """Count pauses no more."""
        self._pauses.close()
