# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plans of replays of the 1985 rig for tests, and messages of its bags compared bit by bit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from posor.calibration.calibration_file import load_calibration
from posor.chain.identity import calibration_id
from posor.chain.kinematic_chain import Chain
from posor.estimation.posor import Posor
from posor_lab.harness.message_conversion import estimate_with_effects, is_usable, scan_from_message, transform_message
from posor_lab.harness.recorded_messages import read_bag
from posor_lab.harness.rig_files import Bag, CalibrationName, bag_path, calibration_path, urdf_path
from posor_lab.replay_1985.replay import ReplayPlan
from posor_msgs.msg import JointTransform, RawScan
from rclpy.serialization import deserialize_message


def make_plan(
    output: Path, bag: Bag, calibration: CalibrationName, *, rate: float = 0.0, loop: bool = False
) -> ReplayPlan:
    """Return the plan of a replay; creates a folder for the logs in ``output``."""
    (output / "logs").mkdir(parents=True)
    return ReplayPlan(bag_path(bag), calibration_path(calibration), bag, urdf_path(), output, rate, loop)


def read_bag_messages(bag: Path) -> dict[str, list[bytes]]:
    messages: dict[str, list[bytes]] = {}
    for topic, _, data in read_bag(bag):
        messages.setdefault(topic, []).append(data)
    return messages


def estimate_transforms(plan: ReplayPlan, raw: Sequence[bytes]) -> list[JointTransform]:
    """Return the transforms of serialised scans by the numerical core, without nodes."""
    calibration = load_calibration(plan.calibration).for_session(plan.session)
    posor, ends = Posor(calibration), (calibration.frames.parent, calibration.frames.child)
    number = calibration_id(calibration)
    scans = [deserialize_message(data, RawScan) for data in raw]
    causes = posor.hypotheses.joint_causes()
    return [
        transform_message(scan, estimate, *ends, (causes, effects), number)
        for scan in scans
        for estimate, effects in [estimate_with_effects(posor, scan_from_message(scan))]
    ]


def estimate_endpoints(plan: ReplayPlan, transforms: Sequence[JointTransform]) -> list[Pose]:
    """Return the endpoint poses of the usable transforms by the numerical core."""
    estimator = Chain(plan.urdf.read_text(encoding="utf-8"), "endpoint").estimator()
    poses = []
    for transform in filter(is_usable, transforms):
        at, turn = transform.pose.position, transform.pose.orientation
        estimator.poses[0] = at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w
        estimator.estimate()
        x, y, z, *quaternion = estimator.pose.tolist()
        pose = Pose(position=Point(x=x, y=y, z=z))
        pose.orientation = Quaternion(**dict(zip("xyzw", quaternion, strict=True)))
        poses.append(pose)
    return poses


def message_bits(message: Any) -> object:
    """Return the fields of a message with every number as its bytes, so that NaN equals NaN.

    Serialised bytes cannot be compared: the padding between their fields is undefined.
    """
    if hasattr(message, "get_fields_and_field_types"):
        return {name: message_bits(getattr(message, name)) for name in message.get_fields_and_field_types()}
    return message if isinstance(message, str) else np.asarray(message).tobytes()


def all_message_bits(kind: type[Any], messages: Sequence[bytes]) -> list[object]:
    return [message_bits(deserialize_message(data, kind)) for data in messages]
