"""Messages written scan after scan into one place: what stays is written once, only numbers and stamp are changed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from posor_estimator.ros.cdr import STAMP, Schema

if TYPE_CHECKING:
    from collections.abc import Mapping

    from posor_estimator.core.types import FloatArray


class MessageWriter:
    """Writes messages of one type that differ in numbers only."""

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
        self._layout = schema.layout(data)
        self._into = memoryview(bytearray(data))
        self._copies = tuple(self._copy(path, array) for path, array in (arrays or {}).items() if array.size)

    def write(self, stamp: bytes) -> bytes:
        """Return the message with its arrays' present numbers.

        Args:
            stamp: Its stamp, in the eight bytes in which it came (``STAMP``).

        """
        data = self._into
        data[STAMP] = stamp
        for part, numbers in self._copies:
            part[:] = numbers
        return data.tobytes()

    def _copy(self, path: str, array: FloatArray) -> tuple[memoryview, memoryview]:
        begin = self._layout[path].offset
        return self._into[begin : begin + array.nbytes], array.data.cast("B")
