"""What the stack is meant to reach, beside what was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

MAIN = "6x2000"
"""The graph that the aims are about."""


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


AIMS = (
    Aim("six joints at 2 kHz: ticks lost", 0, lambda found: float(found[f"graph_{MAIN}"]["lost"])),
    Aim("p99, us", 1000, lambda found: float(found[f"graph_{MAIN}"]["p99_us"])),
    Aim("p50, graph to floor", 1.5, lambda found: float(found["ratio_p50"])),
    Aim("reprocessing, scans/s per core", 500_000, lambda found: float(found["offline_scans_per_s"]), at_least=True),
    Aim(
        "reprocessing to the plain message loop, whose results are the same",
        20,
        lambda found: float(found["offline_scans_per_s"] / found["plain_loop_scans_per_s"]),
        at_least=True,
    ),
    Aim("reprocessing, memory, MB", 500, lambda found: float(found["offline_memory_mb"])),
)


def judged(results: Mapping[str, Any]) -> list[tuple[Aim, float]]:
    """Return the aims of which something was measured, each with what was found."""
    found = []
    for aim in AIMS:
        try:
            found.append((aim, aim.figure(results)))
        except KeyError:
            continue
    return found
