"""Loops over the bytes of many messages, compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_estimator.core.compiled import compiled

if TYPE_CHECKING:
    from posor_estimator.bulk.layout import ByteArray
    from posor_estimator.core.types import BoolArray, IntArray

MESSAGE = 0x05
"""Opcode of a message record in a chunk of an MCAP file."""
RECORD_HEAD = 9
"""Opcode and length of any record [bytes]."""
MESSAGE_HEAD = 22
"""Channel, sequence number, log and publish time [bytes]."""


@compiled
def index_messages(
    data: ByteArray, channels: IntArray, times: IntArray, starts: IntArray, lengths: IntArray
) -> tuple[int, int]:
    """Find the message records among the records of a decompressed chunk, in their order.

    Args:
        data: The chunk's records, shape (b,).
        channels: Channel of each message, to write; at least b / 31 entries.
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
            time = 0
            for k in range(8):
                time |= int(data[begin + 6 + k]) << (8 * k)
            channels[count] = int(data[begin]) | int(data[begin + 1]) << 8
            times[count] = time
            starts[count] = begin + MESSAGE_HEAD
            lengths[count] = length - MESSAGE_HEAD
            count += 1
        at = begin + length
    return count, at


@compiled
def fits(
    data: ByteArray, starts: IntArray, lengths: IntArray, template: ByteArray, fixed: IntArray, out: BoolArray
) -> None:
    """Tell which messages have a layout: its length at least, and its bytes where they decide.

    Args:
        data: Where the messages lie, shape (b,).
        starts: Where each begins, shape (n,).
        lengths: How many bytes each has, shape (n,).
        template: A message of the layout, shape (s,).
        fixed: Which of its bytes decide, shape (f,).
        out: To write, shape (n,).

    """
    for n in range(starts.shape[0]):
        same = lengths[n] >= template.shape[0]
        if same:
            for k in range(fixed.shape[0]):
                if data[starts[n] + fixed[k]] != template[fixed[k]]:
                    same = False
                    break
        out[n] = same


@compiled
def gather(data: ByteArray, starts: IntArray, out: ByteArray) -> None:
    """Copy messages of equal length to the rows of a table.

    Args:
        data: Where the messages lie, shape (b,).
        starts: Where each begins, shape (n,).
        out: To write, shape (n, s).

    """
    for n in range(starts.shape[0]):
        begin = starts[n]
        for k in range(out.shape[1]):
            out[n, k] = data[begin + k]
