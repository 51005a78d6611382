"""One joint of an arm: the transforms that a posor_node would have published for its recorded scans."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
from posor_msgs.msg import JointTransform, RawScan

from posor_estimator.bulk.layout import Table, TableLayout
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.posor import Posor
from posor_estimator.core.scan import Scans
from posor_estimator.reprocess.rows import write_numbers
from posor_estimator.reprocess.transforms import Transforms, stamps_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from posor_estimator.bulk.pieces import Piece
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.types import BoolArray
    from posor_estimator.ros.messages import CovarianceKind

CONTACTS = 4
NUMBERS = ("pose.position.x", "native", "residual", "covariance")
"""Fields where the numbers of a transform begin, as ``write_numbers`` wants them."""


class JointReprocessor:
    """Estimates the poses of one joint, piece after piece of its recorded scans.

    Attributes:
        layout: Of the transforms.
        scans: How many scans there have been.
        lost: How many of them gave no pose.
        faults: How many of the lost ones have each fault.

    """

    def __init__(self, calibration: Calibration, kind: CovarianceKind, false_alarm: float) -> None:
        """Begin afresh.

        Args:
            calibration: Of the joint's POSOR, its session applied.
            kind: Which part of the uncertainty the transforms tell.
            false_alarm: See ``Posor``.

        """
        self._posor = Posor(calibration, false_alarm=false_alarm)
        self._parent = calibration.frames.parent
        self._kind = kind
        self.layout = _layout(self._parent, calibration.frames.child, kind)
        self._row = self.layout.row.view(np.float64)
        self._columns = np.array([self.layout.column(name) for name in NUMBERS])
        self._nothing = np.empty((0, 6, 6))
        self.scans = self.lost = 0
        self.faults: Counter[str] = Counter()

    def transforms(self, pieces: Iterable[Piece]) -> Transforms:
        """Return the transforms of a block's scans; every number is NaN where a scan gives no pose."""
        parts = [Transforms.of(piece.times_ns, piece.places, self._of_scans(piece.table)) for piece in pieces]
        return Transforms.joined(parts) if parts else Transforms.none(self.layout)

    def _of_scans(self, raw: Table) -> Table:
        fit = _has_time(raw)
        if raw.layout.strings["header.frame_id"] != self._parent:
            fit[:] = False
        if fit.all():
            out = self._located(raw)
        else:
            out = self.layout.new(len(raw))
            out["faults"] = int(Fault.BAD_READING)
            _lose(out)
            if fit.any():
                out.rows[fit] = self._located(raw.chosen(fit)).rows
        for name in ("header.stamp.sec", "header.stamp.nanosec", "scan"):
            out[name] = raw[name]
        out["scan_status"] = raw["status"]
        self._count(out)
        return out

    def _located(self, raw: Table) -> Table:
        """Return transforms with what scans give."""
        found = self._posor.locate_all(scans_of(raw))
        out = self.layout.empty(len(raw))
        write_numbers(
            self._row,
            self._columns,
            found.figures,
            found.covariances_systematic if self._kind == "systematic" else found.covariances_random,
            found.covariances_systematic if self._kind == "total" else self._nothing,
            out.rows.view(np.float64),
        )
        out["redundancy"] = found.redundancy
        out["state"] = found.states
        out["faults"] = found.faults
        lost = found.states == int(State.LOST)
        if lost.any():
            these = out.chosen(lost)
            _lose(these)
            out.rows[lost] = these.rows
        return out

    def _count(self, out: Table) -> None:
        self.scans += len(out)
        lost = out["state"] == int(State.LOST)
        if lost.any():
            self.lost += int(np.count_nonzero(lost))
            faults = out["faults"][lost]
            found = {fault.name: int(np.count_nonzero(faults & fault.value)) for fault in Fault if fault.name}
            self.faults.update({name: count for name, count in found.items() if count})


def _lose(out: Table) -> None:
    """Make transforms say that there is no pose."""
    out.span("pose.position.x", 7)[:] = np.nan
    out["covariance"] = np.nan
    out["native"] = np.nan
    out["residual"] = np.nan
    out["redundancy"] = 0
    out["state"] = int(State.LOST)


def scans_of(raw: Table) -> Scans:
    """Return raw scans as the core sees them."""
    count, currents = len(raw), raw["diode_currents"]
    width = CONTACTS if currents.shape[1] % CONTACTS == 0 else 1
    return Scans(
        numbers=np.ascontiguousarray(raw["scan"]),
        stamps_ns=stamps_of(raw),
        gap_voltages=np.ascontiguousarray(raw["gap_voltages"]),
        ring_voltages=np.ascontiguousarray(raw["ring_voltages"]),
        diode_currents=np.ascontiguousarray(currents).reshape(count, currents.shape[1] // width, width),
        lit_sources=raw["lit_sources"].astype(np.int64),
        supply_voltages=np.ascontiguousarray(raw["supply_voltage"]),
        temperatures=np.ascontiguousarray(raw["temperature"]),
        at_home=((raw["status"] & RawScan.STATUS_HOME_BUMP) != 0).astype(np.int64),
    )


def _has_time(raw: Table) -> BoolArray:
    return np.asarray((raw["header.stamp.sec"] != 0) | (raw["header.stamp.nanosec"] != 0))


def _layout(parent: str, child: str, kind: CovarianceKind) -> TableLayout:
    message = JointTransform(child_frame_id=child)
    message.header.frame_id = parent
    message.covariance_kind = getattr(JointTransform, f"COVARIANCE_{kind.upper()}")
    return TableLayout.like(message)
