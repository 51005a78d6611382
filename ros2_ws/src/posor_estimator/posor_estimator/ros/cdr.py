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
from typing import TYPE_CHECKING, Any

from rclpy.serialization import deserialize_message

from posor_estimator.errors import TopicError
from posor_estimator.ros.cdr_fields import Kind, fields_of
from posor_estimator.ros.cdr_walk import LITTLE_ENDIAN, Walk, write

if TYPE_CHECKING:
    from collections.abc import Sequence

    from posor_estimator.ros.cdr_walk import Span, Value

STAMP = slice(4, 12)
"""Where every message that begins with a header has its stamp: seconds (int32), then nanoseconds (uint32)."""


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
        self.fields = tuple(fields_of(message_type))
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
        walk = Walk(self.name, data)
        for field in self.fields:
            walk.visit(field)
        return Layout(self, walk.at, walk.spans, walk.lengths, walk.decisive)

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
            write(out, field, value, self.name)
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
