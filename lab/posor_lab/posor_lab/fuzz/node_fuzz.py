"""Damaged messages over DDS to a running posor_node and chain_node, each before a sound one, which must be answered.

The program plays the driver, or all posor_nodes, in step: it publishes a damaged message and a sound one, and waits for
the answer to the sound one. What came before that is the answer to the damaged one, judged as in ``message_fuzz``.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from geometry_msgs.msg import PoseStamped
from posor.messages.cdr_schema import STAMP
from posor.messages.joint_transform import stamp_ns_of
from posor.model.fault import USABLE_STATES
from posor.node_parameters import RECORDING
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_TOPIC, RAW_TOPIC, TRANSFORM_TOPIC
from posor_bringup.arm_programs import arm_programs
from posor_bringup.supervisor import Supervisor
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.message_conversion import pose_from_message
from rclpy.serialization import deserialize_message

from posor_lab.fuzz.message_fuzz import ScanFuzz, TransformFuzz
from posor_lab.fuzz.mutation import mutate
from posor_lab.reports.graph_receiver import GraphWatch
from posor_lab.reports.node_player import NodePlayer
from posor_lab.soak.process_sample import ProcessSample, growth_mb

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path
    from random import Random

    import pinocchio as pin
    from posor_bringup.supervisor import Parameter, Program
    from posor_drivers.simulator.arm_simulation import ArmSimulation

    from posor_lab.fuzz.message_fuzz import FuzzCount

PERIOD_NS = NS // 200
LONGEST_S = 5.0
"""Time in which a sound message is answered."""
SAMPLE_EVERY = 500
"""Messages from one sample of the node's memory to the next."""
WARM_UP_SAMPLES, LEAST_SAMPLES = 2, 4
MOST_GROWTH_MB = 1.0
LOSSLESS: dict[str, Parameter] = {"lossless": True, **RECORDING}


class NodeFuzzError(Exception):
    """A node did not answer a sound message as it should."""


@dataclass
class NodeCount:
    """Figures of a node."""

    messages: FuzzCount
    acknowledged: int = 0  # sound scans without a pose after a damaged one, until an operator acknowledged
    slowest_s: float = 0.0  # answer to a sound message
    growth_mb: float = float("nan")  # of the memory of the node; NaN: too few messages


class _NodeRun:
    """A running node and its player."""

    def __init__(self, program: Program, player: NodePlayer, supervisor: Supervisor) -> None:
        self.player = player
        self.watch = GraphWatch(supervisor, player, "fuzz")
        self._pid = supervisor.start(program).process.pid
        self._samples: list[ProcessSample] = []
        self._sent = 0
        self.slowest_s = 0.0
        self.watch.wait(player.is_ready, lambda: f"{program.name}, or one of its connections")

    def answers_until(self, stamp_ns: int) -> list[bytes]:
        """Return the answers up to the one with a stamp [ns].

        Raises:
            NodeFuzzError: It does not come.

        """
        begin_s, answers, seen = time.monotonic(), self.player.answers, 0

        def is_answered() -> bool:
            nonlocal seen
            if time.monotonic() - begin_s > LONGEST_S:
                raise NodeFuzzError(f"a sound message was not answered within {LONGEST_S:g} s")
            new, seen = answers[seen:], len(answers)
            return any(stamp_ns_of(data[STAMP]) == stamp_ns for data in new)

        self.watch.wait(is_answered, lambda: "an answer")
        self.slowest_s = max(self.slowest_s, time.monotonic() - begin_s)
        self._sent += 1
        if self._sent % SAMPLE_EVERY == 0:
            self._samples.append(ProcessSample.take(self._pid, time.monotonic()))
        found = answers.copy()
        answers.clear()
        return found

    @property
    def growth_mb(self) -> float:
        """Growth of the node's memory after the warm-up [MB]; NaN: too few samples."""
        samples = self._samples[WARM_UP_SAMPLES:]
        return growth_mb(samples) if len(samples) >= LEAST_SAMPLES else float("nan")


def _damage(data: bytes, chance: Random) -> bytes:
    """Return damaged bytes that DDS delivers: Fast DDS drops a message of 0 bytes, and a reliable reader then waits."""
    return mutate(data, chance) or data[:1]


class NodeScanFuzz:
    """Damaged raw scans of one joint to its posor_node, each in place of a scan, with the next one undamaged.

    Every scan is sent once: readings that come again are those of frozen electronics, which the node refuses.
    """

    def __init__(self, simulation: ArmSimulation, joint: str, seed: int) -> None:
        """Estimate the undamaged scans; ``seed`` is that of the damage."""
        self._fuzz = ScanFuzz(simulation, joint, seed)
        self.count = NodeCount(self._fuzz.count)
        self._namespace = f"/{simulation.arm.name}/{joint}"
        programs = arm_programs(simulation.arm, drivers=False, parameters=LOSSLESS)
        self._program = next(each for each in programs if each.namespace == self._namespace)
        self._cycle = -1

    def run(self, mutations: int, folder: Path, on_done: Callable[[int], None]) -> None:
        """Damage so many scans.

        Args:
            mutations: How often.
            folder: Existing folder for the log of the node.
            on_done: Called with 1 after each.

        Raises:
            NodeFuzzError: A sound scan was not answered, or its pose is wrong, or no pose comes after an
                acknowledgement.
            ProcessError: The node ended.

        """
        topics = [(RawScan, RAW_TOPIC)], (JointTransform, TRANSFORM_TOPIC)
        end = self.count.messages.mutations + mutations
        with Supervisor(folder) as supervisor, NodePlayer(f"{self._namespace}/posor_node", *topics) as player:
            node = _NodeRun(self._program, player, supervisor)
            while self.count.messages.mutations < end:
                self._play_cycle(node, end, on_done)
            self.count.slowest_s, self.count.growth_mb = node.slowest_s, node.growth_mb

    def _play_cycle(self, node: _NodeRun, end: int, on_done: Callable[[int], None]) -> None:
        """Play a cycle of the scenario, which begins at the home marks; end early where a sound scan has no pose."""
        self._cycle += 1
        self._fuzz.begin_cycle(self._cycle)
        node.player.acknowledge(node.watch)
        scans, usable = self._fuzz.recording.scans, self._fuzz.recording.usable
        for n in range(usable[0] + 1):
            *_, answer = self._send_sound(node, scans[n])
        if _usable_pose(answer) is None:
            raise NodeFuzzError(f"no pose from {usable[0] + 1} sound scans after an acknowledgement")
        for n, sound in zip(usable[1::2], usable[2::2], strict=False):
            data = _damage(scans[n], self._fuzz.chance)
            node.player.inputs[0].publish(data)
            *before, answer = self._send_sound(node, scans[sound])
            if len(before) > 1:
                raise NodeFuzzError(f"{len(before)} answers to one damaged scan")
            self._fuzz.judge(n, data, _usable_pose(before[0]) if before else None)
            on_done(1)
            pose = _usable_pose(answer)
            if pose is None:
                self.count.acknowledged += 1
                return
            if not self._fuzz.is_near(sound, pose):
                raise NodeFuzzError(f"the pose of sound scan {sound} is wrong after a damaged one")
            if self.count.messages.mutations == end:
                return

    @staticmethod
    def _send_sound(node: _NodeRun, data: bytes) -> list[bytes]:
        """Send an undamaged scan; return the answers up to its own."""
        node.player.inputs[0].publish(data)
        return node.answers_until(stamp_ns_of(data[STAMP]))


def _usable_pose(data: bytes) -> pin.SE3 | None:
    """Return the pose of a serialised transform that is published as valid."""
    message = deserialize_message(data, JointTransform)
    return pose_from_message(message.pose) if message.state in USABLE_STATES else None


class NodeTransformFuzz:
    """Scans with one damaged transform to a chain_node."""

    def __init__(self, simulation: ArmSimulation, seed: int) -> None:
        """Estimate the undamaged scans; ``seed`` is that of the damage."""
        self._fuzz = TransformFuzz(simulation, seed)
        self.count = NodeCount(self._fuzz.count)
        arm = simulation.arm
        self._namespace = f"/{arm.name}"
        self._inputs = [(JointTransform, f"{joint.name}/{TRANSFORM_TOPIC}") for joint in simulation.chain.joints]
        chain: dict[str, Parameter] = {
            **LOSSLESS,
            "acceleration_window": 0.0,
            "reference": "absolute",
            "max_wait": 60.0,
        }
        self._program = arm_programs(arm, drivers=False, chain_parameters=chain)[0]
        self._stamp_ns = NS

    def run(self, mutations: int, folder: Path, on_done: Callable[[int], None]) -> None:
        """Damage so many transforms; see ``NodeScanFuzz.run``."""
        node_name, answer = f"{self._namespace}/chain_node", (PoseStamped, ENDPOINT_TOPIC)
        with Supervisor(folder) as supervisor, NodePlayer(node_name, self._inputs, answer) as player:
            node = _NodeRun(self._program, player, supervisor)
            for _ in range(mutations):
                scan, j = self._fuzz.choose()
                damaged = self._next_scan(scan)
                damaged[j] = _damage(damaged[j], self._fuzz.chance)
                self._send(player, damaged)
                self._send(player, self._next_scan(scan))
                *before, answer = map(_pose_of_message, node.answers_until(self._stamp_ns))
                if len(before) > 1:
                    raise NodeFuzzError(f"{len(before)} poses of one damaged scan")
                if not self._fuzz.is_near(scan, answer):
                    raise NodeFuzzError("the pose of a sound scan is wrong after a damaged one")
                self._fuzz.judge(scan, j, before[0] if before else None)
                on_done(1)
            self.count.slowest_s, self.count.growth_mb = node.slowest_s, node.growth_mb

    def _next_scan(self, scan: Sequence[bytes]) -> list[bytes]:
        """Return the transforms of a scan with the next stamp."""
        self._stamp_ns += PERIOD_NS
        stamp = np.array(divmod(self._stamp_ns, NS), dtype="<u4").tobytes()
        return [data[: STAMP.start] + stamp + data[STAMP.stop :] for data in scan]

    @staticmethod
    def _send(player: NodePlayer, scan: Sequence[bytes]) -> None:
        for publisher, data in zip(player.inputs, scan, strict=True):
            publisher.publish(data)


def _pose_of_message(data: bytes) -> pin.SE3:
    """Return the pose of a serialised PoseStamped."""
    return pose_from_message(deserialize_message(data, PoseStamped).pose)
