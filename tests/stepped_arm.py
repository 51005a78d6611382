"""A simulated arm with one process per node, whose clock advances once everything of the last tick has come.

Its results do not depend on the load of the host.
"""

from __future__ import annotations

import itertools
import math
import time
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any, Self

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from posor.numerics.stamps import NS, tick_stamp_ns
from posor_bringup.arm_programs import arm_programs
from posor_bringup.arms import load_checked_arm
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_lab.arm_study.arm_record import Dropouts
from posor_lab.harness.graph import LOSSLESS, wait_for_value
from posor_lab.harness.program import Program
from posor_msgs.msg import JointTransform
from posor_ros.message_conversion import is_usable, stamp_ns
from rosgraph_msgs.msg import Clock

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_bringup.supervisor import Parameter
    from posor_lab.harness.graph import Graph

PARAMETERS: dict[str, Parameter] = {
    "use_sim_time": True,
    "lossless": True,
    "freshness.max_silence": math.inf,
}
CHAIN_PARAMETERS: dict[str, Parameter] = {"max_wait": 60.0}
TOPICS = {
    "truth/endpoint": PoseStamped,
    "target/endpoint": PoseStamped,
    "stage/position": Vector3Stamped,
    "endpoint/pose": PoseStamped,
    "stage/command": Vector3Stamped,
}
FROM_DRIVER = ("truth/endpoint", "target/endpoint", "stage/position")
AFTER_NS = 3_500_000
"""Time of the clock after the stamp of a tick: all its scans have been sent, none of the next tick."""
REPEAT_S = 0.5
"""The clock is published again while waiting; its topic is best effort."""


class SteppedArm:
    """The nodes of an arm, their clock, and the newest message of each topic.

    Attributes:
        name: Namespace of the arm.
        newest: Newest message of each topic below it.
        commanded: Whether a command for the stage belongs to every pose.

    """

    def __init__(self, graph: Graph, name: str) -> None:
        """Subscribe; ``with`` starts the nodes."""
        self._arm = load_checked_arm(name)
        self.name = f"/{self._arm.name}"
        self.commanded = False
        self._graph = graph
        simulation = ArmSimulation(self._arm)
        self._dropouts = Dropouts(simulation)
        self._rate = simulation.scenario.ticks_per_second
        self._transforms = {joint: f"{joint}/transform" for joint in simulation.joints}
        self._without_pose = False
        kinds = {**TOPICS, **dict.fromkeys(self._transforms.values(), JointTransform)}
        self.newest: dict[str, Any] = {topic: kind() for topic, kind in kinds.items()}
        for topic, kind in kinds.items():
            keep = partial(self.newest.__setitem__, topic)
            graph.node.create_subscription(kind, f"{self.name}/{topic}", keep, LOSSLESS)
        self._stack = ExitStack()
        self._running: dict[str, Program] = {}
        self._clock: Any = None
        self._published = (0, 0.0)

    def __enter__(self) -> Self:
        """Start the nodes and wait for their connections; end them if that fails."""
        with ExitStack() as started:
            for program in arm_programs(self._arm, chain_parameters=CHAIN_PARAMETERS, parameters=PARAMETERS):
                self._running[program.name] = started.enter_context(Program(program.command()))
            self._graph.watch_diagnostics()
            for name in self._running:
                self._graph.wait_for_status(f"{self.name}/{name}: lifecycle", "active")
            self._clock = self._graph.publisher(Clock, "/clock", subscriptions=len(self._running))
            wait_for_value(self._graph, f"{self.name}/chain_node: listeners", "endpoint/pose", "1")
            for joint in self._transforms:
                wait_for_value(self._graph, f"{self.name}/{joint}/posor_node: listeners", "transform", "2")
                self._graph.wait_for_status(f"{self.name}/{joint}/driver_node: source", "running")
            self._stack = started.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        """End the nodes."""
        self._stack.close()

    def kill_posor_node(self, joint: str) -> None:
        """Kill the posor_node of a joint."""
        self._running[f"{joint}/posor_node"].process.kill()
        del self._transforms[joint]
        self._without_pose = True

    def begin(self, tick: int) -> int:
        """Set the clock, forward or back, and return the first tick of which everything comes.

        A node that receives the clock late begins with a later tick.
        """
        self._publish_clock(tick - 1)
        for first in itertools.count(tick):
            self._publish_clock(first)
            is_complete = self._condition(first)
            deadline = time.monotonic() + 2.0 * REPEAT_S
            while time.monotonic() < deadline:
                if is_complete():
                    return first
                self._graph.receive()
        raise AssertionError

    def step(self, tick: int) -> None:
        """Advance the clock to a tick and wait until everything of the tick has come."""
        self._publish_clock(tick)
        self._graph.wait_until(self._condition(tick), f"tick {tick}", self._repeat_clock)

    def _publish_clock(self, tick: int) -> None:
        self._published = (tick, time.monotonic())
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(tick_stamp_ns(tick, self._rate) + AFTER_NS, NS)
        self._clock.publish(message)

    def _repeat_clock(self) -> None:
        tick, when = self._published
        if time.monotonic() > when + REPEAT_S:
            self._publish_clock(tick)

    def _condition(self, tick: int) -> Callable[[], bool]:
        """Return a function that checks whether everything of a tick has come."""
        stamp, dropped = tick_stamp_ns(tick, self._rate), self._dropouts.dropped_joints(tick)
        measured = [topic for joint, topic in self._transforms.items() if joint not in dropped]
        whole = not dropped and not self._without_pose
        after = ("endpoint/pose", "stage/command") if self.commanded else ("endpoint/pose",)

        def received(*topics: str) -> bool:
            return all(stamp_ns(self.newest[topic]) == stamp for topic in topics)

        def is_complete() -> bool:
            if not received(*FROM_DRIVER, *measured):
                return False
            return received(*after) or not (whole and all(is_usable(self.newest[topic]) for topic in measured))

        return is_complete
