"""One joint of an arm: the transforms that a posor_node would have published for its recorded scans."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.bulk.columns import records_of, transform_layout
from posor_estimator.core.fault import Fault, State
from posor_estimator.core.posor import Posor
from posor_estimator.reprocess.transforms import Transforms

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.bulk.layout import Table, TableLayout
    from posor_estimator.bulk.pieces import Piece
    from posor_estimator.core.calibration.model import Calibration
    from posor_estimator.core.records import Records
    from posor_estimator.ros.messages import CovarianceKind


@dataclass(frozen=True)
class Work:
    """A piece of a joint's scans that are to be located.

    Attributes:
        piece: The scans.
        records: The way from them to transforms.
        out: Room for these.

    """

    piece: Piece
    records: Records
    out: Table

    def locate(self, begin: int = 0) -> None:
        """Locate the scans from one on."""
        if begin < len(self.out):
            self.records.locate(self.piece.table.rows[begin:], self.out.rows[begin:])


class JointReprocessor:
    """Turns one joint's recorded scans into transforms, piece after piece.

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

    def work(self, piece: Piece) -> Work:
        """Return what is to be done for a piece, with room for its transforms."""
        if self._raw is not piece.table.layout:
            self._raw, self._records = piece.table.layout, records_of(self._posor, piece.table.layout, self.layout)
        return Work(piece, self._records, self.layout.empty(len(piece.table)))

    def transforms(self, done: Sequence[Work]) -> Transforms:
        """Return the transforms of a block's scans, once they are located; NaN where a scan gives no pose."""
        for work in done:
            self._count(work.out)
        parts = [Transforms.of(work.piece.times_ns, work.piece.places, work.out) for work in done]
        return Transforms.joined(parts) if parts else Transforms.none(self.layout)

    def _count(self, out: Table) -> None:
        self.scans += len(out)
        lost = out["state"] == int(State.LOST)
        if lost.any():
            self.lost += int(np.count_nonzero(lost))
            faults = out["faults"][lost]
            found = {fault.name: int(np.count_nonzero(faults & fault.value)) for fault in Fault if fault.name}
            self.faults.update({name: count for name, count in found.items() if count})
