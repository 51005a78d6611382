"""One joint of an arm: the transforms that a posor_node would have published for its recorded scans."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.bulk.columns import records_of, transform_layout
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.posor import Posor
from posor_estimator.reprocess.transforms import Transforms

if TYPE_CHECKING:
    from collections.abc import Iterable

    from posor_estimator.bulk.layout import Table, TableLayout
    from posor_estimator.bulk.pieces import Piece
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.ros.messages import CovarianceKind


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
        self.layout = transform_layout(calibration.frames.parent, calibration.frames.child, kind)
        self._raw: TableLayout | None = None
        self.scans = self.lost = 0
        self.faults: Counter[str] = Counter()

    def transforms(self, pieces: Iterable[Piece]) -> Transforms:
        """Return the transforms of a block's scans; every number is NaN where a scan gives no pose."""
        parts = [Transforms.of(piece.times_ns, piece.places, self._of_scans(piece.table)) for piece in pieces]
        return Transforms.joined(parts) if parts else Transforms.none(self.layout)

    def _of_scans(self, raw: Table) -> Table:
        out = self.layout.empty(len(raw))
        if self._raw is not raw.layout:
            self._raw, self._records = raw.layout, records_of(self._posor, raw.layout, self.layout)
        self._records.locate(raw.rows, out.rows)
        self._count(out)
        return out

    def _count(self, out: Table) -> None:
        self.scans += len(out)
        lost = out["state"] == int(State.LOST)
        if lost.any():
            self.lost += int(np.count_nonzero(lost))
            faults = out["faults"][lost]
            found = {fault.name: int(np.count_nonzero(faults & fault.value)) for fault in Fault if fault.name}
            self.faults.update({name: count for name, count in found.items() if count})
