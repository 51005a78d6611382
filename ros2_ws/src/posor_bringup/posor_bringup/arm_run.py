"""Runs a simulated arm, each node a process of its own: one cycle of its scenario, and one more with a controller.

The run sets the clock that all nodes go by: it moves on, tick by tick and no faster than real time, when everything of
the last tick has come. On a slow or busy machine the arm moves more slowly; no tick is missed for that.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from posor_drivers.simulator.ticks import stamp_of

from posor_bringup.arm_accounts import Counted, Dropouts
from posor_bringup.arm_programs import arm_programs
from posor_bringup.supervisor import ProcessError, RunningProgram, Script
from posor_bringup.watch import Watch

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from posor_drivers.simulator.arm import ArmSimulation
    from posor_estimator.core.arm import Arm

    from posor_bringup.arm_live_table import ArmLiveTable
    from posor_bringup.arm_receiver import ArmReceiver
    from posor_bringup.arm_record import ArmRecord
    from posor_bringup.supervisor import Parameter, Supervisor

EVERY_NODE: Mapping[str, Parameter] = {"use_sim_time": True, "qos_reliability": "reliable", "qos_depth": 1000}
"""The clock is ours; and what is published is received, so that nothing that is missing was merely lost on its way."""
CHAIN: Mapping[str, Parameter] = {"max_wait": 60.0}
"""How late a transform is depends on the machine only, since the clock waits for it."""
WARM_UP = 40
"""Ticks before the scenario begins, in which all that listen find all that publish."""
GRACE_S = 10.0
"""Wall time that a tick gets for what must come; then the clock goes on, and the accounts tell what was missing."""
BEGINNING_GRACE_S = 1.0
"""The same as long as not all have begun: a node that hears of the clock late begins with a later tick."""
COMMAND_GRACE_S = 1.0
"""Wall time that a controller gets to answer a pose; it may have a reason not to."""
REPEAT_S = 0.2
"""Wall time after which the clock is sent again: it is sent with best effort."""
LEAST_COMMANDED_S = 10.0
"""By when, on the arm's clock, a controller must have commanded something."""
SETTLING_S = 1.0
"""What a controller gets to settle, on the arm's clock."""
SHOWN_PER_S = 4
"""How often a tick is shown in a terminal; as a line, once a second."""


@dataclass(frozen=True)
class ArmPlan:
    """What to run.

    Attributes:
        simulation: The arm; every driver has the same.
        ticks: How many ticks to record, in each part.
        logs: Existing folder for what the programs write.
        controller: Python file of an endpoint controller; None: there is no second part.
        driver_parameters: ROS parameters for the drivers, such as ``simulated.sag``.

    """

    simulation: ArmSimulation
    ticks: int
    logs: Path
    controller: Path | None = None
    driver_parameters: Mapping[str, Parameter] = field(default_factory=dict)

    @property
    def arm(self) -> Arm:
        """The arm file."""
        return self.simulation.arm

    @property
    def rate(self) -> int:
        """Ticks per second."""
        return self.simulation.scenario.ticks_per_second

    @property
    def cycle(self) -> int:
        """Ticks after which the scenario repeats."""
        return self.simulation.scenario.cycle_ticks


class ArmRun:
    """One run: ``begin``, ``cycle``, ``control``, ``cycle``, ``counted``, ``finish``."""

    def __init__(
        self,
        plan: ArmPlan,
        supervisor: Supervisor,
        receiver: ArmReceiver,
        table: ArmLiveTable,
        *,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        """Prepare; nothing is started yet."""
        self.plan = plan
        self._supervisor = supervisor
        self._receiver = receiver
        self._table = table
        self._nodes: list[RunningProgram] = []
        self._controller: RunningProgram | None = None
        self._dropouts = Dropouts(plan.simulation)
        self._tick = plan.cycle - WARM_UP
        self._watch = Watch(supervisor, receiver, "arm", interrupted=interrupted)

    def begin(self) -> None:
        """Start all nodes, wait until they have found one another, and go on to the beginning of the scenario.

        Raises:
            ProcessError: A node ended, or something does not come.

        """
        plan = self.plan
        programs = arm_programs(
            plan.arm, driver_parameters=plan.driver_parameters, chain_parameters=CHAIN, parameters=EVERY_NODE
        )
        self._table.say(f"starting {len(programs)} nodes")
        self._nodes = [self._supervisor.start(program) for program in programs]
        self._watch.wait(lambda: not self._receiver.unready(), lambda: "; ".join(self._receiver.unready()))
        while self._tick < plan.cycle or self._receiver.missing_topics():
            self._go_on(BEGINNING_GRACE_S if self._receiver.missing_topics() else GRACE_S)

    def cycle(self, state: str) -> ArmRecord:
        """Run the plan's ticks, from the next one on.

        Args:
            state: What to say of it in the live table.

        Raises:
            ProcessError: A node ended, or nothing comes any more.

        """
        self._table.say(state)
        ticks = range(self._tick, self._tick + self.plan.ticks)
        began, shown, without = time.monotonic(), 0, 0
        pause = self.plan.rate // (SHOWN_PER_S if self._table.is_live else 1)
        for done, tick in enumerate(ticks, start=1):
            time.sleep(max(0.0, began + (done - 1) / self.plan.rate - time.monotonic()))
            self._go_on()
            without += stamp_of(tick, self.plan.rate) not in self._receiver.poses
            if done >= shown + pause:
                newest = self._receiver.record(range(tick, tick + 1), self.plan.rate)
                if newest.complete:
                    shown = done
                    speed = done / self.plan.rate / (time.monotonic() - began)
                    self._table.show(newest, done, without, speed)
        return self._receiver.record(ticks, self.plan.rate)

    def _go_on(self, grace: float = GRACE_S) -> None:
        """Set the clock to the next tick, so that the scans of this one are published; wait for what they lead to."""
        stamp, now = stamp_of(self._tick, self.plan.rate), stamp_of(self._tick + 1, self.plan.rate)
        dropped = self._dropouts.at(self._tick)
        receiver, began = self._receiver, time.monotonic()
        repeat = began + REPEAT_S
        receiver.set_clock(now)

        def done() -> bool:
            nonlocal repeat
            waited = time.monotonic() - began
            if time.monotonic() > repeat:
                repeat += REPEAT_S
                receiver.set_clock(now)
            if receiver.outstanding(stamp, dropped):
                return waited > grace
            commanded = self._controller is None or stamp in receiver.commands or stamp not in receiver.poses
            return commanded or waited > COMMAND_GRACE_S

        self._watch.wait(done, lambda: "; ".join(receiver.outstanding(stamp, dropped)))
        self._tick += 1

    def control(self) -> None:
        """Start the controller, with the clock standing still, then let it settle.

        Raises:
            ProcessError: It ended, or commands nothing.

        """
        self._table.say("starting the controller")
        self._controller = self._supervisor.start(
            Script("controller", "", str(self.plan.controller), (), f"/{self.plan.arm.name}", {"use_sim_time": True})
        )
        self._watch.wait(self._receiver.has_controller, lambda: "a publisher of stage/command")
        last = self._tick + round(LEAST_COMMANDED_S * self.plan.rate)
        while not self._receiver.commands:
            if self._tick > last:
                raise ProcessError(f"has commanded nothing in {LEAST_COMMANDED_S:g} s", where="controller")
            self._go_on()
        for _ in range(round(SETTLING_S * self.plan.rate)):
            self._go_on()

    def counted(self) -> Counted:
        """Return what the nodes have counted, once each has said it anew."""
        arm = self.plan.arm
        chain = f"/{arm.name}/chain_node: endpoint"
        drivers = {joint: f"/{arm.name}/{joint}/driver_node: pace" for joint in arm.calibrations}
        before = {name: self._receiver.heard(name) for name in (chain, *drivers.values())}

        def silent() -> list[str]:
            # Twice: the first may have been on its way already.
            return [name for name in before if self._receiver.heard(name) < before[name] + 2]

        self._watch.wait(lambda: not silent(), lambda: "diagnostics of " + ", ".join(silent()))
        return Counted(
            missed={joint: self._count(name, "ticks_missed") for joint, name in drivers.items()},
            incomplete=self._count(chain, "scans_incomplete"),
        )

    def _count(self, status: str, key: str) -> int:
        return int(self._receiver.value(status, key) or 0)

    def finish(self) -> None:
        """End the controller, then the nodes.

        Raises:
            ProcessError: One did not end as it should.

        """
        if self._controller is not None:
            self._supervisor.end([self._controller])
        self._supervisor.end(self._nodes)
