# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Damaged messages over DDS to a running posor_node and chain_node, each before a sound one, which must be answered.

The program plays the driver, or all posor_nodes, in step: it publishes a damaged message and a sound one, and waits for
the answer to the sound one. An earlier answer belongs to the damaged message and is judged as in ``message_fuzz``.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from geometry_msgs.msg import PoseStamped
from posor.estimation.clocks import NEW_RATE_RUN
from posor.messages.cdr_schema import STAMP
from posor.messages.joint_transform import stamp_ns_of
from posor.model.fault import USABLE_STATES
from posor.node_parameters import RECORDING
from posor.numerics.stamps import NS
from posor.ros_names import ENDPOINT_TOPIC, RAW_TOPIC, TRANSFORM_TOPIC
from posor_bringup.arm_programs import arm_programs
from posor_msgs.msg import JointTransform, RawScan
from rclpy.serialization import deserialize_message

from posor_lab.fuzz.message_fuzz import ScanFuzz, TransformFuzz, mutate
from posor_lab.harness.message_conversion import pose_from_message
from posor_lab.reports.graph_receiver import NodePlayer, running_graph
from posor_lab.soak.process_sample import ProcessSample, growth_mb

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import pinocchio as pin
    from posor_bringup.supervisor import Parameter, ProgramCommand
    from posor_drivers.simulator.arm_simulation import ArmSimulation

    from posor_lab.fuzz.message_fuzz import MessageFuzz
    from posor_lab.reports.graph_receiver import GraphWatch, Topic

PERIOD_NS = NS // 200
LONGEST_S = 5.0  # time in which a sound message is answered
SAMPLE_EVERY = 500  # messages from one sample of the node's memory to the next
WARM_UP_SAMPLES, LEAST_SAMPLES = 2, 4
LOSSLESS: dict[str, Parameter] = {"lossless": True, **RECORDING}


class NodeFuzzError(Exception):
    """A node did not answer a sound message as it should."""


class NodeFuzz(ABC):
    """Damages messages to one node.

    Attributes:
        fuzz: Damages and judges the messages.
        acknowledged: Sound scans without a pose after a damaged one, until an operator acknowledged.
        slowest_s: Slowest answer to a sound message.

    """

    player: NodePlayer
    watch: GraphWatch

    def __init__(self, program: ProgramCommand, fuzz: MessageFuzz, inputs: Sequence[Topic], answer: Topic) -> None:
        """Prepare; inputs and answer of the node as in ``NodePlayer``."""
        self._program, self.fuzz, self._inputs, self._answer = program, fuzz, inputs, answer
        self.acknowledged, self.slowest_s = 0, 0.0
        self._sent, self._samples = 0, list[ProcessSample]()

    def run(self, mutations: int, folder: Path, on_done: Callable[[int], None]) -> None:
        """Damage messages; the log of the node is in ``folder``, and ``on_done`` is called with 1 after each message.

        Raises NodeFuzzError: a sound message was not answered, or its pose is wrong, or no pose comes after an
        acknowledgement. Raises ProcessError: the node ended.
        """
        name = f"{self._program.namespace}/{self._program.executable}"
        self.player = NodePlayer(name, self._inputs, self._answer)
        end = self.fuzz.outcomes.total() + mutations
        with running_graph([self._program], self.player, folder, "fuzz") as self.watch:
            self.watch.wait(self.player.is_ready, lambda: f"{name}, or one of its connections")
            while self.fuzz.outcomes.total() < end:
                self.play(end, on_done)

    @abstractmethod
    def play(self, end: int, on_done: Callable[[int], None]) -> None:
        """Send some messages, at most until ``end`` of them have been damaged."""

    def send(self, messages: Sequence[bytes]) -> None:
        """Publish one message to each input."""
        for publisher, data in zip(self.player.inputs, messages, strict=True):
            publisher.publish(data)

    def send_sound(self, messages: Sequence[bytes]) -> list[bytes]:
        """Publish undamaged messages; return the answers up to the one with their stamp.

        Raises NodeFuzzError: the answer does not come.
        """
        self.send(messages)
        stamp_ns, begin_s = stamp_ns_of(messages[0][STAMP]), time.monotonic()
        answers, seen = self.player.answers, 0

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
            (node,) = self.watch.running.values()
            self._samples.append(ProcessSample.take(node.process.pid, time.monotonic()))
        found = answers.copy()
        answers.clear()
        if len(found) > 2:  # noqa: PLR2004  of the damaged and of the sound message
            raise NodeFuzzError(f"{len(found) - 1} answers to one damaged message")
        return found

    @property
    def growth_mb(self) -> float:
        """Growth of the node's memory after the warm-up [MB]; NaN: too few samples."""
        samples = self._samples[WARM_UP_SAMPLES:]
        return growth_mb(samples) if len(samples) >= LEAST_SAMPLES else math.nan


class NodeScanFuzz(NodeFuzz):
    """Damaged raw scans of one joint to its posor_node, each in place of a scan, with the next one undamaged.

    Every scan is sent once: readings that come again are those of frozen electronics, which the node refuses.
    """

    def __init__(self, simulation: ArmSimulation, joint: str, seed: int) -> None:
        """Estimate the undamaged scans; ``seed`` is that of the damage."""
        self._fuzz, self._cycle = ScanFuzz(simulation, joint, seed), -1
        programs = arm_programs(simulation.arm, drivers=False, parameters=LOSSLESS)
        program = next(each for each in programs if each.namespace == f"/{simulation.arm.name}/{joint}")
        program = replace(program, parameters={**program.parameters, "acknowledge_interval": 0.0})
        super().__init__(program, self._fuzz, [(RawScan, RAW_TOPIC)], (JointTransform, TRANSFORM_TOPIC))

    def play(self, end: int, on_done: Callable[[int], None]) -> None:
        """Play a cycle of the scenario, which begins at the home marks; end early where a sound scan has no pose."""
        self._cycle += 1
        self._fuzz.begin_cycle(self._cycle)
        self.player.acknowledge(self.watch)
        scans, usable = self._fuzz.recording.scans, self._fuzz.recording.usable
        for sent in range(usable[0] + NEW_RATE_RUN):
            *_, answer = self.send_sound([scans[sent]])
            if sent >= usable[0] and _usable_pose(answer) is not None:
                break
        else:
            raise NodeFuzzError(f"no pose from {usable[0] + NEW_RATE_RUN} sound scans after an acknowledgement")
        later = [n for n in usable if n > sent]
        for n, sound in zip(later[::2], later[1::2], strict=False):
            data = _damage(scans[n], self._fuzz)
            self.send([data])
            *before, pose = map(_usable_pose, self.send_sound([scans[sound]]))
            self._fuzz.judge(n, data, before[0] if before else None)
            on_done(1)
            if pose is None:
                self.acknowledged += 1
                return
            if not self._fuzz.is_near(sound, pose):
                raise NodeFuzzError(f"the pose of sound scan {sound} is wrong after a damaged one")
            if self._fuzz.outcomes.total() == end:
                return


class NodeTransformFuzz(NodeFuzz):
    """Scans with one damaged transform to a chain_node."""

    def __init__(self, simulation: ArmSimulation, seed: int) -> None:
        """Estimate the undamaged scans; ``seed`` is that of the damage."""
        self._fuzz, self._stamp_ns = TransformFuzz(simulation, seed), NS
        parameters: dict[str, Parameter] = {"acceleration_window": 0.0, "reference": "absolute", "max_wait": 60.0}
        program = arm_programs(simulation.arm, drivers=False, chain_parameters={**LOSSLESS, **parameters})[0]
        inputs = [(JointTransform, f"{joint.name}/{TRANSFORM_TOPIC}") for joint in simulation.chain.joints]
        super().__init__(program, self._fuzz, inputs, (PoseStamped, ENDPOINT_TOPIC))

    def play(self, _end: int, on_done: Callable[[int], None]) -> None:
        """Send one scan with a damaged transform, and a sound one."""
        scan, j = self._fuzz.choose()
        damaged = self._with_next_stamp(scan)
        damaged[j] = _damage(damaged[j], self._fuzz)
        self.send(damaged)
        *before, answer = map(_endpoint, self.send_sound(self._with_next_stamp(scan)))
        if not self._fuzz.is_near(scan, answer):
            raise NodeFuzzError("the pose of a sound scan is wrong after a damaged one")
        self._fuzz.judge(scan, j, before[0] if before else None)
        on_done(1)

    def _with_next_stamp(self, scan: Sequence[bytes]) -> list[bytes]:
        self._stamp_ns += PERIOD_NS
        stamp = np.array(divmod(self._stamp_ns, NS), dtype="<u4").tobytes()
        return [data[: STAMP.start] + stamp + data[STAMP.stop :] for data in scan]


def _damage(data: bytes, fuzz: MessageFuzz) -> bytes:
    """Return damaged bytes that DDS delivers: Fast DDS drops a message of 0 bytes, and a reliable reader then waits."""
    return mutate(data, fuzz.chance) or data[:1]


def _usable_pose(data: bytes) -> pin.SE3 | None:
    """Return the pose of a serialised transform that is published as valid."""
    message = deserialize_message(data, JointTransform)
    return pose_from_message(message.pose) if message.state in USABLE_STATES else None


def _endpoint(data: bytes) -> pin.SE3:
    return pose_from_message(deserialize_message(data, PoseStamped).pose)
