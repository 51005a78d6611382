"""Where raw scans have their readings, and joint transforms what is made of them, for the estimator's compiled loop."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor_msgs.msg import JointTransform, RawScan

from posor_estimator.bulk.layout import LEAD, TableLayout
from posor_estimator.core.columns import Columns
from posor_estimator.core.records import Records
from posor_estimator.ros.messages import COVARIANCE_KINDS

if TYPE_CHECKING:
    from posor_estimator.core.posor import Posor
    from posor_estimator.ros.messages import CovarianceKind


def transform_layout(parent: str, child: str, kind: CovarianceKind) -> TableLayout:
    """Return the layout of transforms between two frames whose covariance is of one kind."""
    message = JointTransform(child_frame_id=child, covariance_kind=COVARIANCE_KINDS[kind])
    message.header.frame_id = parent
    return TableLayout.like(message)


def records_of(posor: Posor, raw: TableLayout, transforms: TableLayout) -> Records:
    """Return a POSOR's way from raw scans to joint transforms, all laid out alike; scans of another frame are LOST."""
    where = _offsets(raw)
    to = _offsets(transforms)
    columns = Columns(
        seconds=where["header.stamp.sec"],
        number=where["scan"],
        status=where["status"],
        gaps=_sequence(raw, "gap_voltages"),
        rings=_sequence(raw, "ring_voltages"),
        currents=_sequence(raw, "diode_currents"),
        supply=where["supply_voltage"],
        temperature=where["temperature"],
        lit=_sequence(raw, "lit_sources"),
        home=RawScan.STATUS_HOME_BUMP,
        to_stamp=to["header.stamp.sec"],
        to_number=to["scan"],
        to_status=to["scan_status"],
        to_redundancy=to["redundancy"],
        to_faults=to["faults"],
        to_pose=to["pose.position.x"],
        to_native=to["native"],
        to_residual=to["residual"],
        to_covariance=to["covariance"],
        kind=int(transforms.row[to["covariance_kind"]]),
    )
    fit = raw.strings["header.frame_id"] == transforms.strings["header.frame_id"]
    return Records(posor, columns, transforms.row, fit=fit)


def _offsets(layout: TableLayout) -> dict[str, int]:
    return {name: LEAD + layout.offset(name) for name in layout.dtype.names or ()}


def _sequence(layout: TableLayout, path: str) -> tuple[int, int]:
    """Return where a sequence begins, and its length; an empty one has no place, and where it stands is not aligned."""
    fields: Any = layout.dtype.fields
    length = int(fields[path][0].shape[0])
    return (LEAD + layout.offset(path) if length else 0), length
