"""Faulty messages: the program plays one node of the test rig and publishes faulted raw scans or transforms.

The other nodes are the real ones. Each fault lasts for ``FAULT_S``, between sound messages.
"""

from __future__ import annotations

import math
import time
from copy import deepcopy
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from posor.messages.message_definitions import MessageTypes
from posor.model.native_coordinates import native_from_rotation
from posor.numerics.stamps import NS, first_tick_after, tick_stamp_ns
from posor.ros_names import RAW_TOPIC, TRANSFORM_TOPIC
from posor_bringup.arm_programs import arm_programs
from posor_bringup.supervisor import Supervisor
from posor_drivers.simulated_messages import SimulatedMessages
from posor_drivers.simulator.arm_simulation import ArmSimulation
from posor_msgs.msg import JointTransform, RawScan
from posor_ros.message_conversion import pose_message
from rclpy.duration import Duration
from rclpy.qos import LivelinessPolicy, QoSProfile
from rclpy.serialization import deserialize_message

from posor_lab.faults.fault_arm import IMPERFECTIONS, RATES, write_fault_arm
from posor_lab.faults.fault_receiver import FaultReceiver
from posor_lab.faults.fault_table import FaultRow, RowResult
from posor_lab.faults.pose_judge import PoseJudge
from posor_lab.faults.reading_faults import HOUR_S, SETTLED_POSES
from posor_lab.reports.graph_receiver import GraphWatch

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from posor_lab.faults.fault_table import FaultKind

FAULT_S, ACKNOWLEDGE_S, SLOT_S = 0.4, 0.5, 1.3
"""Duration of a fault; time from its beginning to the acknowledgement, and to the next fault."""
SOUND_S = 0.4
"""Sound messages before the first fault."""
CYCLE_S = 20
RATE = RATES["test_rig"]
TICK_NS = NS // RATE
OFFERED_QOS = QoSProfile(
    depth=10,
    deadline=Duration(seconds=0.2),
    liveliness=LivelinessPolicy.AUTOMATIC,
    liveliness_lease_duration=Duration(seconds=1.0),
)
"""What live drivers and posor_nodes offer at most, so that every subscription matches."""
SIGMA = 1e-6
"""Standard deviation of the played transforms [m], [rad]."""


class MessageFault(NamedTuple):
    """A row and the function that changes a message.

    Attributes:
        row: The fault.
        topic: Topic whose publisher is played.
        change: Changes the message; an impostor publishes it beside the sound one.
        is_impostor: Whether a second publisher sends it.

    """

    row: FaultRow
    topic: str
    change: Callable[[Any], object]
    is_impostor: bool = False


def _shift_stamp(seconds: float) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(stamp.sec * NS + stamp.nanosec + round(seconds * NS), NS)

    return change


def _set(**fields: Any) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        for name, value in fields.items():
            setattr(message, name, value)

    return change


def _set_elements(name: str, elements: dict[int, float]) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        values = np.array(getattr(message, name), dtype=float)
        for index, value in elements.items():
            values[index] = value
        setattr(message, name, values if name == "covariance" else values.tolist())

    return change


def _set_x(value: float) -> Callable[[Any], None]:
    return lambda message: setattr(message.pose.position, "x", value)


def _displace(message: JointTransform) -> None:
    message.pose.position.x += 0.01
    message.native[0] += 0.01


def _set_frame(message: Any) -> None:
    message.header.frame_id = "elsewhere"


def _double_turn(message: JointTransform) -> None:
    message.pose.orientation.w *= 2.0


def _lose_voltage(message: RawScan) -> None:
    message.gap_voltages = message.gap_voltages[:-1]


def _shift_voltages(message: RawScan) -> None:
    message.gap_voltages = [volts + 1.0 for volts in message.gap_voltages]


def _rows() -> list[MessageFault]:
    rows: list[MessageFault] = []

    def add(
        topic: str, name: str, kind: FaultKind, change: Callable[[Any], object], expected: str, *named_by: str
    ) -> None:
        row = FaultRow(f"{name} ({topic})", kind, "test_rig", expected, named_by)
        rows.append(MessageFault(row, topic, change, is_impostor="publisher" in name))

    names_joint = "no pose, names the joint and the reason"
    add(TRANSFORM_TOPIC, "stamps 1 h old", "clock", _shift_stamp(-HOUR_S), "not used, names the age", "stamp")
    add(TRANSFORM_TOPIC, "stamps 1 h ahead", "clock", _shift_stamp(HOUR_S), "not used, names the age", "stamp")
    add(TRANSFORM_TOPIC, "stamp zero", "clock", lambda m: _set(sec=0, nanosec=0)(m.header.stamp), names_joint, "stamp")
    negative = _set_elements("covariance", {0: -1e-12})
    add(TRANSFORM_TOPIC, "negative variance", "garbage", negative, names_joint, "covariance", "variance")
    skew = _set_elements("covariance", {1: 1e-12})
    add(TRANSFORM_TOPIC, "covariance not symmetric", "garbage", skew, names_joint, "covariance")
    huge = _set_elements("covariance", {0: 1e300})
    add(TRANSFORM_TOPIC, "covariance 1e300", "garbage", huge, names_joint, "covariance", "variance")
    infinite = _set_elements("covariance", {7: math.inf})
    add(TRANSFORM_TOPIC, "covariance infinite", "garbage", infinite, names_joint, "covariance", "variance")
    native = _set_elements("native", {5: math.nan})
    add(TRANSFORM_TOPIC, "native not a number", "garbage", native, names_joint, "native")
    for value in (1e300, math.nan, 0.5):
        add(TRANSFORM_TOPIC, f"x = {value:g} m", "garbage", _set_x(value), names_joint, "finite", "further")
    add(TRANSFORM_TOPIC, "quaternion of length 2", "garbage", _double_turn, names_joint, "quaternion")
    add(TRANSFORM_TOPIC, "unknown state", "garbage", _set(state=77), names_joint, "state")
    add(TRANSFORM_TOPIC, "wrong frame", "wrong", _set_frame, names_joint, "elsewhere")
    two = "LOST, names the topic and its publishers"
    add(TRANSFORM_TOPIC, "second publisher, 10 mm off", "network", _displace, two, "publishers")
    add(RAW_TOPIC, "second publisher, gaps 0.1 mm off", "network", _shift_voltages, two, "publishers")
    for field in ("supply_voltage", "temperature"):
        change = _set(**{field: math.inf})
        add(RAW_TOPIC, f"{field.replace('_', ' ')} infinite", "garbage", change, "LOST, ENVIRONMENT", "ENVIRONMENT")
    bad = "LOST, BAD_READING"
    infinite = _set_elements("gap_voltages", {0: math.inf})
    add(RAW_TOPIC, "gap voltage infinite", "garbage", infinite, "LOST, BAD_READING", "BAD_READING", "OUT_OF_RANGE")
    add(RAW_TOPIC, "gap voltage missing", "garbage", _lose_voltage, bad, "BAD_READING")
    add(RAW_TOPIC, "diodes missing", "off", _set(diode_currents=[], lit_sources=[]), bad, "BAD_READING")
    add(RAW_TOPIC, "no light source lit", "off", _set(lit_sources=[255, 255]), "LOST, SOURCE", "SOURCE")
    add(RAW_TOPIC, "wrong frame", "wrong", _set_frame, "not used, names the frames", "elsewhere", "BAD_READING")
    add(RAW_TOPIC, "stamps 1 h old", "clock", _shift_stamp(-HOUR_S), "not used, names the age", "stamp")
    return rows


MESSAGE_FAULTS = tuple(_rows())


class InputRun:
    """A run of the test rig in which the program plays the publisher of one topic."""

    def __init__(
        self,
        topic: str,
        faults: Sequence[MessageFault],
        folder: Path,
        seed: int,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        """Write the arm; nothing is started yet.

        Args:
            topic: ``RAW_TOPIC``: the program plays driver_node; ``TRANSFORM_TOPIC``: driver_node and posor_node.
            faults: Faults of this topic.
            folder: Existing folder for the copy of the arm and the logs.
            seed: Of motion and noise.
            interrupted: Whether the user has interrupted the run.

        """
        self._topic, self._faults, self._folder, self._interrupted = topic, faults, folder, interrupted
        self._arm = write_fault_arm("test_rig", folder / "arm", CYCLE_S, seed)
        self._simulation = ArmSimulation(self._arm, IMPERFECTIONS)
        (self._joint,) = self._simulation.joints
        self._messages = SimulatedMessages(MessageTypes(), self._simulation)
        self._poses = PoseJudge(self._simulation)

    def run(self) -> list[RowResult]:
        """Run the nodes, publish all faults; return the results.

        Raises:
            ProcessError: A node failed, or the arm has no poses.

        """
        unused = () if self._topic == RAW_TOPIC else ("posor_node",)
        programs = [each for each in arm_programs(self._arm, drivers=False) if not each.name.endswith(unused or ("-",))]
        joints = [self._joint] if self._topic == RAW_TOPIC else []
        with Supervisor(self._folder) as supervisor, FaultReceiver(self._arm.name, joints) as receiver:
            for program in programs:
                supervisor.start(program)
            self._watch = GraphWatch(supervisor, receiver, "faults", interrupted=self._interrupted)
            return self._publish_all(receiver)

    def _publish_all(self, receiver: FaultReceiver) -> list[RowResult]:
        message_type = RawScan if self._topic == RAW_TOPIC else JointTransform
        name = f"/{self._arm.name}/{self._joint}/{self._topic}"
        publisher = receiver.create_publisher(message_type, name, OFFERED_QOS)
        self._next = first_tick_after(time.time_ns(), RATE)
        while not receiver.usable_endpoints(SETTLED_POSES):
            publisher.publish(self._message())
        begins = []
        for fault in self._faults:
            for _ in range(round(SOUND_S * RATE)):
                publisher.publish(self._message())
            usable, second = receiver.usable_endpoints(SETTLED_POSES), None
            if fault.is_impostor:
                second = receiver.create_publisher(message_type, name, OFFERED_QOS)
            begins.append((tick_stamp_ns(self._next, RATE), usable))
            for n in range(round((SLOT_S - SOUND_S) * RATE)):
                message = self._message()
                if n >= round(FAULT_S * RATE):
                    publisher.publish(message)
                else:
                    self._publish_fault(fault, message, publisher, second)
                if n == round(FAULT_S * RATE) and second is not None:
                    receiver.destroy_publisher(second)
                if n == round(ACKNOWLEDGE_S * RATE) and self._topic == RAW_TOPIC:
                    receiver.acknowledge(self._joint)
        return [self._judge(receiver, fault, *begin) for fault, begin in zip(self._faults, begins, strict=True)]

    def _publish_fault(self, fault: MessageFault, message: Any, publisher: Any, second: Any) -> None:
        if second is None:
            fault.change(message)
            publisher.publish(message)
            return
        impostor = deepcopy(message)
        fault.change(impostor)
        pair = ((publisher, message), (second, impostor))
        for who, sent in pair if message.header.stamp.nanosec // TICK_NS % 2 else reversed(pair):  # each comes first
            who.publish(sent)

    def _message(self) -> Any:
        """Wait for the next tick; return its sound message."""
        tick = self._next
        stamp = tick_stamp_ns(tick, RATE)
        self._watch.wait(lambda: time.time_ns() >= stamp, lambda: f"subscriptions to {self._topic}")
        self._next += 1
        ticks = np.array([tick])
        if self._topic == RAW_TOPIC:
            scans = self._simulation.scans(self._joint, ticks)
            return deserialize_message(self._messages.raw_scan(self._joint, scans, 0).data, RawScan)
        frames = self._simulation.calibrations[self._joint].frames
        pose = self._simulation.truth(ticks).T_parent_child[self._joint][0]
        message = JointTransform(child_frame_id=frames.child, scan=tick)
        message.header.frame_id = frames.parent
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, NS)
        message.pose = pose_message(pose)
        message.covariance = (SIGMA**2 * np.eye(6)).ravel()
        message.native = [*pose.translation.tolist(), *native_from_rotation(pose.rotation)]
        return message

    def _judge(self, receiver: FaultReceiver, fault: MessageFault, begin_ns: int, usable: bool) -> RowResult:  # noqa: FBT001
        end_ns = begin_ns + round((SLOT_S - SOUND_S) * NS)
        joint = self._joint if self._topic == RAW_TOPIC else ""
        named_ns = receiver.first_naming_ns(fault.row.named_by, begin_ns, end_ns, joint)
        return RowResult(
            fault.row,
            receiver.describe(begin_ns, begin_ns + round(FAULT_S * NS), joint),
            None if named_ns is None else (named_ns - begin_ns) / NS,
            self._poses.count_wrong(receiver, begin_ns, end_ns, joint),
            problem="" if usable else "there was no pose before the fault",
        )
