# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Replay of a bag through driver, POSOR, chain and recorder, each in its own process, and the steps that they give."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from posor.model.fault import Fault, State
from posor.node_parameters import RECORDING
from posor.ros_names import ENDPOINT_TOPIC, RAW_TOPIC, TRANSFORM_TOPIC, TRUTH_TOPIC
from posor_bringup.supervisor import ProcessError, ProgramCommand, RunningProgram, Supervisor
from posor_msgs.msg import JointTransform
from posor_ros.lifecycle_node import LISTENERS_STATUS

from posor_lab.harness.message_conversion import is_usable
from posor_lab.harness.rig_files import JOINT
from posor_lab.replay_1985.motion_test import MotionStep
from posor_lab.reports.graph_receiver import GraphReceiver, GraphWatch

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from posor_bringup.supervisor import Parameter


class StepCollector(GraphReceiver):
    """Subscribes to the transforms of one joint, the endpoint and the machining centre.

    A step is complete with a transform and a machining-centre reading, and an endpoint if the transform is usable.
    """

    def __init__(self, joint: str) -> None:
        """Subscribe; ``joint``: namespace of the joint, such as ``joint1``."""
        super().__init__("demo")
        self.transforms = self.store_topic(JointTransform, f"/{joint}/{TRANSFORM_TOPIC}")
        self.poses = self.store_topic(PoseStamped, f"/{ENDPOINT_TOPIC}")
        self.truths = self.store_topic(PointStamped, TRUTH_TOPIC)

    def missing(self) -> list[str]:
        """Return the messages that are missing although another message of the same scan has arrived."""
        stamps = sorted(self.truths.keys() | self.transforms.keys() | self.poses.keys())
        usable = [stamp for stamp, transform in self.transforms.items() if is_usable(transform)]
        return [
            *(f"machining-centre reading of {self._scan_name(stamp)}" for stamp in stamps if stamp not in self.truths),
            *(f"transform of {self._scan_name(stamp)}" for stamp in stamps if stamp not in self.transforms),
            *(f"endpoint of {self._scan_name(stamp)}" for stamp in usable if stamp not in self.poses),
        ]

    def _scan_name(self, stamp: int) -> str:
        transform = self.transforms.get(stamp)
        return f"the scan at {stamp / 1e9:.3f} s" if transform is None else f"scan {transform.scan}"

    def complete_steps(self) -> list[MotionStep]:
        """Return the steps received so far, up to the first incomplete one."""
        steps = []
        for stamp in sorted(self.truths.keys() | self.transforms.keys()):
            transform = self.transforms.get(stamp)
            if transform is None or stamp not in self.truths or (is_usable(transform) and stamp not in self.poses):
                break
            steps.append(self._step(stamp))
        return steps

    def _step(self, stamp: int) -> MotionStep:
        transform, truth, pose = self.transforms[stamp], self.truths[stamp].point, self.poses.get(stamp)
        point = None if pose is None else pose.pose.position
        return MotionStep(
            number=int(transform.scan),
            state=State(transform.state),
            faults=Fault(transform.faults),
            scan_status=int(transform.scan_status),
            angles=np.array(transform.native[3:6], dtype=float),
            truth=np.array([truth.x, truth.y, truth.z]),
            endpoint=np.full(3, np.nan) if point is None else np.array([point.x, point.y, point.z]),
        )


TOPICS = (f"/{JOINT}/{RAW_TOPIC}", f"/{JOINT}/{TRANSFORM_TOPIC}", f"/{ENDPOINT_TOPIC}", TRUTH_TOPIC)  # recorded topics

LOSSLESS: Mapping[str, Parameter] = {"lossless": True, **RECORDING}
"""Parameters that make a fast publisher wait for a slow subscriber and accept recorded stamps."""

_SUBSCRIPTIONS: Mapping[str, tuple[str, int]] = {
    f"/{JOINT}/posor_node": (TRANSFORM_TOPIC, 3),  # chain, recorder, collector
    "/chain_node": (ENDPOINT_TOPIC, 2),  # recorder, collector
}
"""Topic of a node and its number of subscriptions before the replay begins."""


@dataclass(frozen=True)
class ReplayPlan:
    """Files and options of a replay."""

    bag: Path  # recorded scans and machining-centre readings
    calibration: Path  # calibration file of the POSOR
    session: str  # session of the calibration file
    urdf: Path  # the rig
    output: Path  # existing folder; gets the new ``bag`` and ``logs`` of the programs
    rate: float = 0.0  # speed, 1 is real time; 0: as fast as possible
    loop: bool = False  # whether the driver repeats the bag without end

    @property
    def recorded(self) -> Path:
        """The bag of the recorder."""
        return self.output / "bag"

    def programs(self) -> dict[str, ProgramCommand]:
        """Return the programs by name; the driver waits for its activation, then for POSOR, recorder and collector."""
        driver: dict[str, Parameter] = {
            "autostart": False,
            "source": "bag",
            "bag.path": str(self.bag.resolve()),
            "bag.other_topics": [TRUTH_TOPIC],
            "rate": float(self.rate),
            "loop": self.loop,
            "wait_for_subscribers": 2,
            "wait_for_other_subscribers": 2,
            "on_end": "exit",
            **LOSSLESS,
        }
        posor = {"calibration": str(self.calibration.resolve()), "session": self.session, **LOSSLESS}
        chain = {"urdf": str(self.urdf.resolve()), **LOSSLESS}
        record = ("--output", str(self.recorded.resolve()), "--topics", *TOPICS)
        programs = (
            ProgramCommand("driver_node", "posor_drivers", "driver_node", (), f"/{JOINT}", driver, ends=True),
            ProgramCommand("posor_node", "posor_estimator", "posor_node", (), f"/{JOINT}", posor),
            ProgramCommand("chain_node", "posor_estimator", "chain_node", (), "", chain),
            ProgramCommand("record", "posor_drivers", "record", record),
        )
        return {program.name: program for program in programs}


class Replay:
    """One replay: ``start``, ``activate_driver``, ``wait_for_end``, ``stop``.

    All methods raise ProcessError if a program ends unexpectedly or expected messages do not arrive.
    """

    def __init__(
        self,
        plan: ReplayPlan,
        supervisor: Supervisor,
        collector: StepCollector,
        *,
        on_steps: Callable[[Sequence[MotionStep]], None] = lambda _steps: None,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        """Create the replay without starting it.

        ``on_steps`` is called with all complete steps when messages have arrived.
        """
        self.plan, self.collector, self._supervisor = plan, collector, supervisor
        self._running: dict[str, RunningProgram] = {}

        def on_received() -> None:
            on_steps(collector.complete_steps())

        self._watch = GraphWatch(supervisor, collector, "demo", on_received=on_received, interrupted=interrupted)

    def start(self) -> None:
        """Start and configure all programs, and wait until all subscriptions exist."""
        for name, program in self.plan.programs().items():
            self._running[name] = self._supervisor.start(program)
        self._change_driver_state(Transition.TRANSITION_CONFIGURE, "configure", "inactive")
        self.wait_for_subscriptions()

    def wait_for_subscriptions(self) -> None:
        """Wait until POSOR and chain have all their subscriptions; the driver waits for its own."""
        self.wait_until(lambda: not self._missing_subscriptions(), lambda: ", ".join(self._missing_subscriptions()))

    def _missing_subscriptions(self) -> list[str]:
        return [
            f"{count} subscriptions to the {topic} of {node}"
            for node, (topic, count) in _SUBSCRIPTIONS.items()
            if int(self.collector.status_value(f"{node}: {LISTENERS_STATUS}", topic) or 0) < count
        ]

    def _change_driver_state(self, transition: int, verb: str, state: str) -> None:
        """Request a lifecycle transition of the driver and wait for its response or for the state.

        A service drops its response if it has not yet discovered the reader of the client: diagnostics count as well.
        """
        client = self.collector.create_client(ChangeState, f"/{JOINT}/driver_node/change_state")
        self.wait_until(client.service_is_ready, lambda: "the driver's lifecycle service")
        response = client.call_async(ChangeState.Request(transition=Transition(id=transition)))
        status = f"/{JOINT}/driver_node: lifecycle"
        self.wait_until(
            lambda: response.done() or self.collector.status_value(status, "message") == state,
            lambda: "the driver's response",
        )
        self.collector.destroy_client(client)
        if response.done() and not response.result().success:
            reason = self._running["driver_node"].last_sentence()
            raise ProcessError(f"cannot {verb}: {reason}", where="driver_node")

    def activate_driver(self) -> None:
        """Activate the driver, which publishes the bag."""
        self._change_driver_state(Transition.TRANSITION_ACTIVATE, "activate", "active")

    def wait_for_end(self) -> None:
        """Wait until the driver has published everything and all following messages have arrived."""
        self.wait_until(lambda: self._running["driver_node"].has_ended, lambda: "the end of the driver")
        self.wait_until(lambda: not self._outstanding(), lambda: ", ".join(self._outstanding()))

    def _outstanding(self) -> list[str]:
        truths = [] if self.collector.truths else ["any machining-centre reading"]
        identity = [] if self.calibration_identity()["calibration_hash"] else ["the POSOR node's calibration hash"]
        return self.collector.missing() + truths + identity

    def calibration_identity(self) -> dict[str, str]:
        """Return file, hash and session of the POSOR node's calibration from its diagnostics; empty: not received."""
        keys = ("calibration", "calibration_hash", "session")
        return {key: self.collector.status_value(f"/{JOINT}/posor_node: estimate", key) or "" for key in keys}

    def stop(self) -> None:
        """End driver, nodes and recorder in this order, so that the recorder gets all messages."""
        for names in (("driver_node",), ("posor_node", "chain_node"), ("record",)):
            self._supervisor.end([self._running[name] for name in names])

    def kill_node(self, name: str) -> None:
        """Kill ``posor_node`` or ``chain_node`` as in a crash."""
        self._supervisor.kill(self._running[name])
        for node in _SUBSCRIPTIONS:
            if node.endswith(f"/{name}"):
                self.collector.forget_node(node)

    def start_node(self, name: str) -> None:
        """Start a node again that was killed."""
        self._running[name] = self._supervisor.start(self._running[name].program)

    def wait_until(self, condition: Callable[[], bool], missing: Callable[[], str]) -> None:
        """Receive until a condition holds, see ``GraphWatch.wait``."""
        self._watch.wait(condition, missing)
