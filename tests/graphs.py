"""Starts the graph of the 1985 rig for a test and reads back what was recorded."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, Quaternion
from posor_bringup.collector import Collector
from posor_bringup.installed import JOINT, bag_path, calibration_path, urdf_path
from posor_bringup.replay import Replay, ReplayPlan
from posor_bringup.supervisor import Supervisor
from posor_estimator.core.calibration.load import load_calibration
from posor_estimator.core.chain import Chain
from posor_estimator.core.posor import Posor
from posor_estimator.ros.domain import leased_domain
from posor_estimator.ros.main import ros
from posor_estimator.ros.messages import is_usable, scan_from_message, transform_message
from posor_msgs.msg import JointTransform, RawScan
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from posor_bringup.expectations import Bag, CalibrationName


def rig(output: Path, bag: Bag, calibration: CalibrationName, *, rate: float = 0.0, loop: bool = False) -> ReplayPlan:
    """Return the plan of a replay; ``output`` gets a folder for the logs."""
    (output / "logs").mkdir(parents=True)
    return ReplayPlan(bag_path(bag), calibration_path(calibration), bag, urdf_path(), output, rate, loop)


@contextmanager
def graph(plan: ReplayPlan) -> Iterator[Replay]:
    """Yield a replay, not yet started, in a ROS domain of its own; whatever runs at the end is ended."""
    with pytest.MonkeyPatch.context() as environment, leased_domain() as domain:
        environment.setenv("ROS_DOMAIN_ID", str(domain))
        with ros(["test"]) as stop, Supervisor(plan.output / "logs") as supervisor:
            collector = Collector(JOINT)
            try:
                yield Replay(plan, supervisor, collector, interrupted=lambda: stop.requested)
            finally:
                collector.close()


def replayed(plan: ReplayPlan) -> Collector:
    """Replay a plan to its end and return what was received."""
    with graph(plan) as replay:
        replay.listen()
        replay.begin()
        replay.complete()
        replay.finish()
        return replay.collector


def recorded(bag: Path) -> dict[str, list[bytes]]:
    """Return the messages of a bag by topic, as they went over the wire."""
    messages: dict[str, list[bytes]] = {}
    with Reader(bag) as reader:
        for connection, _, data in reader.messages():
            messages.setdefault(connection.topic, []).append(bytes(data))
    return messages


def located(plan: ReplayPlan, raw: Sequence[bytes]) -> list[JointTransform]:
    """Return the transforms that the numerical core gives for scans, one after the other, without any node."""
    calibration = load_calibration(plan.calibration).for_session(plan.session)
    posor, frames = Posor(calibration), calibration.frames
    scans = [deserialize_message(data, RawScan) for data in raw]
    return [
        transform_message(scan, posor.locate(scan_from_message(scan)), frames.parent, frames.child, "total")
        for scan in scans
    ]


def placed(plan: ReplayPlan, transforms: Sequence[JointTransform]) -> list[Pose]:
    """Return the endpoint's poses that the core gives for the usable ones of ``transforms``."""
    lane = Chain(plan.urdf.read_text(encoding="utf-8"), "endpoint").lane()
    poses = []
    for transform in filter(is_usable, transforms):
        at, turn = transform.pose.position, transform.pose.orientation
        lane.poses[0] = at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w
        lane.run()
        x, y, z, *quaternion = lane.pose.tolist()
        pose = Pose(position=Point(x=x, y=y, z=z))
        pose.orientation = Quaternion(**dict(zip("xyzw", quaternion, strict=True)))
        poses.append(pose)
    return poses


def bits(message: Any) -> object:
    """Return a message's fields, every number as its bytes: equal only if equal to the last bit, NaN included.

    The bytes of the wire would not do: the padding between the fields is whatever lay in memory.
    """
    if hasattr(message, "get_fields_and_field_types"):
        return {name: bits(getattr(message, name)) for name in message.get_fields_and_field_types()}
    return message if isinstance(message, str) else np.asarray(message).tobytes()


def all_bits(kind: type[Any], messages: Sequence[bytes]) -> list[object]:
    """Return the fields of serialised messages, see ``bits``."""
    return [bits(deserialize_message(data, kind)) for data in messages]
