"""From the bytes of raw scans to the bytes of joint transforms, one message after the other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from posor_estimator.bags.message_table import LEAD, TableLayout
from posor_estimator.estimation.message_stream import MessageEstimator
from posor_estimator.model.fault import State
from posor_estimator.numerics.stamps import NO_TIME
from posor_estimator.ros.cdr_scan import RAW_SCAN, scan_of
from posor_estimator.ros.stream_layout import message_stream, transform_layout

if TYPE_CHECKING:
    from posor_estimator.estimation.posor import Posor
    from posor_estimator.node_parameters import CovarianceKind


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
        self._raw = row[0, LEAD : LEAD + raw.size].data
        self._transform = out[0, LEAD : LEAD + transform.size].data.tobytes
        self._last = example

    def estimate_message(self, data: bytes) -> bytes | None:
        """Return the transform of a raw scan; None where the scan has another layout, which changes nothing."""
        if len(data) < self._size:
            return None
        self._raw[:] = data if len(data) == self._size else data[: self._size]
        if not self._estimate_rows():
            return None
        self._last = data
        return self._transform()

    def stamp_and_change(self) -> tuple[int, int]:
        """Return the stamp of the last scan [ns] (0: invalid), and whether its status differs from the scan before."""
        return self._stamp_ns.item(), self._changed.item()

    def count_from_next(self) -> None:
        """Take the next scan as one that has seen the home mark."""
        self.status["count_from_next"] = 1

    @property
    def counts_from_next(self) -> bool:
        """Whether that scan has yet to come."""
        return bool(self.status["count_from_next"][0])

    def last_scan(self) -> EstimatedScan:
        """Return the last scan and its estimate."""
        status = self.status[0]
        usable = bool(status["readings_usable"])
        return EstimatedScan(self, self._last, int(status["stamp_ns"]), usable, self._estimator.estimate[0].copy())

    def reason(self, scan: EstimatedScan) -> str:
        """Return the sentence on the fault of a scan, empty where it has none; may be called in any thread."""
        raw = scan_of(scan.data)
        if not scan.readings_usable:
            what = f"comes from frame '{self.frame}'; expected '{self._parent}', as in the calibration."
        elif scan.stamp_ns == 0:
            what = f"the stamp {NO_TIME}; expected the time of exposure."
        else:
            return self._posor.reason(raw, scan.estimate)
        return f"scan {raw.number}: {what}"


class EstimatedScan(NamedTuple):
    """A scan of a stream and its estimate.

    Attributes:
        stream: The stream.
        data: The scan as a serialised message.
        stamp_ns: Its stamp [ns]; 0: invalid.
        readings_usable: Whether its frame is the receiving plate.
        estimate: Record of dtype ESTIMATE.

    """

    stream: RawScanStream
    data: bytes
    stamp_ns: int
    readings_usable: bool
    estimate: Any

    @property
    def number(self) -> int:
        """The scan's number."""
        return scan_of(self.data).number

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
