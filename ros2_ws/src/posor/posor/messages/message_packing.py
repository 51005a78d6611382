"""Endpoint estimates as messages: from arrays to rows of bytes, the messages that ``chain_node`` publishes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor.messages.message_table import TableLayout
from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.messages.cdr_schema import Schema
    from posor.messages.estimate_arrays import EndpointEstimates
    from posor.messages.message_table import MessageTable


def endpoint_layouts(schemas: Sequence[Schema], frame: str, joints: Sequence[str]) -> tuple[TableLayout, ...]:
    """Return the layouts of PoseStamped, PoseWithCovarianceStamped and JointState, whose schemas these are."""
    values: list[Mapping[str, object]] = [
        {"header.frame_id": frame},
        {"header.frame_id": frame},
        {"name": list(joints), "position": [0.0] * len(joints)},
    ]
    return tuple(
        TableLayout.of(schema.encode(of_schema), schema) for schema, of_schema in zip(schemas, values, strict=True)
    )


def pack_endpoint(layouts: Sequence[TableLayout], estimates: EndpointEstimates) -> list[MessageTable]:
    """Return a message of each layout for each pose of the endpoint."""
    pose, with_covariance, joint_states = tables = [layout.copies(len(estimates)) for layout in layouts]
    for table in tables:
        table["header.stamp.sec"], table["header.stamp.nanosec"] = np.divmod(estimates.stamps_ns, NS)
    pose.span("pose.position.x", 7)[:] = estimates.poses
    with_covariance.span("pose.pose.position.x", 7)[:] = estimates.poses
    with_covariance["pose.covariance"] = estimates.covariances.reshape(-1, 36)
    joint_states["position"] = estimates.angles
    return tables
