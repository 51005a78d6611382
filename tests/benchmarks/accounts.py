"""What a measurement says: latencies, and what became of every tick. Pure arithmetic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from posor_drivers.simulator.ticks import first_tick_after, stamps_of
from posor_estimator.errors import PosorError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    IntArray = npt.NDArray[np.int64]

STAMP, PUBLISHED, RECEIVED, NUMBER = range(4)
"""Columns of what the receiver notes."""
PERCENTILES = {"p50_us": 50.0, "p99_us": 99.0, "p999_us": 99.9, "max_us": 100.0}
COUNTERS = ("ticks_missed", "incomplete", "refused")


class NothingReceived(PosorError):
    """Not a single pose came."""

    def __init__(self, expected_poses: int) -> None:
        super().__init__("no pose came in the measured time", where="endpoint/pose", expected=f"{expected_poses}")


@dataclass(frozen=True)
class Window:
    """The part of a run that counts: from ``begin_ns`` to less than ``end_ns`` of the ROS clock, at ``rate`` [Hz]."""

    begin_ns: int
    end_ns: int
    rate: int

    @property
    def stamps(self) -> IntArray:
        """Stamps of all ticks in it [ns], (n,)."""
        first, last = (first_tick_after(end - 1, self.rate) for end in (self.begin_ns, self.end_ns))
        return stamps_of(np.arange(first, last), self.rate)


@dataclass(frozen=True)
class Run:
    """One measured window.

    Attributes:
        latencies_ns: From each pose's stamp to its reception, (n,).
        published_ns: From each pose's stamp to its publication, (n,).
        expected: Ticks in the window.
        not_received: Poses that were published and never received.
        counters: What the nodes themselves count, from shortly before the window to shortly after: ticks that a driver
            missed (the most of any), scans that lacked a joint, scans refused by the chain.
        cpu_cores: Processor time of each process by its name [s/s].
        memory_mb: Resident memory of each, likewise.

    """

    latencies_ns: IntArray
    published_ns: IntArray
    expected: int
    not_received: int
    counters: Mapping[str, int]
    cpu_cores: Mapping[str, float]
    memory_mb: Mapping[str, float]

    @property
    def lost(self) -> int:
        """Ticks without a pose received."""
        return self.expected - len(self.latencies_ns)


def account(
    noted: IntArray,
    window: Window,
    counters: Mapping[str, int],
    cpu_cores: Mapping[str, float],
    memory_mb: Mapping[str, float],
) -> Run:
    """Return what was received of a window.

    Args:
        noted: What the receiver wrote, (n, 4).
        window: What counts.
        counters: See ``Run``.
        cpu_cores: See ``Run``.
        memory_mb: See ``Run``.

    Raises:
        NothingReceived: No pose came.
        PosorError: A pose is not of a tick, or came twice.

    """
    ticks = window.stamps
    inside = noted[(noted[:, STAMP] >= window.begin_ns) & (noted[:, STAMP] < window.end_ns)]
    if not len(inside):
        raise NothingReceived(len(ticks))
    if not np.isin(inside[:, STAMP], ticks).all():
        stray = int(inside[~np.isin(inside[:, STAMP], ticks), STAMP][0])
        raise PosorError(f"stamp {stray} ns", where="endpoint/pose", expected=f"a tick of {window.rate} Hz")
    if len(np.unique(inside[:, STAMP])) != len(inside):
        raise PosorError("two poses have the same stamp", where="endpoint/pose", expected="one for each tick")
    gaps = int(inside[-1, NUMBER] - inside[0, NUMBER]) + 1 - len(inside)
    return Run(
        latencies_ns=inside[:, RECEIVED] - inside[:, STAMP],
        published_ns=inside[:, PUBLISHED] - inside[:, STAMP],
        expected=len(ticks),
        not_received=gaps,
        counters=counters,
        cpu_cores=cpu_cores,
        memory_mb=memory_mb,
    )


def figures(runs: Sequence[Run]) -> dict[str, Any]:
    """Return the figures of several runs taken as one."""
    latencies = np.concatenate([run.latencies_ns for run in runs]) / 1e3
    published = np.concatenate([run.published_ns for run in runs]) / 1e3
    lost, not_received = sum(run.lost for run in runs), sum(run.not_received for run in runs)
    return {
        **{name: float(np.percentile(latencies, share)) for name, share in PERCENTILES.items()},
        "published_p50_us": float(np.percentile(published, PERCENTILES["p50_us"])),
        "published_p99_us": float(np.percentile(published, PERCENTILES["p99_us"])),
        "expected": sum(run.expected for run in runs),
        "received": len(latencies),
        "lost": lost,
        "not_received": not_received,
        "not_published": lost - not_received,
        **{name: sum(run.counters[name] for run in runs) for name in COUNTERS},
        "cpu_cores": float(np.mean([sum(run.cpu_cores.values()) for run in runs])),
        "memory_mb": float(np.mean([sum(run.memory_mb.values()) for run in runs])),
        "processes": {
            name: {
                "cpu_cores": float(np.mean([run.cpu_cores[name] for run in runs])),
                "memory_mb": float(np.mean([run.memory_mb[name] for run in runs])),
            }
            for name in runs[0].cpu_cores
        },
    }
