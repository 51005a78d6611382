# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Faulty messages: the program plays one node of the test rig and publishes faulted raw scans or transforms.

The other nodes are the real ones. ``inject`` of a row: ``topic``; ``set``, ``add`` and ``times``, each with values by
the places of fields, such as ``native.5``; ``drop_last`` element of a field; ``shift_stamp_s``; ``beside``: whether a
second publisher sends the faulty message beside the sound one.
"""

from __future__ import annotations

import time
from copy import deepcopy
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.messages.message_definitions import MessageTypes
from posor.model.native_coordinates import native_from_rotation
from posor.numerics.stamps import NS, first_tick_after, tick_stamp_ns
from posor.ros_names import RAW_TOPIC
from posor_bringup.arm_programs import arm_programs
from posor_drivers.message_builder import SimulatedMessages
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.qos import RELIABLE_QOS
from rclpy.serialization import deserialize_message

from posor_lab.faults.fault_table import RATES
from posor_lab.faults.injection_run import InjectionRun
from posor_lab.harness.message_conversion import pose_message, stamp_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from posor_bringup.supervisor import ProgramCommand

    from posor_lab.faults.fault_table import FaultRow

RATE = RATES["test_rig"]
POLL_S = 0.002  # time between two looks for due ticks
SIGMA = 1e-6  # standard deviation of the played transforms [m], [rad]
OPERATIONS: Mapping[str, Callable[[Any, Any], Any]] = {
    "set": lambda _old, value: value,
    "add": lambda old, value: [each + value for each in old] if np.ndim(old) else old + value,
    "times": lambda old, value: old * value,
}


def change_message(message: Any, inject: Mapping[str, Any]) -> None:
    """Change the fields of a message as a row of the fault table states."""
    for name, operation in OPERATIONS.items():
        for place, value in inject.get(name, {}).items():
            _change(message, place, lambda old, value=value, operation=operation: operation(old, value))  # type: ignore[misc]
    if "drop_last" in inject:
        _change(message, inject["drop_last"], lambda old: old[:-1])
    if "shift_stamp_s" in inject:
        shifted_ns = stamp_ns(message) + round(inject["shift_stamp_s"] * NS)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(shifted_ns, NS)


def _change(message: Any, place: str, operation: Callable[[Any], Any]) -> None:
    """Change the field or the element of a field at a place such as ``pose.position.x`` or ``native.5``."""
    name, _, rest = place.partition(".")
    old = getattr(message, name)
    if not rest:
        setattr(message, name, operation(old))
    elif rest.isdigit():
        values = list(old)
        values[int(rest)] = operation(values[int(rest)])
        setattr(message, name, np.array(values) if isinstance(old, np.ndarray) else values)
    else:
        _change(old, rest, operation)


class MessageRun(InjectionRun):
    """A run of the test rig in which the program plays the publisher of one topic."""

    TITLE = "messages on {0.inject[topic]}"
    SOUND_S, FAULT_S, ACKNOWLEDGE_S, REST_S = 0.4, 0.4, 0.1, 0.4

    def _programs(self) -> list[ProgramCommand]:
        """Return all nodes but driver_node, and but posor_node if this program replaces it."""
        (self._joint,) = self.joints
        self._topic = str(self.rows[0].inject["topic"])
        unused = "" if self._topic == RAW_TOPIC else "posor_node"
        return [each for each in arm_programs(self.arm, drivers=False) if each.executable != unused]

    def _joint_of(self, _row: FaultRow) -> str:
        return self._joint if self._topic == RAW_TOPIC else ""

    def _prepare(self) -> None:
        """Publish a message at every tick from now on."""
        self._messages = SimulatedMessages(MessageTypes(), self.simulation)
        self._faulty: FaultRow | None = None
        self._publishers = [self._new_publisher()]
        self._next = first_tick_after(time.time_ns(), RATE)
        self.receiver.create_timer(POLL_S, self._publish_due)

    def _begin(self, row: FaultRow) -> None:
        if row.inject.get("beside"):
            self._publishers.append(self._new_publisher())
        self._faulty = row

    def _end(self, _row: FaultRow) -> None:
        self._faulty = None
        for second in self._publishers[1:]:
            self.receiver.destroy_publisher(second)
        del self._publishers[1:]

    def _new_publisher(self) -> Any:
        kind = RawScan if self._topic == RAW_TOPIC else JointTransform
        return self.receiver.create_publisher(kind, f"/{self.arm.name}/{self._joint}/{self._topic}", RELIABLE_QOS)

    def _publish_due(self) -> None:
        while tick_stamp_ns(self._next, RATE) <= time.time_ns():
            tick, self._next = self._next, self._next + 1
            message = self._message(tick)
            changed = deepcopy(message)
            if self._faulty is not None:
                change_message(changed, self._faulty.inject)
            pairs = list(zip(self._publishers, [message, changed][-len(self._publishers) :], strict=True))
            for publisher, sent in pairs if tick % 2 else reversed(pairs):  # each of two comes first in turn
                publisher.publish(sent)

    def _message(self, tick: int) -> Any:
        """Return the sound message of a tick."""
        ticks = np.array([tick])
        if self._topic == RAW_TOPIC:
            scans = self.simulation.scans(self._joint, ticks)
            return deserialize_message(self._messages.raw_scan(self._joint, scans, 0).data, RawScan)
        frames = self.simulation.calibrations[self._joint].frames
        pose = self.simulation.truth(ticks).T_parent_child[self._joint][0]
        message = JointTransform(child_frame_id=frames.child, scan=tick)
        message.header.frame_id = frames.parent
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(tick_stamp_ns(tick, RATE)), NS)
        message.pose = pose_message(pose)
        message.covariance_random = message.covariance_systematic = (0.5 * SIGMA**2 * np.eye(6)).ravel()
        message.native = [*pose.translation.tolist(), *native_from_rotation(pose.rotation)]
        return message
