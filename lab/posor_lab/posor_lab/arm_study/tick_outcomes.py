"""Outcome of every tick of a run: a pose, or the cause of its absence, compared with the counters of the nodes."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_lab.arm_study.arm_record import CHAIN, GIVEN_UP, NO_SCAN, TRUTH

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray
    from posor_drivers.simulator.arm_simulation import ArmSimulation

    from posor_lab.arm_study.arm_record import ArmRecord

DROPPED = "scan dropped by the scenario"
MISSED = "tick missed, its process was late"


class Dropouts:
    """Scans that the scenario drops; they depend only on the tick."""

    def __init__(self, simulation: ArmSimulation) -> None:
        """Cycles are simulated when they are needed."""
        self._simulation = simulation
        self._cycle_ticks = simulation.scenario.cycle_ticks
        self._sent: dict[int, dict[str, NDArray[np.bool_]]] = {}

    def dropped_joints(self, tick: int) -> frozenset[str]:
        """Return the joints whose scan of a tick is dropped."""
        cycle, index = divmod(tick, self._cycle_ticks)
        if cycle not in self._sent:
            ticks = np.arange(cycle * self._cycle_ticks, (cycle + 1) * self._cycle_ticks)
            self._sent[cycle] = {joint: self._simulation.scans(joint, ticks).sent for joint in self._simulation.joints}
        return frozenset(joint for joint, sent in self._sent[cycle].items() if not sent[index])


@dataclass(frozen=True)
class NodeCounters:
    """Counters of the nodes at the end of a run."""

    missed: Mapping[str, int]  # ticks missed by the driver of each joint
    incomplete: int  # scans that the chain gave up because a transform was missing or late


@dataclass(frozen=True)
class TickOutcomes:
    """Outcomes of the ticks of a run."""

    ticks: int  # number of ticks
    poses: int  # number of ticks with a pose
    causes: Mapping[str, int]  # number of ticks without a pose by cause; a tick may have several causes
    unaccounted: int  # number of ticks without a pose that no counter explains

    @property
    def sentence(self) -> str:
        """The outcomes as text."""
        causes = "; ".join(f"{cause}: {count}" for cause, count in self.causes.items())
        return f"{self.poses} with a pose, {self.ticks - self.poses} without" + (f" ({causes})" if causes else "")


def count_outcomes(records: Sequence[ArmRecord], simulation: ArmSimulation, counters: NodeCounters) -> TickOutcomes:
    """Return the outcomes of the ticks of some records."""
    causes: Counter[str] = Counter()
    late: Counter[str] = Counter()
    dropouts, seen_by_chain = Dropouts(simulation), 0
    for record in records:
        for tick, reasons in zip(record.ticks, record.reasons, strict=True):
            for who, reason in reasons.items():
                cause = reason
                if who == TRUTH:  # the last joint's driver publishes the truth
                    cause = MISSED
                    late[simulation.joints[-1]] += 1
                elif reason == NO_SCAN:
                    dropped = who in dropouts.dropped_joints(tick)
                    cause = DROPPED if dropped else MISSED
                    late[who] += not dropped
                causes[cause if who == CHAIN else f"{who} {cause}"] += 1
            without_scan = sum(reason == NO_SCAN for who, reason in reasons.items() if who != TRUTH)
            seen_by_chain += 0 < without_scan < len(simulation.joints)  # of a tick without any scan it knows nothing
    unaccounted = sum(max(0, count - counters.missed[joint]) for joint, count in late.items())
    unaccounted += max(0, causes[GIVEN_UP] + seen_by_chain - counters.incomplete)
    return TickOutcomes(
        ticks=sum(len(record) for record in records),
        poses=int(sum(np.count_nonzero(record.has_pose) for record in records)),
        causes=dict(causes),
        unaccounted=unaccounted,
    )
