# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Runs a simulated arm in one process per node: one cycle of its scenario, and one more with a controller.

The run publishes the clock of all nodes. It advances tick by tick, at most in real time, once everything of the last
tick has come. On a slow host the arm moves more slowly, but no tick is missed.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

import numpy as np
from posor.numerics.stamps import tick_stamp_ns
from posor.reporting.figure_style import MICRON
from posor_bringup.arm_programs import arm_programs
from posor_bringup.supervisor import ProcessError, ProgramCommand, RunningProgram
from rich.table import Table
from rich.text import Text

from posor_lab.arm_study.arm_record import Dropouts, NodeCounters
from posor_lab.reports.console_progress import LiveView
from posor_lab.reports.graph_receiver import GraphWatch

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from posor.numerics.array_types import FloatArray
    from posor_bringup.supervisor import Parameter, Supervisor
    from posor_drivers.simulator.arm_simulation import ArmSimulation
    from rich.console import Console

    from posor_lab.arm_study.arm_receiver import ArmReceiver
    from posor_lab.arm_study.arm_record import ArmRecord

COLUMNS = ("x", "y", "z", "length", "about X", "about Y", "about Z", "angle")
LEGEND = "um and urad, axes of the base"


class ArmLiveTable(LiveView):
    """Shows the newest tick: a table in a terminal, else lines."""

    def __init__(self, title: str, console: Console | None = None, *, live: bool = True) -> None:
        """Create the table; ``console`` and ``live`` are those of ``LiveView``."""
        super().__init__(console, live=live)
        self._title = title
        self._state = self._waiting = ""

    def show_state(self, state: str) -> None:
        """Show the present stage of the run."""
        self._state = state
        self._show_line(state)

    def show_waiting(self, missing: str) -> None:
        """Show the missing messages for which the run waits, once."""
        waiting = f"{self._state}, waiting for {missing}"
        if waiting != self._waiting:
            self._waiting = waiting
            self._show_line(waiting)

    def _show_line(self, text: str) -> None:
        if self.is_live:
            self.update(Text(f"{self._title}: {text}"), at_once=True)
        else:
            self.line(f"{self._title}: {text}")

    def show_tick(self, newest: ArmRecord, ticks: int, without_pose: int, speed: float) -> None:
        """Show the last tick of a record, how many ticks came and had no pose, and the speed of the clock."""
        caption = (
            f"NEES {newest.normalised[-1]:.1f} (6 expected); "
            f"scans {ticks}, without pose {without_pose}; speed {100.0 * speed:.0f} %"
        )
        posor, encoders, truth = newest.posor_errors[-1], newest.encoder_errors[-1], newest.truth.translations[-1]
        miss = truth - newest.target.translations[-1]
        if not self.is_live:
            position = " ".join(f"{value:+.6f}" for value in truth)
            self.line(
                f"truth {position} m; POSOR off {_length(posor[:3]):.1f} um, {_length(posor[3:]):.1f} urad; "
                f"encoders off {_length(encoders[:3]):.0f} um, {_length(encoders[3:]):.0f} urad; "
                f"{_length(miss):.0f} um from its target; {caption}"
            )
            return
        table = Table(title=f"{self._title}: {self._state}", caption=caption, header_style="bold")
        table.add_column(LEGEND)
        for name in COLUMNS:
            table.add_column(name, justify="right", min_width=9)
        table.add_row("true endpoint", *(f"{value / MICRON:.1f}" for value in truth))
        table.add_row("POSOR minus truth", *_cells(posor[:3]), *_cells(posor[3:]), style="cyan")
        table.add_row("encoders only minus truth", *_cells(encoders[:3]), *_cells(encoders[3:]))
        table.add_row("truth minus target", *_cells(miss), style="magenta")
        if np.isfinite(newest.stage[-1]).all():
            table.add_row("stage, axes of the endpoint", *_cells(newest.stage[-1]), style="dim")
        self.update(table)


def _length(vector: FloatArray) -> float:
    """Return the length in micrometres or microradians."""
    return float(np.linalg.norm(vector)) / MICRON


def _cells(vector: FloatArray) -> list[str]:
    """Return the components and the length in micrometres or microradians."""
    return [f"{value:.2f}" for value in (*(vector / MICRON), _length(vector))]


COMMON_PARAMETERS: Mapping[str, Parameter] = {"use_sim_time": True, "lossless": True}
"""Clock of this run; lossless delivery, so that a missing message was not published."""
CHAIN_PARAMETERS: Mapping[str, Parameter] = {"max_wait": 60.0}
"""The clock waits for the transforms: their delay depends on the host only."""
WARM_UP_TICKS = 40  # ticks before the scenario begins, in which subscriptions are connected
TICK_TIMEOUT_S = 10.0
"""Wall time until the clock advances although something of a tick is missing; ``tick_outcomes`` reports it."""
FIRST_TICK_TIMEOUT_S = 1.0
"""The same until all nodes publish: a node that receives the clock late begins with a later tick."""
INCOMPLETE_LIMIT_S = 60.0  # wall time without a complete tick after which the run fails
COMMAND_TIMEOUT_S = 1.0  # wall time for a controller to answer a pose; it may hold the stage
REPEAT_S = 0.2  # wall time after which the clock is published again; its delivery is best effort
FIRST_COMMAND_S = 10.0  # time of the arm's clock within which a controller must command the stage
SETTLING_S = 1.0  # time of the arm's clock for a controller to settle
SHOWN_PER_S = 4  # ticks shown per second in a terminal; one line per second elsewhere


NAMED = 3  # missing topics that a message names


def _name_first(missing: Sequence[str]) -> str:
    """Return the first missing topics, and how many more there are."""
    more = f" and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
    return "; ".join(missing[:NAMED]) + more


class ArmRun:
    """A run: ``start_nodes``, ``run_cycle``, ``start_controller``, ``run_cycle``, ``read_counters``, ``end_nodes``."""

    def __init__(
        self,
        simulation: ArmSimulation,
        supervisor: Supervisor,
        receiver: ArmReceiver,
        table: ArmLiveTable,
        *,
        driver_parameters: Mapping[str, Parameter] | None = None,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        """Prepare; nothing is started yet. ``driver_parameters``: such as ``simulated.sag``."""
        self._arm, self._rate = simulation.arm, simulation.scenario.ticks_per_second
        self._supervisor, self._receiver, self._table = supervisor, receiver, table
        self._driver_parameters = driver_parameters or {}
        self._nodes: list[RunningProgram] = []
        self._controller: RunningProgram | None = None
        self._dropouts = Dropouts(simulation)
        self._begin = simulation.scenario.cycle_ticks  # the first cycle warms up
        self._tick = self._begin - WARM_UP_TICKS
        self._complete_s = math.inf  # wall time of the latest complete tick
        self._watch = GraphWatch(supervisor, receiver, "arm", on_waiting=table.show_waiting, interrupted=interrupted)

    def start_nodes(self) -> None:
        """Start all nodes, wait for their connections, and advance to the beginning of the scenario.

        Raises ProcessError: a node failed, or something does not come.
        """
        programs = arm_programs(
            self._arm,
            driver_parameters=self._driver_parameters,
            chain_parameters=CHAIN_PARAMETERS,
            parameters=COMMON_PARAMETERS,
        )
        self._table.show_state(f"starting {len(programs)} nodes")
        self._nodes = [self._supervisor.start(program) for program in programs]
        self._watch.wait(
            lambda: not self._receiver.missing_connections(), lambda: _name_first(self._receiver.missing_connections())
        )
        self._complete_s = time.monotonic()
        while self._tick < self._begin or self._receiver.missing_topics():
            self._advance(FIRST_TICK_TIMEOUT_S if self._receiver.missing_topics() else TICK_TIMEOUT_S)

    def run_cycle(self, state: str, count: int) -> ArmRecord:
        """Run the ``count`` ticks of a cycle and return their record; ``state`` is shown in the live table.

        Raises ProcessError: a node failed, or messages stopped.
        """
        self._table.show_state(state)
        ticks = range(self._tick, self._tick + count)
        began, shown, without = time.monotonic(), 0, 0
        pause = self._rate // (SHOWN_PER_S if self._table.is_live else 1)
        for done, tick in enumerate(ticks, start=1):
            time.sleep(max(0.0, began + (done - 1) / self._rate - time.monotonic()))
            self._advance()
            without += tick_stamp_ns(tick, self._rate) not in self._receiver.poses
            if done >= shown + pause:
                newest = self._receiver.record(range(tick, tick + 1), self._rate)
                if newest.is_complete:
                    shown = done
                    speed = done / self._rate / (time.monotonic() - began)
                    self._table.show_tick(newest, done, without, speed)
        return self._receiver.record(ticks, self._rate)

    def _advance(self, timeout_s: float = TICK_TIMEOUT_S) -> None:
        """Advance the clock to just before the next tick, and wait for the results of this tick.

        Raises ProcessError: for INCOMPLETE_LIMIT_S no tick was complete.
        """
        stamp, now = tick_stamp_ns(self._tick, self._rate), tick_stamp_ns(self._tick + 1, self._rate) - 1
        dropped = self._dropouts.dropped_joints(self._tick)
        receiver, began = self._receiver, time.monotonic()
        repeat = began + REPEAT_S
        receiver.set_clock(now)

        def is_done() -> bool:
            nonlocal repeat
            waited = time.monotonic() - began
            if time.monotonic() > repeat:
                repeat += REPEAT_S
                receiver.set_clock(now)
            if missing := receiver.missing_of_tick(stamp, dropped):
                if time.monotonic() > self._complete_s + INCOMPLETE_LIMIT_S:
                    what = f"no tick was complete for {INCOMPLETE_LIMIT_S:g} s, missing: {_name_first(missing)}"
                    raise ProcessError(what, where="arm")
                return waited > timeout_s
            self._complete_s = time.monotonic()
            commanded = self._controller is None or stamp in receiver.commands or stamp not in receiver.poses
            return commanded or waited > COMMAND_TIMEOUT_S

        self._watch.wait(is_done, lambda: _name_first(receiver.missing_of_tick(stamp, dropped)))
        self._tick += 1

    def start_controller(self, controller: Path) -> None:
        """Start a controller, a Python file, while the clock stands still, then let it settle.

        Raises ProcessError: the controller failed, or sends no command.
        """
        self._table.show_state("starting the controller")
        self._controller = self._supervisor.start(
            ProgramCommand("controller", "", str(controller), (), f"/{self._arm.name}", {"use_sim_time": True})
        )
        self._watch.wait(self._receiver.has_controller, lambda: f"a publisher of {self._receiver.command_topic}")
        last = self._tick + round(FIRST_COMMAND_S * self._rate)
        while not self._receiver.commands:
            if self._tick > last:
                what = f"has published nothing on {self._receiver.command_topic} in {FIRST_COMMAND_S:g} s"
                raise ProcessError(what, where="controller")
            self._advance()
        for _ in range(round(SETTLING_S * self._rate)):
            self._advance()

    def read_counters(self) -> NodeCounters:
        """Return the counters of the nodes from diagnostics that are published from now on."""
        arm = self._arm
        chain = f"/{arm.name}/chain_node: endpoint"
        drivers = {joint: f"/{arm.name}/{joint}/driver_node: pace" for joint in arm.calibrations}
        before = {name: self._receiver.status_count(name) for name in (chain, *drivers.values())}

        def missing() -> list[str]:
            # Two each: the first one may be older than this call.
            return [name for name in before if self._receiver.status_count(name) < before[name] + 2]

        self._watch.wait(lambda: not missing(), lambda: "diagnostics of " + ", ".join(missing()))
        return NodeCounters(
            missed={joint: self._read_counter(name, "ticks_missed") for joint, name in drivers.items()},
            incomplete=self._read_counter(chain, "scans_incomplete"),
        )

    def _read_counter(self, status: str, key: str) -> int:
        return int(self._receiver.status_value(status, key) or 0)

    def end_nodes(self) -> None:
        """End the controller, then the nodes. Raises ProcessError: one ended with an error."""
        if self._controller is not None:
            self._supervisor.end([self._controller])
        self._supervisor.end(self._nodes)
