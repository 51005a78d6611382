# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops over the bytes of many messages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posor.numerics.compiled import compiled

if TYPE_CHECKING:
    from posor.numerics.array_types import ByteArray, IntArray, LongArray

MESSAGE = 0x05  # opcode of a message record in a chunk of an MCAP file
RECORD_HEAD = 9  # opcode and length of any record [bytes]
MESSAGE_HEAD = 22  # channel, sequence number, log and publish time [bytes]


@compiled
def index_messages(
    data: ByteArray, numbers: IntArray, topics: IntArray, times: IntArray, starts: IntArray, lengths: IntArray
) -> tuple[int, int]:
    """Find the messages of some topics among the records of a decompressed chunk, in order.

    ``data``: the chunk's records, shape (b,); ``numbers``: number of each channel's topic, negative for other topics,
    shape (65536,); ``topics``: number of each message's topic, written; capacity for b / 31 messages; ``times``: log
    time of each message [ns], written; ``starts``: offset of each message in ``data``, written; ``lengths``: bytes of
    each message, written. Return the number of messages, and the end of reading: b, or the offset of a record that does
    not end within the chunk.
    """
    size, count, offset = data.shape[0], 0, 0
    while offset < size:
        if offset + RECORD_HEAD > size:
            return count, offset
        length = 0
        for k in range(8):
            length |= int(data[offset + 1 + k]) << (8 * k)
        begin = offset + RECORD_HEAD
        if length < 0 or length > size - begin:
            return count, offset
        if data[offset] == MESSAGE:
            if length < MESSAGE_HEAD:
                return count, offset
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
        offset = begin + length
    return count, offset


@compiled
def copy_messages(data: ByteArray, starts: IntArray, lengths: IntArray, out: ByteArray) -> None:
    """Copy messages, one after the other.

    ``data``: bytes that contain the messages, shape (b,); ``starts``: offset of each message, shape (n,); ``lengths``:
    bytes of each message, shape (n,); ``out``: written, as long as all messages.
    """
    offset = 0
    for n in range(starts.shape[0]):
        size = lengths[n]
        message, copy = data[starts[n] : starts[n] + size], out[offset : offset + size]
        for k in range(size):
            copy[k] = message[k]
        offset += size


@compiled
def gather_rows(
    data: ByteArray, starts: IntArray, lengths: IntArray, layout: LongArray, words: LongArray, out: ByteArray
) -> int:
    """Copy messages to the rows of a table up to the first message of another layout.

    ``data``: bytes that contain the messages, shape (b,); ``starts``: offset of each message, shape (n,); ``lengths``:
    bytes of each message, shape (n,); ``layout``: example row of the table, and the bits that every row of the layout
    shares with it, shape (2, w); ``words``: the rows as words of eight bytes, shape (n, w); ``out``: the messages in
    the rows, written, shape (n, s). Return the number of messages copied; the row after them may have been overwritten.
    """
    count: int = starts.shape[0]
    size = out.shape[1]
    for n in range(count):
        if lengths[n] < size:
            return n
        # Slices: a computed index might be negative, which would keep the loop from being vectorised.
        message, row = data[starts[n] : starts[n] + size], out[n]
        for k in range(size):
            row[k] = message[k]
        other = np.uint64(0)
        for k in range(layout.shape[1]):
            other |= (words[n, k] ^ layout[0, k]) & layout[1, k]
        if other != 0:
            return n
    return count


@compiled
def write_records(
    head: ByteArray, times: IntArray, messages: ByteArray, begin: int, out: ByteArray, index: IntArray
) -> None:
    """Write messages as records of a chunk of an MCAP file.

    ``head``: first bytes of every record, both times zero, shape (h,); ``times``: log and publish time of each message
    [ns], shape (n,); ``messages``: shape (n, s); ``begin``: offset of the first record in the chunk; ``out``: written,
    shape (n, h + s); ``index``: log time and offset of each record, written, shape (n, 2).
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
