"""Where each field of a serialised message lies: CDR as the ROS middlewares write it (XCDR1, OMG DDS-XTypes 7.4).

A message begins with four bytes that name the encapsulation, here always plain CDR, little endian. Then follow the
fields, each aligned to its own size as counted from the end of those four bytes; a string or a sequence is a length
(uint32) and its content. So all offsets follow from the lengths: a `Layout` holds them for one set of lengths, found
once (`Schema.layout`) and good for every message that has the same ones, which `Layout.decisive` tells.

A `Schema` is taken from the Python class of an installed message type, never written by hand.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from rclpy.serialization import deserialize_message
from rosidl_parser.definition import (
    AbstractSequence,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
    UnboundedString,
)

from posor_estimator.errors import TopicError
from posor_estimator.ros.message_types import message_class

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

LITTLE_ENDIAN = b"\x00\x01"
"""First two bytes of a message in plain CDR, little endian; two bytes of options follow, which mean nothing here."""
BODY = 4
"""Where the fields begin, and what their alignment counts from."""

STAMP = slice(4, 12)
"""Where every message that begins with a header has its stamp: seconds (int32), then nanoseconds (uint32)."""
NS = 1_000_000_000

CODES = {
    "boolean": "?",
    "octet": "B",
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float": "f",
    "double": "d",
}
"""Names of the basic types, and what ``struct`` calls them."""

Value: TypeAlias = Any
"""Of a field: a number, a list of numbers, a string or a list of strings."""


class Kind(Enum):
    """How many elements a field has."""

    ONE = "one"
    ARRAY = "a fixed number"
    SEQUENCE = "a length, then as many"


@dataclass(frozen=True)
class Field:
    """One basic field of a message, parts of parts counted as its own.

    Attributes:
        path: Its name, for instance ``header.stamp.sec``.
        code: Of one element, as ``struct`` has it; ``s`` for a string.
        kind: How many elements there are.
        count: Of an array: its length; of a sequence: its bound, None when there is none.

    """

    path: str
    code: str
    kind: Kind
    count: int | None = None


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


@dataclass(frozen=True)
class Layout:
    """Where everything lies in messages whose strings and sequences have certain lengths.

    Attributes:
        schema: Of the message type.
        size: Of a message [bytes], all included; surplus bytes at its end mean nothing.
        spans: Of each field by its path; a field that is a list of strings has none.
        lengths: Offsets of the length of each string and sequence by its path; of a list of strings, that of the list.
        decisive: The bytes that must be as they are here for the layout to hold: encapsulation and lengths, by offset.

    """

    schema: Schema
    size: int
    spans: dict[str, Span]
    lengths: dict[str, int]
    decisive: dict[int, bytes]

    def __getitem__(self, path: str) -> Span:
        """Return where a field lies."""
        return self.spans[path]

    def holds_for(self, data: bytes) -> bool:
        """Return whether a message has this layout."""
        return len(data) >= self.size and all(
            data[offset : offset + len(there)] == there for offset, there in self.decisive.items()
        )

    def unpacker(self, paths: Sequence[str]) -> struct.Struct:
        """Return what unpacks the first two bytes of a message, then fields; it fails on a message that is too short.

        Args:
            paths: Of the fields, in the order of the message. A string comes with its length before it and the zero
                after it, as bytes; ``path#`` is the length of a string or sequence.

        """
        form, at = "<2s", len(LITTLE_ENDIAN)
        for path in paths:
            if path.endswith("#"):
                begin, text = self.lengths[path[:-1]], "I"
            elif self.schema.by_path[path].code == "s":
                begin, text = self.lengths[path], f"{4 + self.spans[path].length + 1}s"
            else:
                begin, text = self.spans[path].offset, f"{self.spans[path].length}{self.schema.by_path[path].code}"
            form += f"{begin - at}x{text}"
            at = begin + struct.calcsize("<" + text)
        return struct.Struct(f"{form}{self.size - at}x")


class Schema:
    """The fields of a message type, in order.

    Attributes:
        message_type: Class of the messages.
        fields: Its basic fields.
        by_path: The same, by path.

    """

    def __init__(self, message_type: type[Any]) -> None:
        self.message_type = message_type
        self.fields = tuple(_flattened(message_type, ""))
        self.by_path = {field.path: field for field in self.fields}

    @staticmethod
    def of(message_type: type[Any]) -> Schema:
        """Return the schema of a message class.

        Raises:
            TypeError: It has a field that is not supported: a wide string, or a sequence of messages.

        """
        if message_type not in _schemas:
            _schemas[message_type] = Schema(message_type)
        return _schemas[message_type]

    @property
    def name(self) -> str:
        """The type's name, for instance ``RawScan``."""
        return str(self.message_type.__name__)

    def layout(self, data: bytes) -> Layout:
        """Return the layout of a message in plain CDR, little endian.

        Raises:
            TopicError: The bytes are not such a message: another encapsulation, an end too soon, a sequence longer than
                its bound, a string that does not end.

        """
        reader = _Reader(self, data)
        for field in self.fields:
            reader.visit(field)
        return Layout(self, reader.at, reader.spans, reader.lengths, reader.decisive)

    def values(self, data: bytes, layout: Layout | None = None) -> dict[str, Value]:
        """Return what a message says, by path; a list of strings is left out.

        Raises:
            TopicError: The bytes are no such message.

        """
        layout = self.layout(data) if layout is None else layout
        values: dict[str, Value] = {}
        for path, span in layout.spans.items():
            field = self.by_path[path]
            if field.code == "s":
                values[path] = data[span.part].decode("utf-8", "replace")
                continue
            numbers = struct.unpack_from(f"<{span.length}{field.code}", data, span.offset)
            values[path] = numbers[0] if field.kind is Kind.ONE else list(numbers)
        return values

    def serialize(self, message: Any) -> bytes:
        """Return a message as bytes; unlike the middleware's, of exactly its size, and with zeros for padding.

        Raises:
            TopicError: A sequence is longer than its bound.

        """
        out = bytearray(LITTLE_ENDIAN + b"\x00\x00")
        for field in self.fields:
            value = message
            for part in field.path.split("."):
                value = getattr(value, part)
            _write(out, field, value, self.name)
        return bytes(out)

    def normal(self, data: bytes) -> bytes:
        """Return the same message in plain CDR, little endian: what has another encapsulation is read by rclpy.

        Raises:
            TopicError: rclpy cannot read it.

        """
        if data[:2] == LITTLE_ENDIAN:
            return data
        try:
            message = deserialize_message(data, self.message_type)
        except RuntimeError as error:
            reason = " ".join(str(error).split()).rstrip(".")
            raise TopicError(f"a message of {len(data)} bytes cannot be read, {reason}", where=self.name) from None
        return self.serialize(message)


_schemas: dict[type[Any], Schema] = {}


def _flattened(message_type: type[Any], prefix: str) -> Iterator[Field]:
    for name, slot in zip(message_type.get_fields_and_field_types(), message_type.SLOT_TYPES, strict=True):
        yield from _fields_of(prefix + name, slot)


def _fields_of(path: str, slot: Any) -> Iterator[Field]:
    if isinstance(slot, NamespacedType):
        yield from _flattened(message_class("/".join([*slot.namespaces, slot.name])), f"{path}.")
    elif isinstance(slot, Array):
        yield Field(path, _code(path, slot.value_type), Kind.ARRAY, slot.size)
    elif isinstance(slot, AbstractSequence):
        bound = slot.maximum_size if isinstance(slot, BoundedSequence) else None
        yield Field(path, _code(path, slot.value_type), Kind.SEQUENCE, bound)
    else:
        yield Field(path, _code(path, slot), Kind.ONE)


def _code(path: str, element: Any) -> str:
    if isinstance(element, UnboundedString):
        return "s"
    if isinstance(element, BasicType) and element.typename in CODES:
        return CODES[element.typename]
    raise TypeError(f"field '{path}': its type is not supported")


def _aligned(at: int, size: int) -> int:
    return at + (BODY - at) % size


class _Reader:
    """Goes through a message from its beginning to its end."""

    def __init__(self, schema: Schema, data: bytes) -> None:
        self._name = schema.name
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
            begin = _aligned(self.at, size) if count else self.at
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
        begin = _aligned(self.at, 4)
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


def _write(out: bytearray, field: Field, value: Value, name: str) -> None:
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
        out.extend(bytes(_aligned(len(out), struct.calcsize(code)) - len(out)))
        out.extend(struct.pack(f"<{len(elements)}{code}", *elements))
