"""From the bytes of raw scans to the bytes of joint transforms, one message after the other."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, NamedTuple

from posor.messages.cdr_schema import STAMP
from posor.messages.message_stream import UNCHECKED, MessageEstimator
from posor.messages.message_table import LEAD, TableLayout
from posor.model.fault import State
from posor.numerics.stamps import NO_TIME, NS
from posor_ros.cdr_scan import RAW_SCAN, scan_of

from posor_estimator.stream_layout import message_stream, transform_layout

if TYPE_CHECKING:
    from posor.estimation.posor import Posor
    from posor.node_parameters import CovarianceKind


class RawScanStream:
    """Estimates the raw scans of one layout: the same frame, the same numbers of readings.

    Attributes:
        frame: Frame of the scans.
        status: Status of the stream, shape (1,), dtype ``message_stream.STATUS``.

    """

    def __init__(self, posor: Posor, example: bytes, kind: CovarianceKind) -> None:
        """Prepare.

        Args:
            posor: The estimator.
            example: A raw scan of the layout, in plain CDR.
            kind: Which part of the covariance to write.

        Raises:
            TopicError: The example is not a raw scan.

        """
        frames = posor.calibration.frames
        raw, transform = TableLayout.of(example, RAW_SCAN), transform_layout(frames.parent, frames.child, kind)
        self._posor, self._parent, self.frame = posor, frames.parent, raw.strings["header.frame_id"]
        row, out = raw.row[None].copy(), transform.row[None].copy()
        self._estimator = MessageEstimator(posor, message_stream(raw, transform, row, out, check=True))
        self._estimate_rows, self.status = self._estimator.estimate_rows, self._estimator.status
        self._stamp_ns, self._changed = self.status["stamp_ns"], self.status["changed"]
        self._size = raw.size
        self._refusal = ""
        number = raw.offset("scan")
        self._unpack_identity = struct.Struct(f"<iI{number - STAMP.stop}xQ").unpack_from
        self._frame_bytes = example[STAMP.stop : STAMP.stop + 5 + len(self.frame.encode())]
        self._raw = row[0, LEAD : LEAD + raw.size].data
        self._transform = out[0, LEAD : LEAD + transform.size].data.tobytes
        self._last = example

    def identity(self, data: bytes) -> tuple[int, int] | None:
        """Return stamp [ns], which is not checked, and number of a raw scan; None: its frame or length is another."""
        if len(data) < self._size or not data.startswith(self._frame_bytes, STAMP.stop):
            return None
        seconds, nanoseconds, number = self._unpack_identity(data, STAMP.start)
        return seconds * NS + nanoseconds, number

    def last_identity(self) -> tuple[int, int] | None:
        """Return stamp and number of the last scan, as ``identity``; None: there was none."""
        return None if self.status["state"] < 0 else self.identity(self._last)

    def number_of(self, data: bytes) -> int:
        """Return the number of a raw scan of this layout."""
        return int(self._unpack_identity(data, STAMP.start)[2])

    def refuse_message(self, data: bytes, refusal: str) -> bytes | None:
        """Return a LOST transform of a raw scan that must not be used, as ``estimate_message`` does.

        Args:
            data: The scan, which the estimator does not see.
            refusal: Sentence on the reason.

        """
        usable = self.status["readings_usable"].item()
        self.status["readings_usable"] = 0
        try:
            return self.estimate_message(data)
        finally:
            self.status["readings_usable"] = usable
            self._refusal = refusal

    def accept_ages(self, youngest_ns: float, oldest_ns: float) -> None:
        """Set the least and the greatest age of expected scans [ns]; at first all are expected."""
        self.status["youngest_ns"], self.status["oldest_ns"] = youngest_ns, oldest_ns

    def estimate_message(self, data: bytes, now_ns: int = UNCHECKED) -> bytes | None:
        """Return the transform of a raw scan; None where the scan has another layout, which changes nothing.

        With the present time [ns], that is also the return value where the scan is unexpected: its number does not
        follow that of the last scan, there is no last scan, or its age is not accepted.
        """
        if len(data) < self._size:
            return None
        self._refusal = ""
        self._raw[:] = data if len(data) == self._size else data[: self._size]
        if not self._estimate_rows(now_ns):
            return None
        self._last = data
        return self._transform()

    def stamp_and_change(self) -> tuple[int, int]:
        """Return the stamp of the last scan [ns] (0: invalid), and whether its status differs from the scan before."""
        return self._stamp_ns.item(), self._changed.item()

    def count_from_next(self, *, stated: bool = True) -> None:
        """Take the next scan as one that has seen the home mark, or no longer."""
        self.status["count_from_next"] = int(stated)

    @property
    def counts_from_next(self) -> bool:
        """Whether that scan has yet to come."""
        return bool(self.status["count_from_next"][0])

    def last_scan(self) -> EstimatedScan:
        """Return the last scan and its estimate."""
        status = self.status[0]
        refusal = self._refusal
        if not status["readings_usable"]:
            refusal = f"comes from frame '{self.frame}'; expected '{self._parent}', as in the calibration"
        return EstimatedScan(self, self._last, int(status["stamp_ns"]), refusal, self._estimator.estimate[0].copy())

    def reason(self, scan: EstimatedScan) -> str:
        """Return the sentence on the fault of a scan, empty where it has none; may be called in any thread."""
        if not scan.refusal and scan.stamp_ns and scan.estimate["faults"] == 0:
            return ""
        raw = scan_of(scan.data)
        refusal = scan.refusal if scan.stamp_ns else f"the stamp {NO_TIME}; expected the time of exposure"
        return f"scan {raw.number}: {refusal}." if refusal else self._posor.reason(raw, scan.estimate)


class EstimatedScan(NamedTuple):
    """A scan of a stream and its estimate.

    Attributes:
        stream: The stream.
        data: The scan as a serialised message.
        stamp_ns: Its stamp [ns]; 0: invalid.
        refusal: Why its readings were not used; empty: they were.
        estimate: Record of dtype ESTIMATE.

    """

    stream: RawScanStream
    data: bytes
    stamp_ns: int
    refusal: str
    estimate: Any

    @property
    def number(self) -> int:
        """The scan's number."""
        return self.stream.number_of(self.data)

    @property
    def reason(self) -> str:
        """The sentence on its fault, empty where it has none."""
        return self.stream.reason(self)

    @property
    def residual(self) -> float:
        """Chi-square of the redundant readings; NaN where the scan is LOST."""
        return float("nan") if self.estimate["state"] == State.LOST else float(self.estimate["residual"])

    @property
    def redundancy(self) -> int:
        """Degrees of freedom of the residual; zero of a LOST scan."""
        return int(self.estimate["redundancy"])
