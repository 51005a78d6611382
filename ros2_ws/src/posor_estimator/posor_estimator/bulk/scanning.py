"""Loops over the bytes of many messages, compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor_estimator.core.compiled import compiled

if TYPE_CHECKING:
    from posor_estimator.bulk.layout import LongArray
    from posor_estimator.core.types import ByteArray, IntArray

MESSAGE = 0x05
"""Opcode of a message record in a chunk of an MCAP file."""
RECORD_HEAD = 9
"""Opcode and length of any record [bytes]."""
MESSAGE_HEAD = 22
"""Channel, sequence number, log and publish time [bytes]."""


@compiled
def index_messages(
    data: ByteArray, numbers: IntArray, topics: IntArray, times: IntArray, starts: IntArray, lengths: IntArray
) -> tuple[int, int]:
    """Find the messages of some topics among the records of a decompressed chunk, in their order.

    Args:
        data: The chunk's records, shape (b,).
        numbers: Of each channel the number of its topic, negative where it is not wanted, shape (65536,).
        topics: Number of each message's topic, to write; entries for all messages that there may be, b / 31 at most.
        times: Log time of each [ns], to write.
        starts: Where its bytes begin in ``data``, to write.
        lengths: How many bytes it has, to write.

    Returns:
        The number of messages, and where reading ended: b, or the record that does not end within the chunk.

    """
    size, count, at = data.shape[0], 0, 0
    while at < size:
        if at + RECORD_HEAD > size:
            return count, at
        length = 0
        for k in range(8):
            length |= int(data[at + 1 + k]) << (8 * k)
        begin = at + RECORD_HEAD
        if length < 0 or length > size - begin:
            return count, at
        if data[at] == MESSAGE:
            if length < MESSAGE_HEAD:
                return count, at
            topic = numbers[int(data[begin]) | int(data[begin + 1]) << 8]
            if topic >= 0:
                time = 0
                for k in range(8):
                    time |= int(data[begin + 6 + k]) << (8 * k)
                topics[count] = topic
                times[count] = time
                starts[count] = begin + MESSAGE_HEAD
                lengths[count] = length - MESSAGE_HEAD
                count += 1
        at = begin + length
    return count, at


@compiled
def copy_messages(data: ByteArray, starts: IntArray, lengths: IntArray, out: ByteArray) -> None:
    """Copy messages, one behind the other.

    Args:
        data: Where they lie, shape (b,).
        starts: Where each begins, shape (n,).
        lengths: How many bytes each has, shape (n,).
        out: To write, as long as all of them.

    """
    at = 0
    for n in range(starts.shape[0]):
        size = lengths[n]
        message, copy = data[starts[n] : starts[n] + size], out[at : at + size]
        for k in range(size):
            copy[k] = message[k]
        at += size


@compiled
def gather(
    data: ByteArray,
    starts: IntArray,
    lengths: IntArray,
    template: LongArray,
    fixed: LongArray,
    words: LongArray,
    out: ByteArray,
) -> int:
    """Copy messages to the rows of a table as long as they have its layout: its length at least, its bytes that decide.

    Args:
        data: Where the messages lie, shape (b,).
        starts: Where each begins, shape (n,).
        lengths: How many bytes each has, shape (n,).
        template: A row of the table, shape (w,).
        fixed: The bits of it that decide, shape (w,).
        words: The rows, eight bytes a word, shape (n, w).
        out: The messages in the rows, to write, shape (n, s).

    Returns:
        How many were copied; the row after them may have been written to.

    """
    count: int = starts.shape[0]
    size = out.shape[1]
    for n in range(count):
        if lengths[n] < size:
            return n
        # Slices, since an index that is reckoned might be negative, and the loop would go byte by byte.
        message, row = data[starts[n] : starts[n] + size], out[n]
        for k in range(size):
            row[k] = message[k]
        other = np.uint64(0)
        for k in range(template.shape[0]):
            other |= (words[n, k] ^ template[k]) & fixed[k]
        if other != 0:
            return n
    return count


@compiled
def write_records(
    head: ByteArray, times: IntArray, messages: ByteArray, begin: int, out: ByteArray, index: IntArray
) -> None:
    """Write messages as records of a chunk of an MCAP file.

    Args:
        head: What the records begin with, both times zero, shape (h,).
        times: Log and publish time of each [ns], shape (n,).
        messages: Shape (n, s).
        begin: Where in the chunk the records begin.
        out: To write, shape (n, h + s).
        index: Log times and where each record begins, to write, shape (n, 2).

    """
    size = head.shape[0]
    for n in range(times.shape[0]):
        start, body, message = out[n, :size], out[n, size:], messages[n]
        for k in range(size):
            start[k] = head[k]
        time = times[n]
        index[n, 0], index[n, 1] = time, begin + n * out.shape[1]
        for k in range(8):
            start[size - 16 + k] = start[size - 8 + k] = (time >> (8 * k)) & 0xFF
        for k in range(body.shape[0]):
            body[k] = message[k]
