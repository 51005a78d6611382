"""What became of every tick of a run: a pose, or the reason why there is none, as the nodes have counted it too."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_bringup.arm_record import CHAIN, GIVEN_UP, NO_SCAN, TRUTH

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray
    from posor_drivers.simulator.arm import ArmSimulation

    from posor_bringup.arm_record import ArmRecord

DROPOUT = "scan dropped, as the scenario has it"
MISSED = "tick missed, its process was late"


class Dropouts:
    """Which scans the scenario drops: told by the tick, like everything else of a scenario."""

    def __init__(self, simulation: ArmSimulation) -> None:
        """Look nothing up yet."""
        self._simulation = simulation
        self._length = simulation.scenario.cycle_ticks
        self._sent: dict[int, dict[str, NDArray[np.bool_]]] = {}

    def at(self, tick: int) -> frozenset[str]:
        """Return the joints whose scan of a tick is never sent."""
        cycle, index = divmod(tick, self._length)
        if cycle not in self._sent:
            ticks = np.arange(cycle * self._length, (cycle + 1) * self._length)
            self._sent[cycle] = {joint: self._simulation.scans(joint, ticks).sent for joint in self._simulation.joints}
        return frozenset(joint for joint, sent in self._sent[cycle].items() if not sent[index])


@dataclass(frozen=True)
class Counted:
    """What the nodes said at the end of the run, counted since their start.

    Attributes:
        missed: Ticks that each joint's driver missed.
        incomplete: Scans that the chain gave up since a transform was missing or late.

    """

    missed: Mapping[str, int]
    incomplete: int


@dataclass(frozen=True)
class Accounts:
    """The sum of a run.

    Attributes:
        ticks: How many ticks were recorded.
        poses: How many of them gave a pose.
        causes: How often what was the cause that there was none; a tick may have several.
        unaccounted: Ticks without a pose of which nobody knows why.

    """

    ticks: int
    poses: int
    causes: Mapping[str, int]
    unaccounted: int

    @property
    def sentence(self) -> str:
        """The sum in words."""
        causes = "; ".join(f"{cause}: {count}" for cause, count in self.causes.items())
        without = self.ticks - self.poses
        return f"{self.poses} with a pose, {without} without" + (f" ({causes})" if causes else "")


def accounts(records: Sequence[ArmRecord], simulation: ArmSimulation, counted: Counted) -> Accounts:
    """Return what became of the ticks of some records.

    Args:
        records: What was received.
        simulation: Knows which scans the scenario drops.
        counted: What the nodes counted.

    """
    causes: Counter[str] = Counter()
    late: Counter[str] = Counter()
    dropouts, silent = Dropouts(simulation), 0
    for record in records:
        for tick, reasons in zip(record.ticks, record.reasons, strict=True):
            for who, why in reasons.items():
                cause = why
                if who == TRUTH:
                    cause = MISSED
                    late[simulation.joints[-1]] += 1
                elif why == NO_SCAN:
                    dropped = who in dropouts.at(tick)
                    cause = DROPOUT if dropped else MISSED
                    late[who] += not dropped
                causes[cause if who == CHAIN else f"{who} {cause}"] += 1
            without_scan = sum(why == NO_SCAN for who, why in reasons.items() if who != TRUTH)
            silent += 0 < without_scan < len(simulation.joints)  # the chain knows only of ticks that some joint sent
    unaccounted = sum(max(0, count - counted.missed[joint]) for joint, count in late.items())
    unaccounted += max(0, causes[GIVEN_UP] + silent - counted.incomplete)
    return Accounts(
        ticks=sum(len(record) for record in records),
        poses=int(sum(np.count_nonzero(record.has_pose) for record in records)),
        causes=dict(causes),
        unaccounted=unaccounted,
    )
