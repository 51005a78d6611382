"""Replays a bag through driver, POSOR, chain and recorder, each a process of its own, and collects the outcome."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from posor_estimator.ros.listeners import STATUS
from posor_estimator.ros.qos import ENDPOINT_TOPIC, RAW_TOPIC, TRANSFORM_TOPIC, TRUTH_TOPIC

from posor_bringup.installed import JOINT
from posor_bringup.supervisor import ProcessError, Program, RunningProgram, Supervisor
from posor_bringup.watch import Watch

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from posor_bringup.collector import Collector
    from posor_bringup.motion import Step
    from posor_bringup.supervisor import Parameter

TOPICS = (f"/{JOINT}/{RAW_TOPIC}", f"/{JOINT}/{TRANSFORM_TOPIC}", f"/{ENDPOINT_TOPIC}", TRUTH_TOPIC)
"""What is recorded."""

LOSSLESS: Mapping[str, Parameter] = {"qos_reliability": "reliable", "qos_depth": 0}
"""Parameters that make a fast publisher wait for a slow subscriber."""

_LISTENERS: Mapping[str, tuple[str, int]] = {
    f"/{JOINT}/posor_node": (TRANSFORM_TOPIC, 3),  # chain, recorder, collector
    "/chain_node": (ENDPOINT_TOPIC, 2),  # recorder, collector
}
"""Subscriptions that a node has to have on a topic before the replay begins."""


@dataclass(frozen=True)
class ReplayPlan:
    """What to replay with what.

    Attributes:
        bag: The recorded scans and machining-centre readings.
        calibration: Calibration file of the POSOR.
        session: Session of the calibration file.
        urdf: The rig.
        output: Existing folder; the recorder makes ``bag`` in it, and ``logs`` gets what the programs write.
        rate: Speed, 1 is real time; 0: as fast as possible.
        loop: Whether the driver starts over at the end, for ever.

    """

    bag: Path
    calibration: Path
    session: str
    urdf: Path
    output: Path
    rate: float = 0.0
    loop: bool = False

    @property
    def recorded(self) -> Path:
        """The bag that the recorder makes."""
        return self.output / "bag"

    def driver(self) -> Program:
        """Return the driver; it waits to be activated, then until POSOR, recorder and collector listen."""
        parameters: dict[str, Parameter] = {
            "autostart": False,
            "source": "bag",
            "bag.path": str(self.bag.resolve()),
            "bag.other_topics": [TRUTH_TOPIC],
            "rate": float(self.rate),
            "loop": self.loop,
            "wait_for_subscribers": 2,
            "wait_for_other_subscribers": 2,
            "on_end": "exit",
        }
        return Program(
            "driver_node", "posor_drivers", "driver_node", (), f"/{JOINT}", {**parameters, **LOSSLESS}, ends=True
        )

    def posor(self) -> Program:
        """Return the POSOR node."""
        parameters = {"calibration": str(self.calibration.resolve()), "session": self.session}
        return Program("posor_node", "posor_estimator", "posor_node", (), f"/{JOINT}", {**parameters, **LOSSLESS})

    def chain(self) -> Program:
        """Return the chain node."""
        return Program(
            "chain_node", "posor_estimator", "chain_node", (), "", {"urdf": str(self.urdf.resolve()), **LOSSLESS}
        )

    def recorder(self) -> Program:
        """Return the recorder."""
        arguments = ("--output", str(self.recorded.resolve()), "--topics", *TOPICS)
        return Program("record", "posor_drivers", "record", arguments)


class Replay:
    """One replay: ``listen``, ``begin``, ``complete``, ``finish``."""

    _driver: RunningProgram
    _nodes: list[RunningProgram]
    _recorder: RunningProgram

    def __init__(
        self,
        plan: ReplayPlan,
        supervisor: Supervisor,
        collector: Collector,
        *,
        on_steps: Callable[[Sequence[Step]], None] = lambda _steps: None,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        """Prepare.

        Args:
            plan: What to replay.
            supervisor: Starts and ends the processes.
            collector: Node that receives.
            on_steps: Called with all complete steps so far, whenever something has arrived.
            interrupted: Whether to give up.

        """
        self.plan = plan
        self.collector = collector
        self._supervisor = supervisor
        self._watch = Watch(
            supervisor,
            collector,
            "replay",
            on_received=lambda: on_steps(collector.steps()),
            interrupted=interrupted,
        )

    def listen(self) -> None:
        """Start all programs and wait until those that listen have found those that publish.

        Raises:
            ProcessError: One ended, or they did not find one another.

        """
        start = self._supervisor.start
        self._driver = start(self.plan.driver())
        self._nodes = [start(program) for program in (self.plan.posor(), self.plan.chain())]
        self._recorder = start(self.plan.recorder())
        self._change(Transition.TRANSITION_CONFIGURE, "configure", "inactive")
        self.connect()

    def connect(self) -> None:
        """Wait until POSOR and chain have all their listeners.

        Raises:
            ProcessError: A program ended, or they did not find one another.

        """
        self.wait(lambda: not self._unconnected(), lambda: ", ".join(self._unconnected()))

    def _unconnected(self) -> list[str]:
        """Return the topics that lack listeners; the driver looks after its own."""
        return [
            f"{wanted} subscriptions to the {topic} of {node}"
            for node, (topic, wanted) in _LISTENERS.items()
            if int(self.collector.value(f"{node}: {STATUS}", topic) or 0) < wanted
        ]

    def _change(self, transition: int, name: str, goal: str) -> None:
        """Ask the driver for a transition of its lifecycle and wait until it says yes, or is in the state of the goal.

        A service drops its answer where it has not found the client's reader yet, so the diagnostics count as well.

        Raises:
            ProcessError: It refuses.

        """
        client = self.collector.create_client(ChangeState, f"/{JOINT}/driver_node/change_state")
        self.wait(client.service_is_ready, lambda: "the driver's lifecycle service")
        answer = client.call_async(ChangeState.Request(transition=Transition(id=transition)))
        driver = f"/{JOINT}/driver_node: lifecycle"
        self.wait(
            lambda: answer.done() or self.collector.value(driver, "message") == goal, lambda: "the driver's answer"
        )
        self.collector.destroy_client(client)
        if answer.done() and not answer.result().success:
            raise ProcessError(f"cannot {name}: {self._driver.last_sentence()}", where="driver_node")

    def begin(self) -> None:
        """Activate the driver.

        Raises:
            ProcessError: It refuses, or a program ended as it should not.

        """
        self._change(Transition.TRANSITION_ACTIVATE, "activate", "active")

    def complete(self) -> None:
        """Wait until the driver has published all and everything that follows has arrived.

        Raises:
            ProcessError: A program ended as it should not, or something did not arrive.

        """
        self.wait(lambda: self._driver.has_ended, lambda: "the end of the driver")
        self.wait(lambda: not self._outstanding(), lambda: ", ".join(self._outstanding()))

    def _outstanding(self) -> list[str]:
        nothing = [] if self.collector.truths else ["any machining-centre reading"]
        unnamed = [] if self.identity()["calibration_hash"] else ["what calibration the POSOR node has"]
        return self.collector.missing() + nothing + unnamed

    def identity(self) -> dict[str, str]:
        """Return what the POSOR node says of its calibration: file, hash, session; empty where it has not yet."""
        keys = ("calibration", "calibration_hash", "session")
        return {key: self.collector.value(f"/{JOINT}/posor_node: estimate", key) or "" for key in keys}

    def finish(self) -> None:
        """End the driver if it still runs, then the nodes, then the recorder, so that it has all they published.

        Raises:
            ProcessError: One did not end as it should.

        """
        self._supervisor.end([self._driver])
        self._supervisor.end(self._nodes)
        self._supervisor.end([self._recorder])

    def restart(self, name: str) -> None:
        """Kill ``posor_node`` or ``chain_node`` as a crash would and start it anew."""
        index = next(index for index, running in enumerate(self._nodes) if running.program.name == name)
        self._supervisor.kill(self._nodes[index])
        for node in _LISTENERS:
            if node.endswith(f"/{name}"):
                self.collector.forget(node)
        self._nodes[index] = self._supervisor.start(self._nodes[index].program)

    def wait(self, until: Callable[[], bool], lacking: Callable[[], str]) -> None:
        """Receive until a condition holds, see ``Watch.wait``."""
        self._watch.wait(until, lacking)
