# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Plain CDR (XCDR1, OMG DDS-XTypes 7.4), the encoding of ROS 2 messages: where each field of a message lies.

A message begins with four bytes that name its encapsulation. The fields follow, each aligned to its own size as counted
from the end of those four bytes; a string or a sequence is a length (uint32) and its content. All offsets follow from
the lengths, so one `Layout` serves every message with the same lengths.

A `Schema` is made of a list of fields, which ``messages.message_definitions`` reads from a definition that a bag stores
or that is installed.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

from posor.errors import TopicError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

LITTLE_ENDIAN, BIG_ENDIAN = b"\x00\x01", b"\x00\x00"
"""First two bytes of a message in plain CDR, by byte order; the two bytes of options after them are not used."""
BODY = 4  # offset of the first field. Alignment is counted from here
STAMP = slice(4, 12)  # stamp of a message that begins with a header: seconds (int32), nanoseconds (uint32)

Value: TypeAlias = Any  # value of a field: a number, a byte, a string, a message (values by path), or a list of them


CODES = {  # ``struct`` codes of the basic types, by their names in messages and in IDL; ``s`` for a string
    "bool": "?",
    "boolean": "?",
    "octet": "c",
    "byte": "c",
    "char": "B",
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float": "f",
    "float32": "f",
    "double": "d",
    "float64": "d",
    "string": "s",
}


class FieldKind(Enum):
    """Number of elements of a field."""

    ONE = "one"
    ARRAY = "a fixed number"
    SEQUENCE = "a length, then as many"


@dataclass(frozen=True)
class Field:
    """One field of a message; the fields of a single nested message count as fields of the whole."""

    path: str  # name, for instance ``header.stamp.sec``
    code: str  # ``struct`` code of one element; ``s`` for a string, empty for a message
    kind: FieldKind = FieldKind.ONE  # number of elements
    count: int | None = None  # length of an array, bound of a sequence (None: unbounded)
    parts: tuple[Field, ...] = ()  # fields of each element of an array or sequence of messages

    @property
    def default(self) -> Value:
        """Zero, zeros, an empty string or an empty list."""
        if self.kind is FieldKind.SEQUENCE:
            return []
        zero: Value = {"s": "", "c": b"\x00", "": {}}.get(self.code, 0)
        return [zero] * (self.count or 0) if self.kind is FieldKind.ARRAY else zero


class Span(NamedTuple):
    """Where the elements of a field lie in a message; for a string its UTF-8 bytes without the closing zero."""

    offset: int
    length: int
    size: int  # of one element [bytes]

    @property
    def part(self) -> slice:
        """The bytes of all elements."""
        return slice(self.offset, self.offset + self.length * self.size)


@dataclass(frozen=True)
class Layout:
    """Offsets of all fields in messages whose strings and sequences have certain lengths."""

    schema: Schema  # of the message type
    size: int  # of a message [bytes]; surplus bytes at its end are ignored
    spans: dict[str, Span]  # of each field by its path; a list of strings or messages has none
    # Offset of the length of each string and sequence by its path; of such a list, that of the list
    lengths: dict[str, int]
    # The bytes that a message of this layout must have, by offset: encapsulation and lengths
    decisive: dict[int, bytes]

    def __getitem__(self, path: str) -> Span:
        return self.spans[path]


class Schema:
    """The fields of a message type, in the order of the encoding.

    Attributes:
        name: Of the type, for instance ``RawScan``.
        fields: Its basic fields.
        by_path: The same, by path.

    """

    def __init__(self, name: str, fields: Iterable[Field]) -> None:
        self.name = name
        self.fields = tuple(fields)
        self.by_path = {field.path: field for field in self.fields}

    def layout(self, data: bytes) -> Layout:
        """Return the layout of a message in plain CDR, little endian.

        Raises TopicError: invalid bytes: another encapsulation, an early end, a sequence longer than its bound, a
        string without an end.
        """
        if data[:2] != LITTLE_ENDIAN:
            raise TopicError(
                f"a message begins with bytes '{data[:2].hex()}'",
                where=self.name,
                expected=f"'{LITTLE_ENDIAN.hex()}', plain CDR in little endian",
            )
        walk = _Walk(self, data, "<")
        walk.read_fields()
        return Layout(self, walk.position, walk.spans, walk.lengths, {0: LITTLE_ENDIAN, **walk.length_bytes})

    def values(self, data: bytes) -> dict[str, Value]:
        """Return the values of a message in plain CDR of either byte order, by path.

        Raises TopicError: invalid bytes.
        """
        orders: dict[bytes, Literal["<", ">"]] = {LITTLE_ENDIAN: "<", BIG_ENDIAN: ">"}
        if data[:2] not in orders:
            raise TopicError(
                f"a message begins with bytes '{data[:2].hex()}'",
                where=self.name,
                expected=f"'{LITTLE_ENDIAN.hex()}' or '{BIG_ENDIAN.hex()}', plain CDR",
            )
        return _Walk(self, data, orders[data[:2]]).read_fields()

    def encode(self, values: Mapping[str, Value]) -> bytes:
        """Return a message in plain CDR, little endian, of exactly its size and with zeros for padding.

        ``values``: by path; a field without a value is zero, or empty. Raises TopicError: a sequence is longer than its
        bound.
        """
        out = bytearray(LITTLE_ENDIAN + b"\x00\x00")
        self._encode_fields(out, self.fields, values)
        return bytes(out)

    def serialize(self, message: Any) -> bytes:
        """Return a message object, such as of rclpy, in plain CDR: see ``encode``.

        Messages are published as these bytes. The serialisation of the middleware appends surplus bytes and leaves
        padding as it was in memory, so bytes of the process would reach the network.
        """
        return self.encode(_values_of(message, self.fields))

    def normal(self, data: bytes) -> bytes:
        """Return the same message in plain CDR, little endian.

        Raises TopicError: the message has an encapsulation that is not plain CDR, or is invalid.
        """
        return data if data[:2] == LITTLE_ENDIAN else self.encode(self.values(data))

    def _encode_fields(self, out: bytearray, fields: Sequence[Field], values: Mapping[str, Value]) -> None:
        for field in fields:
            value = values.get(field.path)
            self._encode_field(out, field, field.default if value is None else value)

    def _encode_field(self, out: bytearray, field: Field, value: Value) -> None:
        elements = [value] if field.kind is FieldKind.ONE else value
        if field.kind is FieldKind.SEQUENCE:
            if field.count is not None and len(elements) > field.count:
                raise TopicError(
                    f"a message has {len(elements)} {field.path}", where=self.name, expected=f"at most {field.count}"
                )
            _append_length(out, len(elements))
        if field.parts:
            for element in elements:
                self._encode_fields(out, field.parts, element)
            return
        if field.code != "s":
            _append(out, field.code, elements)
            return
        for text in elements:
            encoded = text.encode("utf-8") + b"\x00"
            _append_length(out, len(encoded))
            out += encoded


class _Walk:
    """Reads the fields of a message in order and notes where they lie."""

    def __init__(self, schema: Schema, data: bytes, order: Literal["<", ">"]) -> None:
        self._schema = schema
        self._data = data
        self._order = order
        self.position = BODY
        self.spans: dict[str, Span] = {}
        self.lengths: dict[str, int] = {}
        self.length_bytes: dict[int, bytes] = {}

    def read_fields(self) -> dict[str, Value]:
        return {field.path: self._read_field(field) for field in self._schema.fields}

    def _read_field(self, field: Field) -> Value:
        count = 1
        if field.kind is FieldKind.ARRAY:
            count = field.count or 0
        elif field.kind is FieldKind.SEQUENCE:
            count = self._read_length(field)
            if count > (math.inf if field.count is None else field.count):
                raise TopicError(
                    f"a message says that it has {count} {field.path}",
                    where=self._schema.name,
                    expected=f"at most {field.count}",
                )
        if field.parts:
            return [self._read_message(field.parts) for _ in range(count)]
        if field.code != "s":
            return self._read_numbers(field, count)
        if field.kind is not FieldKind.ONE:
            return [self._read_string(field)[1] for _ in range(count)]
        self.spans[field.path], text = self._read_string(field)
        return text

    def _read_message(self, parts: Sequence[Field]) -> Value:
        """Read one of several messages, whose fields get no spans."""
        walk = _Walk(self._schema, self._data, self._order)
        walk.position = self.position
        values = {part.path: walk._read_field(part) for part in parts}
        self.position = walk.position
        self.length_bytes |= walk.length_bytes
        return values

    def _read_numbers(self, field: Field, count: int) -> Value:
        size = struct.calcsize(field.code)
        # An empty sequence has no padding.
        begin = _aligned(self.position, size) if count else self.position
        self._move_to(begin + count * size, field)
        self.spans[field.path] = Span(begin, count, size)
        numbers = struct.unpack_from(f"{self._order}{count}{field.code}", self._data, begin)
        return numbers[0] if field.kind is FieldKind.ONE else list(numbers)

    def _read_string(self, field: Field) -> tuple[Span, str]:
        length = self._read_length(field)
        span = Span(self.position, length - 1, 1)
        self._move_to(self.position + length, field)
        if not length or self._data[self.position - 1] != 0:
            raise TopicError(f"in a message, the string '{field.path}' has no zero at its end", where=self._schema.name)
        return span, self._data[span.part].decode("utf-8", "replace")

    def _read_length(self, field: Field) -> int:
        begin = _aligned(self.position, 4)
        self._move_to(begin + 4, field)
        self.lengths.setdefault(field.path, begin)
        self.length_bytes[begin] = self._data[begin : begin + 4]
        return int(struct.unpack_from(f"{self._order}I", self._data, begin)[0])

    def _move_to(self, position: int, field: Field) -> None:
        if position > len(self._data):
            raise TopicError(
                f"a message of {len(self._data)} bytes ends within '{field.path}'",
                where=self._schema.name,
                expected=f"at least {position} bytes",
            )
        self.position = position


def _values_of(message: Any, fields: Iterable[Field]) -> dict[str, Value]:
    values = {}
    for field in fields:
        value = message
        for part in field.path.split("."):
            value = getattr(value, part)
        values[field.path] = [_values_of(element, field.parts) for element in value] if field.parts else value
    return values


def _append_length(out: bytearray, length: int) -> None:
    out += bytes((BODY - len(out)) % 4) + length.to_bytes(4, "little")


def _append(out: bytearray, code: str, elements: Sequence[Value]) -> None:
    if len(elements):
        form = _form(len(elements), code)
        out += bytes((BODY - len(out)) % (form.size // len(elements))) + form.pack(*elements)


@lru_cache(maxsize=1024)
def _form(count: int, code: str) -> struct.Struct:
    return struct.Struct(f"<{count}{code}")


def _aligned(position: int, size: int) -> int:
    """Return the next offset in a message at which a number of ``size`` bytes may begin."""
    return position + (BODY - position) % size


def code_of_type(path: str, type_name: str) -> str:
    """Return the ``struct`` code of a basic type; ``path`` is the field's, for the error.

    Raises TypeError: the type is not supported.
    """
    if type_name not in CODES:
        message = f"field '{path}': its type is not supported"
        raise TypeError(message)
    return CODES[type_name]
