"""Messages built from numbers, for sources, the simulator and bags; their CDR bytes do not depend on the middleware."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from posor.numerics.stamps import NS
from posor.ros_names import POINT_STAMPED, POSE_STAMPED, RAW_SCAN

if TYPE_CHECKING:
    from collections.abc import Iterable

    from posor.messages.message_definitions import MessageTypes
    from posor.model.scan import Scan


def header(types: MessageTypes, stamp_ns: int, frame_id: str) -> Any:
    """Return a std_msgs/Header."""
    sec, nanosec = divmod(stamp_ns, NS)
    stamp = types.new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return types.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def raw_scan(types: MessageTypes, stamp_ns: int, frame_id: str, **fields: Any) -> Any:
    """Return a posor_msgs/RawScan; a missing field is empty, not measured (NaN), or one sample without status flags."""
    empty = np.empty(0)
    defaults = {
        "header": header(types, stamp_ns, frame_id),
        "samples": 1,
        "status": 0,
        "gap_voltages": empty,
        "gap_voltage_spreads": empty,
        "ring_voltages": empty,
        "ring_voltage_spreads": empty,
        "diode_currents": empty,
        "diode_current_spreads": empty,
        "lit_sources": np.empty(0, dtype=np.uint8),
        "supply_voltage": math.nan,
        "temperature": math.nan,
    }
    return types.new(RAW_SCAN, **(defaults | fields))


def scan_fields(scan: Scan) -> dict[str, Any]:
    """Return the fields of ``raw_scan`` that hold the number and readings of a scan."""
    return {
        "scan": scan.number,
        "gap_voltages": scan.gap_voltages,
        "ring_voltages": scan.ring_voltages,
        "diode_currents": scan.diode_currents.ravel(),
        "lit_sources": np.array(scan.lit_sources, dtype=np.uint8),
        "supply_voltage": scan.supply_voltage,
        "temperature": scan.temperature,
    }


def point_stamped(types: MessageTypes, stamp_ns: int, frame_id: str, position: Iterable[float]) -> Any:
    """Return a geometry_msgs/PointStamped of a position x, y, z [m]."""
    x, y, z = position
    point = types.new("geometry_msgs/msg/Point", x=x, y=y, z=z)
    return types.new(POINT_STAMPED, header=header(types, stamp_ns, frame_id), point=point)


def pose_stamped(types: MessageTypes, stamp_ns: int, frame_id: str, pose: pin.SE3) -> Any:
    """Return a geometry_msgs/PoseStamped."""
    x, y, z, qx, qy, qz, qw = pin.SE3ToXYZQUAT(pose).tolist()
    position = types.new("geometry_msgs/msg/Point", x=x, y=y, z=z)
    orientation = types.new("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw)
    content = types.new("geometry_msgs/msg/Pose", position=position, orientation=orientation)
    return types.new(POSE_STAMPED, header=header(types, stamp_ns, frame_id), pose=content)
