"""Stopwatches around functions: the time of each function without the timed functions that it calls."""

from __future__ import annotations

from dataclasses import dataclass
from functools import wraps
from threading import get_ident
from time import perf_counter_ns
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

CALIBRATION_ROUNDS, CALLS = 50, 500
"""The cost of a stopwatch is taken from the fastest round."""


@dataclass
class StageTime:
    """Calls of a stage, its own time [ns] and the number of timed calls that it made."""

    calls: int = 0
    own_ns: int = 0
    timed_calls: int = 0


class Stopwatches:
    """Times functions in one thread: the first that calls one of them."""

    def __init__(self, now_ns: Callable[[], int] = perf_counter_ns) -> None:
        self._now_ns = now_ns
        self._stages: dict[str, StageTime] = {}
        self._open: list[list[int]] = []
        self._thread = 0
        self._inside_ns = self._outside_ns = 0.0
        self._calibrate()

    def timed(self, function: Callable[..., Any], name: Callable[..., str] | str) -> Callable[..., Any]:
        """Return the function with a stopwatch; ``name``: of its stage, or a function that returns it for a call."""
        open_calls, now_ns = self._open, self._now_ns

        @wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            if get_ident() != self._thread:
                if self._thread:
                    return function(*arguments, **named)
                self._thread = get_ident()
            inner = [0, 0]
            open_calls.append(inner)
            begin = now_ns()
            try:
                return function(*arguments, **named)
            finally:
                elapsed = now_ns() - begin
                open_calls.pop()
                if open_calls:
                    open_calls[-1][0] += elapsed
                    open_calls[-1][1] += 1
                label = name if isinstance(name, str) else name(*arguments)
                stage = self._stages.setdefault(label, StageTime())
                stage.calls += 1
                stage.own_ns += elapsed - inner[0]
                stage.timed_calls += inner[1]

        return call

    def _calibrate(self) -> None:
        """Measure the time that a stopwatch adds to its own stage and to the calling stage."""
        nothing, rounds = self.timed(lambda: None, "no-op"), list[tuple[float, float]]()
        for _ in range(CALIBRATION_ROUNDS):
            self.restart()
            begin = self._now_ns()
            for _ in range(CALLS):
                nothing()
            rounds.append(((self._now_ns() - begin) / CALLS, self._stages["no-op"].own_ns / CALLS))
        whole_ns, self._inside_ns = min(rounds)
        self._outside_ns = whole_ns - self._inside_ns
        self._thread = 0
        self.restart()

    def restart(self) -> None:
        """Forget all times."""
        self._stages.clear()

    def stage_times(self) -> dict[str, tuple[int, float]]:
        """Return calls and time [us] of each stage without the cost of the stopwatches."""

        def own_us(stage: StageTime) -> float:
            return (stage.own_ns - stage.calls * self._inside_ns - stage.timed_calls * self._outside_ns) / 1e3

        return {name: (stage.calls, own_us(stage)) for name, stage in self._stages.items()}
