"""Through the bytes of a message field by field: finding where each lies, and writing them."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from posor_estimator.errors import TopicError
from posor_estimator.ros.cdr_fields import Kind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.ros.cdr_fields import Field

LITTLE_ENDIAN = b"\x00\x01"
"""First two bytes of a message in plain CDR, little endian; two bytes of options follow, which mean nothing here."""
BODY = 4
"""Where the fields begin, and what their alignment counts from."""


Value: TypeAlias = Any
"""Of a field: a number, a list of numbers, a string or a list of strings."""


class Span(NamedTuple):
    """Where the elements of a field lie in the bytes of a message.

    For a string, the elements are its bytes in UTF-8, the closing zero not counted.
    """

    offset: int
    length: int
    size: int
    """Of one element [bytes]."""

    @property
    def part(self) -> slice:
        """The bytes of all elements."""
        return slice(self.offset, self.offset + self.length * self.size)


class Walk:
    """Goes through a message from its beginning to its end."""

    def __init__(self, name: str, data: bytes) -> None:
        self._name = name
        self._data = data
        self.at = BODY
        self.spans: dict[str, Span] = {}
        self.lengths: dict[str, int] = {}
        self.decisive: dict[int, bytes] = {0: LITTLE_ENDIAN}
        if data[:2] != LITTLE_ENDIAN:
            raise TopicError(
                f"a message begins with bytes '{data[:2].hex()}'",
                where=self._name,
                expected=f"'{LITTLE_ENDIAN.hex()}', plain CDR in little endian",
            )

    def visit(self, field: Field) -> None:
        """Find the next field."""
        count = 1
        if field.kind is Kind.ARRAY:
            count = field.count or 0
        elif field.kind is Kind.SEQUENCE:
            count = self._length(field)
            if field.count is not None and count > field.count:
                raise TopicError(
                    f"a message says that it has {count} {field.path}",
                    where=self._name,
                    expected=f"at most {field.count}",
                )
        if field.code != "s":
            size = struct.calcsize(field.code)
            # An empty sequence needs no alignment of elements that are not there.
            begin = aligned(self.at, size) if count else self.at
            self._go_to(begin + count * size, field)
            self.spans[field.path] = Span(begin, count, size)
        elif field.kind is Kind.ONE:
            self.spans[field.path] = self._string(field)
        else:
            for _ in range(count):
                self._string(field)

    def _string(self, field: Field) -> Span:
        length = self._length(field)
        begin = self.at
        self._go_to(begin + length, field)
        if not length or self._data[self.at - 1] != 0:
            raise TopicError(f"in a message, the string '{field.path}' has no zero at its end", where=self._name)
        return Span(begin, length - 1, 1)

    def _length(self, field: Field) -> int:
        begin = aligned(self.at, 4)
        self._go_to(begin + 4, field)
        self.lengths.setdefault(field.path, begin)
        self.decisive[begin] = self._data[begin : begin + 4]
        return int.from_bytes(self._data[begin : begin + 4], "little")

    def _go_to(self, at: int, field: Field) -> None:
        if at > len(self._data):
            raise TopicError(
                f"a message of {len(self._data)} bytes ends within '{field.path}'",
                where=self._name,
                expected=f"at least {at} bytes",
            )
        self.at = at


def write(out: bytearray, field: Field, value: Value, name: str) -> None:
    """Append a field of a message type of that name to a message.

    Raises:
        TopicError: A sequence is longer than its bound.

    """
    elements = [value] if field.kind is Kind.ONE else value
    if field.kind is Kind.SEQUENCE:
        if field.count is not None and len(elements) > field.count:
            raise TopicError(
                f"a message has {len(elements)} {field.path}", where=name, expected=f"at most {field.count}"
            )
        _put(out, "I", [len(elements)])
    if field.code != "s":
        _put(out, field.code, elements)
        return
    for text in elements:
        said = text.encode("utf-8") + b"\x00"
        _put(out, "I", [len(said)])
        out += said


def _put(out: bytearray, code: str, elements: Sequence[Value]) -> None:
    if len(elements):
        out.extend(bytes(aligned(len(out), struct.calcsize(code)) - len(out)))
        out.extend(struct.pack(f"<{len(elements)}{code}", *elements))


def aligned(at: int, size: int) -> int:
    """Return the next place in a message where a number of ``size`` bytes may begin."""
    return at + (BODY - at) % size
