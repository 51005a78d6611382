"""Where raw scans hold their readings, and joint transforms the estimates, for the estimator of message streams."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from posor.messages.message_packing import joint_transform_layout
from posor.messages.message_stream import (
    RAW_SCAN_LAYOUT,
    STATUS,
    TRANSFORM_LAYOUT,
    MessageRows,
    MessageStream,
)
from posor.messages.message_table import LEAD, TableLayout
from posor.numerics.compiled import record_view
from posor_msgs.msg import JointTransform
from posor_ros.message_classes import schema_of_class

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from posor.node_parameters import CovarianceKind
    from posor.numerics.array_types import ByteArray

EVERY_LAYOUT = np.zeros(0, dtype=np.int32)
"""For rows that are known to have the layout of the stream."""


def transform_layout(parent: str, child: str, kind: CovarianceKind) -> TableLayout:
    """Return the layout of transforms between two frames whose covariance is of one kind."""
    return joint_transform_layout(schema_of_class(JointTransform), parent, child, kind)


def message_stream(
    raw: TableLayout, transforms: TableLayout, raw_rows: ByteArray, transform_rows: ByteArray, *, check: bool = False
) -> MessageStream:
    """Return a stream of raw scans and of transforms, rows (n, bytes) each.

    Args:
        raw: Layout of the raw scans.
        transforms: Layout of the transforms.
        raw_rows: Raw scans.
        transform_rows: Transforms to write.
        check: Whether rows of another layout may come.

    """
    status = np.zeros(1, dtype=STATUS)
    status["state"], status["youngest_ns"], status["oldest_ns"] = -1, -math.inf, math.inf
    status["readings_usable"] = raw.strings["header.frame_id"] == transforms.strings["header.frame_id"]
    return MessageStream(
        raw=MessageRows.of(raw_rows),
        raw_layout=record_view(_raw_scan_layout(raw)),
        expected=raw.row.view(np.int32) if check else EVERY_LAYOUT,
        decisive=raw.fixed.view(np.int32) if check else EVERY_LAYOUT,
        transforms=MessageRows.of(transform_rows),
        transform_layout=record_view(_transform_layout(transforms)),
        template=transforms.row.view(np.float64),
        status=record_view(status),
    )


def _raw_scan_layout(raw: TableLayout) -> NDArray[np.void]:
    layout = np.zeros(1, dtype=RAW_SCAN_LAYOUT)
    layout["stamp"], layout["number"] = _offset(raw, "header.stamp.sec"), _offset(raw, "scan")
    layout["status"] = _offset(raw, "status")
    counts = {
        "gap_voltages": "gap_count",
        "ring_voltages": "ring_count",
        "diode_currents": "current_count",
        "lit_sources": "lit_count",
    }
    fields: Any = raw.dtype.fields
    for name, count in counts.items():
        layout[count] = fields[name][0].shape[0]
        if layout[count]:  # where an empty sequence stands is not aligned
            layout[name] = _offset(raw, name)
    layout["supply_voltage"], layout["temperature"] = _offset(raw, "supply_voltage"), _offset(raw, "temperature")
    return layout


def _transform_layout(transforms: TableLayout) -> NDArray[np.void]:
    layout = np.zeros(1, dtype=TRANSFORM_LAYOUT)
    paths = {"stamp": "header.stamp.sec", "number": "scan", "status": "scan_status", "pose": "pose.position.x"}
    paths |= {name: name for name in ("redundancy", "faults", "native", "residual", "covariance")}
    for name, path in paths.items():
        layout[name] = _offset(transforms, path)
    layout["covariance_kind"] = transforms.row[_offset(transforms, "covariance_kind")]
    return layout


def _offset(layout: TableLayout, path: str) -> int:
    return LEAD + layout.offset(path)
