"""Estimates as messages: from arrays to rows of bytes, the messages that the nodes publish."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor.messages.estimate_columns import JOINT_COLUMNS
from posor.messages.message_table import TableLayout
from posor.node_parameters import COVARIANCE_KINDS
from posor.numerics.stamps import NS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from posor.estimation.estimate import Estimates
    from posor.messages.cdr_schema import Schema
    from posor.messages.estimate_arrays import EndpointEstimates
    from posor.messages.message_table import MessageTable
    from posor.node_parameters import CovarianceKind


def joint_transform_layout(schema: Schema, parent: str, child: str, kind: CovarianceKind) -> TableLayout:
    """Return the layout of transforms between two frames with one kind of covariance; ``schema``: JointTransform."""
    values = {"header.frame_id": parent, "child_frame_id": child, "covariance_kind": COVARIANCE_KINDS[kind]}
    return TableLayout.of(schema.encode(values), schema)


def pack_joint_transforms(layout: TableLayout, estimates: Estimates) -> MessageTable:
    """Return a JointTransform message for each estimate."""
    table = layout.copies(len(estimates))
    table["header.stamp.sec"], table["header.stamp.nanosec"] = estimates.header_stamps.T
    for path, (name, _) in JOINT_COLUMNS.items():
        table[path] = getattr(estimates, name)
    table["native"] = estimates.natives
    table.span("pose.position.x", 7)[:] = estimates.poses
    table["covariance"] = estimates.covariances().reshape(-1, 36)
    return table


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
