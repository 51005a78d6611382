"""Messages written scan after scan into one place: what stays is written once, only numbers and stamp are changed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from posor_estimator.ros.cdr import STAMP, Schema
from posor_estimator.ros.cdr_walk import BODY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.types import FloatArray

ALIGNED = 8
"""Numpy computes faster where numbers lie at multiples of their size."""


class MessageWriter:
    """Writes messages of one type that differ in numbers only.

    Attributes:
        layout: Of every message written.

    """

    def __init__(self, prototype: Any, arrays: Mapping[str, FloatArray] | None = None) -> None:
        """Prepare for messages like ``prototype``.

        Args:
            prototype: A message with a header whose strings, lengths and constants are right.
            arrays: Arrays whose numbers every message carries, as they are when it is written, by the path of the field
                in which they begin: the seven of a pose begin at ``pose.position.x``.

        Raises:
            TopicError: A sequence is longer than its bound.

        """
        schema = Schema.of(type(prototype))
        data = schema.serialize(prototype)
        self.layout = schema.layout(data)
        room = np.zeros(len(data) + ALIGNED - BODY, dtype=np.uint8)
        self._store = room[ALIGNED - BODY :]
        self._store[:] = np.frombuffer(data, dtype=np.uint8)
        self.bytes = self._store.data
        self._copies = tuple(self._copy(path, array) for path, array in (arrays or {}).items() if array.size)

    def view(self, path: str, count: int) -> FloatArray:
        """Return the ``count`` numbers (float64) of the message from a field on, to be written in place."""
        begin = self.layout[path].offset
        return self._store[begin : begin + 8 * count].view(np.float64)

    def write(self, stamp: bytes) -> bytes:
        """Return the message with its arrays' present numbers.

        Args:
            stamp: Its stamp, in the eight bytes in which it came (``STAMP``).

        """
        data = self.bytes
        data[STAMP] = stamp
        for part, numbers in self._copies:
            data[part] = numbers
        return bytes(data)

    def _copy(self, path: str, array: FloatArray) -> tuple[slice, memoryview]:
        begin = self.layout[path].offset
        return slice(begin, begin + array.nbytes), array.data.cast("B")
