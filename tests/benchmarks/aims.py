"""What the stack is meant to reach, beside what was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

MAIN = "6x2000"
"""The graph that the aims are about."""
TICKS, SCANS = 59 * 2000, 600 * 6 * 1000
"""Ticks of a minute, but for those at its ends, and scans that are reprocessed: less says nothing about the aims."""


@dataclass(frozen=True)
class Aim:
    """A figure that must be at least, or at most, what was aimed at."""

    text: str
    bound: float
    figure: Callable[[Mapping[str, Any]], float]
    at_least: bool = False

    def holds(self, found: float) -> bool:
        """Return whether a figure reaches the aim."""
        return found >= self.bound if self.at_least else found <= self.bound

    @property
    def wanted(self) -> str:
        """The aim in words."""
        return f"at {'least' if self.at_least else 'most'} {self.bound:,g}"


def _graph(found: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the figures of the main graph."""
    graph: Mapping[str, Any] = found[f"graph_{MAIN}"]
    return _measured(graph, graph["expected"], TICKS)


def _offline(found: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return figures with those of reprocessing."""
    return _measured(found, found["offline_scans"], SCANS)


def _measured(found: Mapping[str, Any], measured: int, wanted: int) -> Mapping[str, Any]:
    if measured < wanted:
        raise KeyError(wanted)
    return found


AIMS = (
    Aim("six joints at 2 kHz: ticks lost", 0, lambda found: float(_graph(found)["lost"])),
    Aim("p99, us", 1000, lambda found: float(_graph(found)["p99_us"])),
    Aim("p50, graph to floor", 1.5, lambda found: float(_graph(found)["p50_us"] / found[f"floor_{MAIN}"]["p50_us"])),
    Aim(
        "reprocessing, scans/s per core",
        500_000,
        lambda found: float(_offline(found)["offline_scans_per_s"]),
        at_least=True,
    ),
    Aim(
        "reprocessing to the plain message loop, whose results are the same",
        20,
        lambda found: float(_offline(found)["offline_scans_per_s"] / found["plain_loop_scans_per_s"]),
        at_least=True,
    ),
    Aim("reprocessing, memory, MB", 500, lambda found: float(_offline(found)["offline_memory_mb"])),
)


def judged(runs: Sequence[Mapping[str, Any]]) -> list[tuple[Aim, list[float]]]:
    """Return the aims that were measured in all runs, for as long as is aimed at, each with what was found."""
    found = []
    for aim in AIMS:
        try:
            found.append((aim, [aim.figure(run) for run in runs]))
        except KeyError:
            continue
    return found
