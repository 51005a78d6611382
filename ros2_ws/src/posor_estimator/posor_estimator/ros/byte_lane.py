"""The estimator's lane with bytes at both ends: raw scans in, joint transforms out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.ros.cdr import STAMP
from posor_estimator.ros.cdr_scan import ScanReader, scan_of
from posor_estimator.ros.cdr_transform import TransformWriter

if TYPE_CHECKING:
    from posor_estimator.core.posor import Posor
    from posor_estimator.ros.messages import CovarianceKind


class ByteLane:
    """One POSOR's way for raw scans of one kind: the same frame, the same numbers of readings.

    Attributes:
        lane: The estimator's.
        reader: Of raw scans.
        reason: Returns the sentence on what was wrong with the last scan, empty where nothing was.

    """

    def __init__(self, posor: Posor, example: bytes, kind: CovarianceKind) -> None:
        """Prepare.

        Args:
            posor: The estimator.
            example: A raw scan of that kind, in plain CDR.
            kind: Which part of the covariance to write.

        Raises:
            TopicError: The example is no raw scan.

        """
        self.lane = posor.lane(scan_of(example))
        self.reason = self.lane.reason
        self.reader = ScanReader(example, self.lane.scans)
        frames = posor.calibration.frames
        self._writer = TransformWriter(frames.parent, frames.child, kind, self.lane)

    def write(self, data: bytes) -> bytes:
        """Return the transform of the scan that was read and located last; ``data`` are its bytes."""
        return self._writer.write(data[STAMP], self.reader.number, self.reader.status)
