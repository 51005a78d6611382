# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Streams of messages: raw scans to joint transforms, unpacked, estimated and packed in one compiled call.

A message is a row of bytes whose numbers lie at multiples of their size. The layouts (``messages.raw_scan``,
``messages.joint_transform``) hold the byte offset of each field in its row; they are the same for all messages whose
strings and sequences have the same lengths.
"""

from __future__ import annotations

import math
import struct
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from posor.estimation.estimate_scan import DONE, LOST, estimate_scan, write_lost
from posor.estimation.fault_effects import write_fault_effects
from posor.estimation.fault_model import EFFECT
from posor.messages.cdr_schema import STAMP
from posor.messages.joint_transform import TransformConstants, pack_estimate, packing_layout
from posor.messages.message_definitions import installed_schema
from posor.messages.message_table import LEAD, MessageRows, TableLayout
from posor.messages.raw_scan import raw_scan_layout, scan_of, unpack_scan
from posor.model.fault import Fault, State
from posor.model.scan import STATED_HOME, Scans
from posor.numerics.compiled import bind_in_parts, in_parts, in_place, record_view, run_in_turn
from posor.numerics.stamps import NO_TIME, NS, accepted_in_kernel
from posor.ros_names import JOINT_TRANSFORM, RAW_SCAN

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from posor.chain.joint_measurements import JointRows
    from posor.estimation.posor import Posor
    from posor.estimation.workspace import Model
    from posor.model.scan import Scan
    from posor.numerics.array_types import ByteArray, FloatArray, WordArray
    from posor.numerics.kernel_library import BoundKernel

STATUS = np.dtype(  # status of a stream of scans
    [
        ("readings_usable", "i8"),  # 0: the scans are of another frame; every scan is LOST
        ("count_from_next", "i8"),  # 1: the next scan is stated to be at the home mark
        ("with_effects", "i8"),  # 0: the fault effects of transforms are NaN, because nobody reads them
        ("youngest_ns", "f8"),  # least age of an expected scan; negative: its stamp is ahead of time
        ("oldest_ns", "f8"),  # greatest age of an expected scan
        ("number", "u8"),  # of the last scan
        ("stamp_ns", "i8"),  # of the last scan; 0: invalid
        ("state", "i8"),  # of the last scan; -1: there was none
        ("faults", "i8"),
        ("row_changes", "i8"),  # how often scans have read other rows than the scan before, as another light source
        ("changed", "i8"),  # 1: state, faults or row changes differ from the scan before
        ("step", "u8"),  # number of the last scan less the newest before it; 1: none is missing, or it was not newer
        ("left", "i8"),  # what the kernel has left to do for the last message; DONE: nothing
    ]
)
_FIELDS: Any = STATUS.fields
STAMP_NS, CHANGED, STEP, WITH_EFFECTS = (
    _FIELDS[name][1] // 8 for name in ("stamp_ns", "changed", "step", "with_effects")
)

OTHER_LAYOUT, UNEXPECTED = 4, 5
"""Further results. OTHER_LAYOUT: the layout differs. UNEXPECTED: the number is not greater than the last one, or the
age is out of the limits. In both cases the state is unchanged."""
RECORDED = -1  # in place of the present time: the age of a scan is unknown
USABLE, UNUSABLE = 0, 1
BAD_READING = int(Fault.BAD_READING)


EVERY_LAYOUT = np.zeros(0, dtype=np.int32)  # for rows that are known to have the layout of the stream


class MessageStream(NamedTuple):
    """What ``estimate_messages`` reads and writes beside the model."""

    raw: MessageRows  # rows of raw scans
    raw_layout: NDArray[np.void]  # shape (1,), dtype RAW_SCAN_LAYOUT
    expected: WordArray  # words that all raw scans of this layout have in the bits of ``decisive``, shape (words,)
    decisive: WordArray  # see ``expected``; of length zero: all rows are known to have this layout
    transforms: MessageRows  # rows of transforms to write
    transform_layout: NDArray[np.void]  # shape (1,), dtype TRANSFORM_LAYOUT
    template: FloatArray  # a row of a transform with what is the same in all, shape (floats,)
    effects: NDArray[np.float32]  # fault effects of the last scan, shape (1, C, EFFECT)
    status: NDArray[np.void]  # shape (1,), dtype STATUS

    @staticmethod
    def of(
        raw: TableLayout,
        transforms: TableLayout,
        raw_rows: ByteArray,
        transform_rows: ByteArray,
        *,
        check: bool = False,
    ) -> MessageStream:
        """Return a stream of raw scans and of transforms, rows (n, bytes) each.

        ``raw``: layout of the raw scans; ``transforms``: layout of the transforms; ``raw_rows``: raw scans;
        ``transform_rows``: transforms to write; ``check``: whether rows of another layout may come.
        """
        status = np.zeros(1, dtype=STATUS)
        status["state"], status["youngest_ns"], status["oldest_ns"] = -1, -math.inf, math.inf
        status["with_effects"] = 1
        status["readings_usable"] = raw.strings["header.frame_id"] == transforms.strings["header.frame_id"]
        return MessageStream(
            raw=MessageRows.of(raw_rows),
            raw_layout=record_view(raw_scan_layout(raw)),
            expected=raw.row.view(np.int32) if check else EVERY_LAYOUT,
            decisive=raw.fixed.view(np.int32) if check else EVERY_LAYOUT,
            transforms=MessageRows.of(transform_rows),
            transform_layout=record_view(packing_layout(transforms)),
            template=transforms.row.view(np.float64),
            effects=np.zeros((1, transforms.dtype["effects"].shape[0] // EFFECT, EFFECT), dtype=np.float32),
            status=record_view(status),
        )


@in_place
def _has_layout(stream: MessageStream, n: int) -> bool:
    differs = 0
    for k in range(stream.decisive.shape[0]):
        differs |= (stream.raw.words[n, k] ^ stream.expected[k]) & stream.decisive[k]
    return differs == 0


@in_place
def _copy_identity(stream: MessageStream, n: int) -> None:
    """Copy stamp, number and status of raw scan n to its transform, bit by bit."""
    raw, out = stream.raw.words, stream.transforms.words
    source, target = stream.raw_layout[0], stream.transform_layout[0]
    for i in range(2):
        out[n, target.stamp // 4 + i] = raw[n, source.stamp // 4 + i]
        out[n, target.number // 4 + i] = raw[n, source.number // 4 + i]
    out[n, target.status // 4] = raw[n, source.status // 4]


@in_place
def _is_expected(scan: Any, status: Any, now_ns: int) -> bool:
    """Return whether a scan has a greater number than the last scan and an accepted age."""
    follows = status.state >= 0 and scan.number > status.number
    return bool(follows and accepted_in_kernel(now_ns - scan.stamp_ns, status.youngest_ns, status.oldest_ns))


@in_place
def _write_step(scan: Any, clocks: Any, status: Any) -> None:
    """Write how many numbers a scan comes after the newest before it, which a late scan was not."""
    status.step = 1
    if status.state >= 0 and scan.number > status.number and scan.number > clocks.number:
        status.step = scan.number - max(status.number, clocks.number)


@in_place
def begin_message(model: Model, stream: MessageStream, n: int, now_ns: int, only_expected: int) -> int:
    """Unpack message n into the workspace; return USABLE, UNUSABLE (its estimate is LOST), or why it was not used."""
    if not _has_layout(stream, n):
        return OTHER_LAYOUT
    workspace, status = model.workspace[0], stream.status[0]
    scan, estimate = workspace.scan, workspace.estimate
    unpack_scan(stream.raw, n, stream.raw_layout[0], scan)
    if only_expected and not _is_expected(scan, status, now_ns):
        return UNEXPECTED
    is_live = now_ns != RECORDED and status.oldest_ns < math.inf
    workspace.tracker.clocks.age = (now_ns - scan.stamp_ns) / NS if is_live else math.nan
    _write_step(scan, workspace.tracker.clocks, status)
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
    effects = stream.effects[0]
    if status.with_effects and effects.shape[0] > 0:
        write_fault_effects(model, workspace.scan, estimate, effects)
    else:
        for c in range(effects.shape[0]):
            for k in range(EFFECT):
                effects[c, k] = math.nan
    pack_estimate(estimate, effects, stream.transform_layout[0], stream.template, stream.transforms, n)
    _copy_identity(stream, n)
    same = status.state == estimate.state and status.faults == estimate.faults
    status.changed = 0 if same and status.row_changes == workspace.row_changes else 1
    status.number = workspace.scan.number
    status.state, status.faults, status.row_changes = estimate.state, estimate.faults, workspace.row_changes


@in_place
def estimate_messages(
    model: Model, stream: MessageStream, begin: int, end: int, now_ns: int, only_expected: int
) -> tuple[int, int]:
    """Estimate messages ``begin`` to ``end``; stop at the first that needs a start, a retry or another layout.

    ``now_ns``: the present time, or RECORDED; ``only_expected``: 1 to stop at an unexpected scan, too. Return where the
    loop stopped, ``end`` or the message in question, and what is left to do for that message.
    """
    workspace, status = model.workspace[0], stream.status[0]
    for n in range(begin, end):
        begun = begin_message(model, stream, n, now_ns, only_expected)
        left = DONE if begun == UNUSABLE else begun
        if begun == USABLE:
            left = estimate_scan(model, workspace.scan, workspace.estimate)
            if left == DONE and workspace.estimate.state != LOST:
                status.count_from_next = 0
        status.left = left
        if left != DONE:
            return n, left
        end_message(model, stream, n)
    return end, DONE


@in_place
def copy_transform(stream: MessageStream, rows: JointRows, j: int) -> None:
    """Copy the first transform of a stream into row j of an arm; count the row as missing if the kernel left it."""
    if stream.status[0].left != DONE:
        rows.missing[0] += 1
        return
    for k in range(stream.transforms.floats.shape[1]):
        rows.numbers[j, k] = stream.transforms.floats[0, k]


class MessageEstimator:
    """Estimates the raw scans in rows of bytes into rows of transforms.

    Attributes:
        status: Status of the stream, shape (1,), dtype STATUS.
        estimate: Estimate of the last scan, shape (1,), dtype ESTIMATE.
        kernel: ``estimate_messages`` with the model and the stream.

    """

    def __init__(self, posor: Posor, stream: MessageStream) -> None:
        self._posor, self._stream = posor, stream
        self.status, self.estimate = stream.status, posor.model.workspace["estimate"]
        self._scan = posor.model.workspace["scan"]
        self._count = len(stream.raw.octets)
        if posor.has_plain_sensors:
            self.kernel = in_parts(self._estimate_in_python)
        else:
            self.kernel = bind_in_parts(estimate_messages, (posor.model, stream))

    def estimate_rows(self) -> bool:
        """Estimate all rows; return False where a row has another layout and the rest has not been estimated."""
        done = 0
        while done < self._count:
            self.kernel.put((done, self._count, RECORDED, 0))
            self.kernel.run()
            done, left = self.kernel.results()
            if left != DONE:
                if not self.finish_row(done, left):
                    return False
                done += 1
        return True

    def finish_row(self, n: int, left: int) -> bool:
        """Do what ``kernel`` has left to do for row n; return False where the row cannot be estimated."""
        if left >= OTHER_LAYOUT:
            return False
        no_effects = self._posor.allocate_effects(0)  # ``_end`` writes them
        self._posor.finish_scan(record_view(self._scan), record_view(self.estimate), no_effects, 0, left)
        self._end(n)
        return True

    def _estimate_in_python(self, begin: int, end: int, now_ns: int, only_expected: int) -> tuple[int, int]:
        """Do the same as ``estimate_messages`` by a POSOR with sensors written in plain Python."""
        model, stream = self._posor.model, self._stream
        for n in range(begin, end):
            begun = begin_message(model, stream, n, now_ns, only_expected)
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


class RawScanStream:
    """Estimates the raw scans of one layout: the same frame, the same numbers of readings.

    Attributes:
        frame: Frame of the scans.
        status: Status of the stream, shape (1,), dtype ``message_stream.STATUS``.
        kernel: Estimates the scan of ``prepare``.
        transform: Returns the transform of the last estimated scan.

    """

    def __init__(self, posor: Posor, example: bytes) -> None:
        """Take the layout of an ``example`` in plain CDR. Raises TopicError: the example is not a raw scan."""
        raw = TableLayout.of(example, installed_schema(RAW_SCAN))
        transform = TransformConstants.of(posor).layout(installed_schema(JOINT_TRANSFORM))
        self._posor, self._parent, self.frame = posor, posor.calibration.frames.parent, raw.strings["header.frame_id"]
        row, out = raw.row[None].copy(), transform.row[None].copy()
        self._messages = MessageStream.of(raw, transform, row, out, check=True)
        self._estimator = MessageEstimator(posor, self._messages)
        self.kernel, self.status = self._estimator.kernel, self._estimator.status
        self._put = self.kernel.put
        self._numbers = self.status.view(np.int64).data  # as plain numbers, which take a tenth of the time to read
        self._size = raw.size
        self._refusal = ""
        number = raw.offset("scan")
        self._unpack_identity = struct.Struct(f"<iI{number - STAMP.stop}xQ").unpack_from
        self._frame_bytes = example[STAMP.stop : STAMP.stop + 5 + len(self.frame.encode())]
        self._raw = row[0, LEAD : LEAD + raw.size].data
        self.transform = out[0, LEAD : LEAD + transform.size].data.tobytes
        self._last = self._last_but_one = example
        _run_of.cache_clear()  # the calls keep the stream that this one may replace, megabytes with its model

    def identity(self, data: bytes) -> tuple[int, int] | None:
        """Return stamp [ns], unchecked, and number of a raw scan; None if its frame or length differs."""
        if len(data) < self._size or not data.startswith(self._frame_bytes, STAMP.stop):
            return None
        seconds, nanoseconds, number = self._unpack_identity(data, STAMP.start)
        return seconds * NS + nanoseconds, number

    def last_stamp_and_number(self) -> tuple[int, int] | None:
        """Return stamp and number of the last scan, as ``identity``; None: there was none."""
        return None if self.status["state"] < 0 else self.identity(self._last)

    def is_last(self, data: bytes) -> bool:
        """Return whether a raw scan is the last one again, byte for byte."""
        return data == self._last

    def number_of(self, data: bytes) -> int:
        """Return the number of a raw scan of this layout."""
        return int(self._unpack_identity(data, STAMP.start)[2])

    def refuse_message(self, data: bytes, refusal: str) -> bytes | None:
        """Return a LOST transform of a raw scan that must not be used, as ``estimate_message`` does.

        ``data``: the scan, which the estimator does not see; ``refusal``: sentence on the reason.
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

    def estimate_message(self, data: bytes, now_ns: int = RECORDED) -> bytes | None:
        """Return the transform of a raw scan; None where the scan has another layout, which changes nothing.

        ``now_ns``: the present time [ns] by the clock of the stamps, where the scan has just arrived.
        """
        if not self.prepare(data, now_ns, only_expected=False):
            return None
        self.kernel.run()
        return self.finish(data)

    def prepare(self, data: bytes, now_ns: int, *, only_expected: bool = True) -> bool:
        """Have the next run estimate a raw scan, see ``estimate_message``; return False where it is too short.

        With ``only_expected`` the run leaves a scan as it does one of another layout if it is unexpected: its number is
        not greater than that of the last scan, there is no last scan, or its age is not accepted.
        """
        if len(data) < self._size:
            return False
        self._refusal = ""
        self._raw[:] = data if len(data) == self._size else data[: self._size]
        self._put((0, 1, now_ns, only_expected))
        return True

    @staticmethod
    def run_prepared(streams: tuple[RawScanStream, ...]) -> None:
        """Estimate the scan for which each stream was prepared, all in one compiled call."""
        if len(streams) == 1:
            streams[0].kernel.run()
        else:
            _run_of(streams)()

    def finish(self, data: bytes) -> bytes | None:
        """Return the transform of the raw scan of ``prepare`` after the run, as ``estimate_message`` does."""
        done, left = self.kernel.results()
        if not done and not self._estimator.finish_row(0, left):
            return None
        self.keep(data)
        return self.transform()

    def keep(self, data: bytes) -> None:
        """Take the raw scan of ``prepare`` as the last scan, after a run that has estimated it."""
        self._last_but_one, self._last = self._last, data

    def copy_kernel(self, rows: JointRows, j: int) -> BoundKernel:
        """Return the kernel that copies the transform of the last run to row j of an arm, see ``copy_transform``.

        Raises ValueError: the row is too short.
        """
        if self._messages.transforms.floats.shape[1] > rows.numbers.shape[1]:
            message = f"rows of {rows.octets.shape[1]} bytes, transforms of {self._messages.transforms.octets.shape[1]}"
            raise ValueError(message)
        kernel = bind_in_parts(copy_transform, (self._messages, rows))
        kernel.put((j,))
        return kernel

    def stamp_change_and_missing(self) -> tuple[int, int, int]:
        """Return what concerns the last scan: its stamp, a change, and a gap.

        The stamp is in ns (0: invalid); whether its status differs from the scan before; how many scans are missing.
        """
        return self._numbers[STAMP_NS], self._numbers[CHANGED], self._numbers[STEP] - 1

    def use_effects(self, *, used: bool) -> None:
        """State whether the fault effects of transforms are read; those of scans from the next on are NaN if not."""
        if self._numbers[WITH_EFFECTS] != used:
            self._numbers[WITH_EFFECTS] = used

    def count_from_next(self, *, stated: bool = True) -> None:
        """State, or with ``stated=False`` no longer state, that the next scan is at the home mark."""
        self.status["count_from_next"] = int(stated)

    @property
    def counts_from_next(self) -> bool:
        """Whether that scan has not arrived yet."""
        return bool(self.status["count_from_next"][0])

    def last_scan(self) -> EstimatedScan:
        """Return the last scan and its estimate."""
        status = self.status[0]
        refusal = self._refusal
        if not status["readings_usable"]:
            refusal = f"comes from frame '{self.frame}'; expected '{self._parent}', as in the calibration"
        return EstimatedScan(self, self._last, int(status["stamp_ns"]), refusal, self._estimator.estimate[0].copy())

    def last_lit_scan(self) -> Scan | None:
        """Return the last scan or, if that is dark, the one before; None: that is dark, too."""
        scans = map(scan_of, (self._last, self._last_but_one))
        return next((scan for scan in scans if not Scans.of([scan]).dark[0]), None)

    def reason(self, scan: EstimatedScan) -> str:
        """Return the sentence on the fault of a scan, empty where it has none; may be called in any thread."""
        if not scan.refusal and scan.stamp_ns and scan.estimate["faults"] == 0:
            return ""
        raw = scan_of(scan.data)
        refusal = scan.refusal if scan.stamp_ns else f"the stamp {NO_TIME}; expected the time of exposure"
        return f"scan {raw.number}: {refusal}." if refusal else self._posor.reason(raw, scan.estimate)


@lru_cache(maxsize=16)
def _run_of(streams: tuple[RawScanStream, ...]) -> Callable[[], object]:
    return run_in_turn([stream.kernel for stream in streams])


class EstimatedScan(NamedTuple):
    """A scan of a stream and its estimate."""

    stream: RawScanStream  # the stream
    data: bytes  # the scan as a serialised message
    stamp_ns: int  # its stamp [ns]; 0: invalid
    refusal: str  # why its readings were not used; empty: they were
    estimate: Any  # record of dtype ESTIMATE

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
