"""A simulated arm whose clock waits for it: every node a process of its own, tick after tick in lock-step.

The next tick comes once all of the last one has come, so what is measured does not depend on the machine's load.
"""

from __future__ import annotations

import itertools
import time
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any, Self

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from posor_bringup.arm_accounts import Dropouts
from posor_bringup.arm_programs import arm_programs
from posor_bringup.arms import checked_arm
from posor_drivers.simulator.arm import ArmSimulation
from posor_drivers.simulator.ticks import NS, stamp_of
from posor_estimator.ros.messages import is_usable, stamp_ns
from posor_estimator.testing.graph import LOSSLESS
from posor_estimator.testing.program import Program
from posor_estimator.testing.stamped import status_with
from posor_msgs.msg import JointTransform
from rosgraph_msgs.msg import Clock

if TYPE_CHECKING:
    from collections.abc import Callable

    from posor_bringup.supervisor import Parameter
    from posor_estimator.testing.graph import Graph

PARAMETERS: dict[str, Parameter] = {"use_sim_time": True, "qos_reliability": "reliable", "qos_depth": 0}
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
"""Where the clock stands for a tick, after its stamp: all scans of the scenarios are out by then, none of the next."""
AGAIN_S = 0.5
"""The clock's topic is best effort, so the time is told again while something is waited for."""


class SteppedArm:
    """The nodes of an arm, their clock, and what has last come on each topic.

    Attributes:
        name: Namespace of the arm.
        newest: Newest message of each topic below it.
        commanded: Whether a command for the stage belongs to every pose.

    """

    def __init__(self, graph: Graph, name: str) -> None:
        """Subscribe; ``with`` starts the nodes."""
        self._arm = checked_arm(name)
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
        self._told = (0, 0.0)

    def __enter__(self) -> Self:
        """Start the nodes and wait until they listen to one another."""
        for program in arm_programs(self._arm, chain_parameters=CHAIN_PARAMETERS, parameters=PARAMETERS):
            self._running[program.name] = self._stack.enter_context(Program(program.command()))
        self._graph.watch_diagnostics()
        for name in self._running:
            self._graph.wait_for_status(f"{self.name}/{name}: lifecycle", "active")
        self._clock = self._graph.publisher(Clock, "/clock", subscriptions=len(self._running))
        status_with(self._graph, f"{self.name}/chain_node: listeners", "endpoint/pose", "1")
        for joint in self._transforms:
            status_with(self._graph, f"{self.name}/{joint}/posor_node: listeners", "transform", "2")
            self._graph.wait_for_status(f"{self.name}/{joint}/driver_node: source", "running")
        return self

    def __exit__(self, *error: object) -> None:
        """End the nodes."""
        self._stack.close()

    def pull_plug(self, joint: str) -> None:
        """Kill the node that measures a joint, without notice."""
        self._running[f"{joint}/posor_node"].process.kill()
        del self._transforms[joint]
        self._without_pose = True

    def begin(self, tick: int) -> int:
        """Set the clock, forward or back, and return the first tick from there that all take part in.

        Nothing tells whether all have noticed before the clock moves on; who has not begins a tick later.
        """
        self._tell(tick - 1)
        for first in itertools.count(tick):
            self._tell(first)
            has_come = self._condition(first)
            deadline = time.monotonic() + 2.0 * AGAIN_S
            while time.monotonic() < deadline:
                if has_come():
                    return first
                self._graph.receive()
        raise AssertionError

    def step(self, tick: int) -> None:
        """Move the clock to a tick and wait until all that belongs to it has come."""
        self._tell(tick)
        self._graph.wait_until(self._condition(tick), f"tick {tick}", self._tell_again)

    def _tell(self, tick: int) -> None:
        self._told = (tick, time.monotonic())
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(stamp_of(tick, self._rate) + AFTER_NS, NS)
        self._clock.publish(message)

    def _tell_again(self) -> None:
        tick, when = self._told
        if time.monotonic() > when + AGAIN_S:
            self._tell(tick)

    def _condition(self, tick: int) -> Callable[[], bool]:
        """Return a function that tells whether all that belongs to a tick has come."""
        stamp, dropped = stamp_of(tick, self._rate), self._dropouts.at(tick)
        measured = [topic for joint, topic in self._transforms.items() if joint not in dropped]
        whole = not dropped and not self._without_pose
        after = ("endpoint/pose", "stage/command") if self.commanded else ("endpoint/pose",)

        def come(*topics: str) -> bool:
            return all(stamp_ns(self.newest[topic]) == stamp for topic in topics)

        def has_come() -> bool:
            if not come(*FROM_DRIVER, *measured):
                return False
            return come(*after) or not (whole and all(is_usable(self.newest[topic]) for topic in measured))

        return has_come
