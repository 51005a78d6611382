"""The estimator's way from the bytes of a raw scan to those of its joint transform."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from posor_estimator.bulk.columns import records_of, transform_layout
from posor_estimator.bulk.layout import LEAD, TableLayout
from posor_estimator.core.kernels.stamps import NO_TIME
from posor_estimator.core.records import SAID_STAMP
from posor_estimator.ros.cdr_scan import RAW_SCAN

if TYPE_CHECKING:
    from posor_estimator.core.posor import Posor
    from posor_estimator.core.records import Verdict
    from posor_estimator.ros.messages import CovarianceKind

_NUMBER = struct.Struct("<Q")


class ByteLane:
    """One POSOR's way for raw scans of one kind: the same frame, the same numbers of readings.

    Attributes:
        frame: Of the scans.
        fit: Whether that is the receiving plate; else every scan is LOST.
        said: Of the last scan, see ``core.records.Records``.

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
        frames = posor.calibration.frames
        raw, transform = TableLayout.of(example, RAW_SCAN), transform_layout(frames.parent, frames.child, kind)
        self._records = records = records_of(posor, raw, transform)
        self.frame, self.fit = raw.strings["header.frame_id"], records.fit
        self._parent = frames.parent
        self._size, self._number_at = raw.size, raw.offset("scan")
        row, out = raw.row[None].copy(), transform.row[None].copy()
        self._lane = records.lane(row, out, np.stack([raw.row, raw.fixed]))
        self._into = row[0, LEAD : LEAD + raw.size].data
        self._transform = out[0, LEAD : LEAD + transform.size].data.tobytes
        self.said: memoryview = records.said.data
        self._run = self._lane.run
        self._last = example

    def answer(self, data: bytes) -> bytes | None:
        """Return the transform of a raw scan; None where it is not of this kind, then nothing has been done."""
        if len(data) < self._size:
            return None
        self._into[:] = data if len(data) == self._size else data[: self._size]
        if not self._run():
            return None
        self._last = data
        return self._transform()

    def count_from_next(self) -> None:
        """Take the next scan for one that has seen the home mark."""
        self._records.count_from_next()

    @property
    def counts_from_next(self) -> bool:
        """Whether that scan has yet to come."""
        return self._records.counts_from_next

    def answered(self) -> Answered:
        """Return the last scan and how it went."""
        return Answered(self, self._last, int(self.said[SAID_STAMP]), self._records.verdict())

    def number_of(self, data: bytes) -> int:
        """Return the number of a scan of this kind."""
        return int(_NUMBER.unpack_from(data, self._number_at)[0])

    def reason(self, scan: Answered) -> str:
        """Return the sentence on what was wrong with a scan, empty where nothing was; may be asked in any thread."""
        if not self.fit:
            said = f"comes from frame '{self.frame}'; expected '{self._parent}', as in the calibration."
        elif scan.stamp_ns == 0:
            said = f"the stamp {NO_TIME}; expected the time of exposure."
        else:
            row = np.zeros_like(self._lane.row)
            row[LEAD : LEAD + self._size] = np.frombuffer(scan.data, dtype=np.uint8)[: self._size]
            return self._records.reason(row, scan.verdict)
        return f"scan {scan.number}: {said}"


class Answered(NamedTuple):
    """A scan that a lane has answered, and how it went.

    Attributes:
        lane: The lane.
        data: The scan.
        stamp_ns: Its stamp [ns].
        verdict: How it went.

    """

    lane: ByteLane
    data: bytes
    stamp_ns: int
    verdict: Verdict

    @property
    def number(self) -> int:
        """The scan's number."""
        return self.lane.number_of(self.data)

    @property
    def reason(self) -> str:
        """The sentence on what was wrong with it, empty where nothing was."""
        return self.lane.reason(self)
