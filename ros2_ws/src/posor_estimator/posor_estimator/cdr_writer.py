"""Writes similar messages scan after scan into one buffer: only stamp and numbers change."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor.messages.cdr_schema import STAMP
from posor_ros.message_classes import schema_of_class

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor.numerics.array_types import FloatArray


class MessageWriter:
    """Writes messages of one type that differ in stamp and numbers only."""

    def __init__(self, prototype: Any, arrays: Mapping[str, FloatArray] | None = None) -> None:
        """Prepare for messages like ``prototype``.

        ``prototype``: a message with a header, and with the strings, lengths and constants of all messages; ``arrays``:
        arrays whose present numbers are written into every message, by the path of the first field: the seven numbers
        of a pose begin at ``pose.position.x``. Raises TopicError: a sequence is longer than its bound.
        """
        schema = schema_of_class(type(prototype))
        data = schema.serialize(prototype)
        self._layout = schema.layout(data)
        self._buffer = memoryview(bytearray(data))
        self._copies = tuple(self._copy(path, array) for path, array in (arrays or {}).items() if array.size)

    def write(self, stamp: bytes) -> bytes:
        """Return the message with the present numbers of the arrays.

        ``stamp``: the eight bytes of its stamp (``STAMP``).
        """
        data = self._buffer
        data[STAMP] = stamp
        for part, numbers in self._copies:
            part[:] = numbers
        return data.tobytes()

    def _copy(self, path: str, array: FloatArray) -> tuple[memoryview, memoryview]:
        begin = self._layout[path].offset
        return self._buffer[begin : begin + array.nbytes], array.data.cast("B")
