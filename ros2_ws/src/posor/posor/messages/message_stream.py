"""From serialised raw scans to serialised joint transforms: unpack, estimate, pack, in one compiled call.

A message is a row of bytes whose numbers lie at multiples of their size. RAW_SCAN_LAYOUT and TRANSFORM_LAYOUT hold the
byte offset of each field in its row; they follow from the message definitions (``ros.stream_layout``) and are the
same for all messages whose strings and sequences have the same lengths.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from posor.estimation.estimate_scan import DONE, LOST, estimate_scan, write_lost
from posor.model.fault import Fault
from posor.model.scan import HOME_BUMP, STATED_HOME
from posor.numerics.compiled import compile_for, in_place, inlined, record_view
from posor.numerics.stamps import accepted_in_kernel, time_in_kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from posor.estimation.posor import Posor
    from posor.estimation.workspace import Model
    from posor.numerics.array_types import ByteArray, FloatArray, WordArray

RAW_SCAN_LAYOUT = np.dtype(
    [
        (name, "i8")
        for name in (
            "stamp",  # seconds, then nanoseconds, four bytes each
            "number",
            "status",
            "gap_voltages",
            "gap_count",  # the counts are not offsets either
            "ring_voltages",
            "ring_count",
            "diode_currents",
            "current_count",
            "lit_sources",  # one byte each
            "lit_count",
            "supply_voltage",
            "temperature",
        )
    ]
)
"""Byte offsets of the fields of ``posor_msgs/RawScan`` in its row."""

TRANSFORM_LAYOUT = np.dtype(
    [
        (name, "i8")
        for name in (
            "stamp",
            "number",
            "status",
            "redundancy",  # one byte, followed by the state
            "faults",
            "pose",
            "native",
            "residual",
            "covariance",
            "covariance_kind",  # RANDOM, SYSTEMATIC or TOTAL; not an offset
        )
    ]
)
"""Byte offsets of the fields of ``posor_msgs/JointTransform`` in its row."""

RANDOM, SYSTEMATIC, TOTAL = 0, 1, 2
"""Kinds of covariance, as in ``posor_msgs/JointTransform``."""

STATUS = np.dtype(
    [
        ("readings_usable", "i8"),  # 0: the scans are of another frame; every scan is LOST
        ("count_from_next", "i8"),  # 1: the next scan is stated to be at the home mark
        ("youngest_ns", "f8"),  # least age of an expected scan; negative: its stamp is ahead of time
        ("oldest_ns", "f8"),  # greatest age of an expected scan
        ("number", "u8"),  # of the last scan
        ("stamp_ns", "i8"),  # of the last scan; 0: invalid
        ("state", "i8"),  # of the last scan; -1: there was none
        ("faults", "i8"),
        ("row_changes", "i8"),  # how often scans have read other rows than the scan before, as another light source
        ("changed", "i8"),  # 1: state, faults or row changes differ from the scan before
    ]
)
"""Status of a stream of scans."""

OTHER_LAYOUT, UNEXPECTED = 4, 5
"""Results besides those of ``estimate_scan``: the message has another layout, or its number is not the next one or its
stamp has another age than those of expected scans. It changes nothing."""
UNCHECKED = -1
"""In place of the present time: numbers and ages are not checked."""
USABLE, UNUSABLE = 0, 1
BAD_READING = int(Fault.BAD_READING)


class MessageRows(NamedTuple):
    """Messages in rows: the same memory as bytes, as words of four bytes, and as floats; shape (n, row length)."""

    octets: ByteArray
    words: WordArray
    floats: FloatArray

    @staticmethod
    def of(rows: ByteArray) -> MessageRows:
        """Return views of rows of bytes, whose length is a multiple of eight."""
        return MessageRows(rows, rows.view(np.int32), rows.view(np.float64))


class MessageStream(NamedTuple):
    """What ``estimate_messages`` reads and writes beside the model.

    Attributes:
        raw: Rows of raw scans.
        raw_layout: Shape (1,), dtype RAW_SCAN_LAYOUT.
        expected: Words that all raw scans of this layout have in the bits of ``decisive``, shape (words,).
        decisive: See ``expected``; of length zero: all rows are known to have this layout.
        transforms: Rows of transforms to write.
        transform_layout: Shape (1,), dtype TRANSFORM_LAYOUT.
        template: A row of a transform with what is the same in all, shape (floats,).
        status: Shape (1,), dtype STATUS.

    """

    raw: MessageRows
    raw_layout: NDArray[np.void]
    expected: WordArray
    decisive: WordArray
    transforms: MessageRows
    transform_layout: NDArray[np.void]
    template: FloatArray
    status: NDArray[np.void]


@inlined
def _has_layout(stream: MessageStream, n: int) -> bool:
    """Return whether message n has the layout of the stream."""
    differs = 0
    for k in range(stream.decisive.shape[0]):
        differs |= (stream.raw.words[n, k] ^ stream.expected[k]) & stream.decisive[k]
    return differs == 0


@inlined
def unpack_scan(rows: MessageRows, n: int, layout: Any, scan: Any) -> None:
    """Write the raw scan in row n into a record of dtype SCAN; the stamp is 0 where it is invalid."""
    words, floats = rows.words, rows.floats
    scan.stamp_ns = time_in_kernel(int(words[n, layout.stamp // 4]), int(words[n, layout.stamp // 4 + 1]) & 0xFFFFFFFF)
    number = layout.number // 4
    scan.number = int(words[n, number]) & 0xFFFFFFFF | (int(words[n, number + 1]) & 0xFFFFFFFF) << 32
    scan.status = int(words[n, layout.status // 4]) & 0xFFFFFFFF
    scan.at_home = 1 if scan.status & HOME_BUMP else 0
    scan.gap_count, scan.ring_count = layout.gap_count, layout.ring_count
    scan.current_count, scan.lit_count = layout.current_count, layout.lit_count
    for i in range(layout.gap_count):
        scan.gap_voltages[i] = floats[n, layout.gap_voltages // 8 + i]
    for i in range(layout.ring_count):
        scan.ring_voltages[i] = floats[n, layout.ring_voltages // 8 + i]
    for i in range(layout.current_count):
        scan.diode_currents[i] = floats[n, layout.diode_currents // 8 + i]
    for i in range(layout.lit_count):
        scan.lit_sources[i] = rows.octets[n, layout.lit_sources + i]
    scan.supply_voltage = floats[n, layout.supply_voltage // 8]
    scan.temperature = floats[n, layout.temperature // 8]


@inlined
def pack_estimate(estimate: Any, layout: Any, template: FloatArray, rows: MessageRows, n: int) -> None:
    """Write an estimate (record of dtype ESTIMATE) into row n, but for stamp, number and status of its scan."""
    words, floats = rows.words, rows.floats
    for k in range(template.shape[0]):
        floats[n, k] = template[k]
    words[n, layout.redundancy // 4] = estimate.redundancy | estimate.state << 8
    words[n, layout.faults // 4] = estimate.faults
    for k in range(7):
        floats[n, layout.pose // 8 + k] = estimate.pose[k]
    for k in range(6):
        floats[n, layout.native // 8 + k] = estimate.native[k]
    floats[n, layout.residual // 8] = math.nan if estimate.state == LOST else estimate.residual
    covariance, kind = layout.covariance // 8, layout.covariance_kind
    for i in range(6):
        for j in range(6):
            value = estimate.systematic[i, j] if kind == SYSTEMATIC else estimate.random[i, j]
            if kind == TOTAL:
                value += estimate.systematic[i, j]
            floats[n, covariance + 6 * i + j] = value


@inlined
def _copy_identity(stream: MessageStream, n: int) -> None:
    """Copy stamp, number and status of raw scan n to its transform, bit by bit."""
    raw, out = stream.raw.words, stream.transforms.words
    source, target = stream.raw_layout[0], stream.transform_layout[0]
    for i in range(2):
        out[n, target.stamp // 4 + i] = raw[n, source.stamp // 4 + i]
        out[n, target.number // 4 + i] = raw[n, source.number // 4 + i]
    out[n, target.status // 4] = raw[n, source.status // 4]


@inlined
def _is_expected(scan: Any, status: Any, now_ns: int) -> bool:
    """Return whether a scan has the number after that of the last scan and an accepted age."""
    follows = status.state >= 0 and scan.number > status.number and scan.number - status.number == 1
    return bool(follows and accepted_in_kernel(now_ns - scan.stamp_ns, status.youngest_ns, status.oldest_ns))


@in_place
def begin_message(model: Model, stream: MessageStream, n: int, now_ns: int) -> int:
    """Unpack message n into the workspace; return USABLE, UNUSABLE (its estimate is LOST), or why it was not used."""
    if not _has_layout(stream, n):
        return OTHER_LAYOUT
    workspace, status = model.workspace[0], stream.status[0]
    scan, estimate = workspace.scan, workspace.estimate
    unpack_scan(stream.raw, n, stream.raw_layout[0], scan)
    if now_ns != UNCHECKED and not _is_expected(scan, status, now_ns):
        return UNEXPECTED
    if status.count_from_next:
        scan.at_home = STATED_HOME
    status.stamp_ns = scan.stamp_ns
    if scan.stamp_ns != 0 and status.readings_usable:
        return USABLE
    estimate.sensor, estimate.residual = -1, math.nan
    write_lost(estimate, BAD_READING)
    return UNUSABLE


@in_place
def end_message(model: Model, stream: MessageStream, n: int) -> None:
    """Pack the estimate in the workspace as transform n, and update the status."""
    workspace, status = model.workspace[0], stream.status[0]
    estimate = workspace.estimate
    pack_estimate(estimate, stream.transform_layout[0], stream.template, stream.transforms, n)
    _copy_identity(stream, n)
    same = status.state == estimate.state and status.faults == estimate.faults
    status.changed = 0 if same and status.row_changes == workspace.row_changes else 1
    status.number = workspace.scan.number
    status.state, status.faults, status.row_changes = estimate.state, estimate.faults, workspace.row_changes


@in_place
def estimate_messages(model: Model, stream: MessageStream, begin: int, end: int, now_ns: int) -> tuple[int, int]:
    """Estimate messages ``begin`` to ``end`` while nothing is left to do for one.

    ``now_ns``: the present time, to check numbers and ages, or UNCHECKED.

    Returns:
        Where the loop stopped, ``end`` or the message in question, and what is left to do for that message.

    """
    workspace = model.workspace[0]
    for n in range(begin, end):
        begun = begin_message(model, stream, n, now_ns)
        if begun >= OTHER_LAYOUT:
            return n, begun
        if begun == USABLE:
            left = estimate_scan(model, workspace.scan, workspace.estimate)
            if left != DONE:
                return n, left
            if workspace.estimate.state != LOST:
                stream.status[0].count_from_next = 0
        end_message(model, stream, n)
    return end, DONE


class MessageEstimator:
    """Estimates the raw scans in rows of bytes into rows of transforms.

    Attributes:
        status: Status of the stream, shape (1,), dtype STATUS.
        estimate: Estimate of the last scan, shape (1,), dtype ESTIMATE.

    """

    def __init__(self, posor: Posor, stream: MessageStream) -> None:
        """Prepare for the rows of a stream; the caller fills and reads the rows."""
        self._posor, self._stream = posor, stream
        self.status, self.estimate = stream.status, posor.model.workspace["estimate"]
        self._scan = posor.model.workspace["scan"]
        self._count = len(stream.raw.octets)
        self._estimate = self._estimate_in_python
        if not posor.has_plain_sensors:
            self._estimate = compile_for(estimate_messages, (posor.model, stream, 0, self._count, UNCHECKED))

    def estimate_rows(self, now_ns: int = UNCHECKED) -> bool:
        """Estimate all rows; return False where a row has another layout and the rest has not been estimated.

        With the present time, that is also the return value where a scan is unexpected, see ``STATUS``.
        """
        done = 0
        while done < self._count:
            done, left = self._estimate(self._posor.model, self._stream, done, self._count, now_ns)
            if left >= OTHER_LAYOUT:
                return False
            if left != DONE:
                self._posor.finish_scan(record_view(self._scan), record_view(self.estimate), 0, left)
                self._end(done)
                done += 1
        return True

    def _estimate_in_python(
        self, model: Model, stream: MessageStream, begin: int, end: int, now_ns: int
    ) -> tuple[int, int]:
        """Do the same as ``estimate_messages`` by a POSOR with sensors written in plain Python."""
        for n in range(begin, end):
            begun = begin_message(model, stream, n, now_ns)
            if begun >= OTHER_LAYOUT:
                return n, begun
            if begun == USABLE:
                self._posor.estimate_records(self._scan, self.estimate)
                self._end(n)
            else:
                end_message(model, stream, n)
        return end, DONE

    def _end(self, n: int) -> None:
        if self.estimate[0]["state"] != LOST:
            self._stream.status["count_from_next"] = 0
        end_message(self._posor.model, self._stream, n)
