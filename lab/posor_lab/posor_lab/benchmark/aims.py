"""The aims of the stack's speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

MAIN = "6x2000"
MIN_TICKS, MIN_SCANS = 59 * 2000, 600 * 6 * 1000
"""Shorter measurements are not judged: ticks of a minute without its ends; scans of offline processing."""


@dataclass(frozen=True)
class Aim:
    """A bound on a figure of the benchmark; ``figure`` raises KeyError if it was not measured long enough."""

    text: str
    bound: float
    figure: Callable[[Mapping[str, Any]], float]
    at_least: bool = False

    def holds(self, value: float) -> bool:
        """Return whether a value is within the bound."""
        return value >= self.bound if self.at_least else value <= self.bound

    @property
    def wanted(self) -> str:
        """The bound as text."""
        return f"at {'least' if self.at_least else 'most'} {self.bound:,g}"


def _graph(results: Mapping[str, Any], key: str) -> float:
    """Return a figure of the main graph."""
    graph = results[f"graph_{MAIN}"]
    if graph["expected"] < MIN_TICKS:
        raise KeyError(key)
    return float(graph[key])


def _offline(results: Mapping[str, Any], key: str) -> float:
    """Return a figure of offline processing."""
    if results["offline_scans"] < MIN_SCANS:
        raise KeyError(key)
    return float(results[key])


AIMS = (
    Aim("six joints at 2 kHz: ticks lost", 0, lambda results: _graph(results, "lost")),
    Aim("p99, us", 1000, lambda results: _graph(results, "p99_us")),
    Aim(
        "p50, graph to pass-through graph",
        1.5,
        lambda results: _graph(results, "p50_us") / float(results[f"pass_through_{MAIN}"]["p50_us"]),
    ),
    Aim(
        "reprocess, scans/s per core", 300_000, lambda results: _offline(results, "offline_scans_per_s"), at_least=True
    ),
    Aim(
        "reprocess to the loop message by message, whose results are the same",
        20,
        lambda results: _offline(results, "offline_scans_per_s") / float(results["message_loop_scans_per_s"]),
        at_least=True,
    ),
    Aim("reprocess, memory, MB", 500, lambda results: _offline(results, "offline_memory_mb")),
)


def evaluate_aims(runs: Sequence[Mapping[str, Any]]) -> list[tuple[Aim, list[float]]]:
    """Return the aims that all runs have measured long enough, each with its figures."""
    evaluated = []
    for aim in AIMS:
        try:
            evaluated.append((aim, [aim.figure(run) for run in runs]))
        except KeyError:
            continue
    return evaluated
