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
from posor_estimator.reprocess.transforms import Transforms, stamps_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from posor_estimator.bulk.pieces import Piece
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.estimate import Estimates
    from posor_estimator.core.types import BoolArray
    from posor_estimator.ros.messages import CovarianceKind

CONTACTS = 4


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
        self.scans = self.lost = 0
        self.faults: Counter[str] = Counter()

    def transforms(self, pieces: Iterable[Piece]) -> Transforms:
        """Return the transforms of a block's scans; every number is NaN where a scan gives no pose."""
        parts = [Transforms.of(piece.times_ns, piece.places, self._of_scans(piece.table)) for piece in pieces]
        return Transforms.joined(parts) if parts else Transforms.none(self.layout)

    def _of_scans(self, raw: Table) -> Table:
        out = self.layout.new(len(raw))
        for name in ("header.stamp.sec", "header.stamp.nanosec", "scan"):
            out[name] = raw[name]
        out["scan_status"] = raw["status"]
        fit = _has_time(raw)
        if raw.layout.strings["header.frame_id"] != self._parent:
            fit[:] = False
        if fit.all():
            self._locate(raw, out)
        else:
            located, unfit = out.chosen(fit), out.chosen(~fit)
            if len(located):
                self._locate(raw.chosen(fit), located)
            unfit["faults"] = int(Fault.BAD_READING)
            _lose(unfit)
            out.rows[fit], out.rows[~fit] = located.rows, unfit.rows
        self._count(out)
        return out

    def _locate(self, raw: Table, out: Table) -> None:
        """Write what scans give into transforms."""
        found = self._posor.locate_all(scans_of(raw))
        out.span("pose.position.x", 7)[:] = found.poses
        out.span("native", 6)[:] = found.natives
        self._write_covariances(found, out)
        out["residual"] = found.residuals
        out["redundancy"] = found.redundancy
        out["state"] = found.states
        out["faults"] = found.faults
        lost = found.states == int(State.LOST)
        if lost.any():
            these = out.chosen(lost)
            _lose(these)
            out.rows[lost] = these.rows

    def _write_covariances(self, found: Estimates, out: Table) -> None:
        room = out.span("covariance", 36).reshape(-1, 6, 6)
        if self._kind == "total":
            np.add(found.covariances_random, found.covariances_systematic, out=room)
        else:
            room[:] = found.covariances_random if self._kind == "random" else found.covariances_systematic

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
