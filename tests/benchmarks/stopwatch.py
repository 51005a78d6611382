"""Stopwatches around functions that call one another: how long each takes without those that it calls."""

from __future__ import annotations

from dataclasses import dataclass
from functools import wraps
from threading import get_ident
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

ROUNDS, LOOKS = 50, 500
"""The cost of a stopwatch is that of the quickest round: nothing came between."""


@dataclass
class Stage:
    """What was found of one: calls, time in it without timed calls of others [ns], and how many of those it made."""

    calls: int = 0
    own_ns: int = 0
    timed_calls: int = 0


class Stopwatches:
    """Times functions in one thread, the first in which one of them is called."""

    def __init__(self, now_ns: Callable[[], int] = perf_counter_ns) -> None:
        self._now_ns = now_ns
        self._stages: dict[str, Stage] = {}
        self._open: list[list[int]] = []
        self._thread = 0
        self._inside_ns = self._outside_ns = 0.0
        self._calibrate()

    def timed(self, function: Callable[..., Any], name: Callable[..., str] | str) -> Callable[..., Any]:
        """Return a function that does the same and is timed; ``name`` is that of its stage, or tells it by the call."""
        open_calls, now_ns = self._open, self._now_ns

        @wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            if get_ident() != self._thread:
                if self._thread:
                    return function(*arguments, **named)
                self._thread = get_ident()
            within = [0, 0]
            open_calls.append(within)
            begin = now_ns()
            try:
                return function(*arguments, **named)
            finally:
                took = now_ns() - begin
                open_calls.pop()
                if open_calls:
                    open_calls[-1][0] += took
                    open_calls[-1][1] += 1
                label = name if isinstance(name, str) else name(*arguments)
                stage = self._stages.setdefault(label, Stage())
                stage.calls += 1
                stage.own_ns += took - within[0]
                stage.timed_calls += within[1]

        return call

    def _calibrate(self) -> None:
        """Measure what a stopwatch adds: to the time that it shows, and to that of the caller beside this."""
        nothing, looks = self.timed(lambda: None, "nothing"), list[tuple[float, float]]()
        for _ in range(ROUNDS):
            self.restart()
            begin = self._now_ns()
            for _ in range(LOOKS):
                nothing()
            looks.append(((self._now_ns() - begin) / LOOKS, self._stages["nothing"].own_ns / LOOKS))
        whole_ns, self._inside_ns = min(looks)
        self._outside_ns = whole_ns - self._inside_ns
        self._thread = 0
        self.restart()

    def restart(self) -> None:
        """Forget what was found."""
        self._stages.clear()

    def found(self) -> dict[str, tuple[int, float]]:
        """Return calls and time [us] of each stage, without what the stopwatches themselves took."""
        return {
            name: (
                stage.calls,
                (stage.own_ns - stage.calls * self._inside_ns - stage.timed_calls * self._outside_ns) / 1e3,
            )
            for name, stage in self._stages.items()
        }
