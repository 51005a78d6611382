"""The basic fields of a message type, in the order in which CDR writes them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

from rosidl_parser.definition import (
    AbstractSequence,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
    UnboundedString,
)

from posor_estimator.ros.message_types import message_class

if TYPE_CHECKING:
    from collections.abc import Iterator

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


def fields_of(message_type: type[Any], prefix: str = "") -> Iterator[Field]:
    """Yield the fields of a message class, each path with a prefix.

    Raises:
        TypeError: A field is of a type that is not supported.

    """
    for name, slot in zip(message_type.get_fields_and_field_types(), message_type.SLOT_TYPES, strict=True):
        yield from _fields_of(prefix + name, slot)


def _fields_of(path: str, slot: Any) -> Iterator[Field]:
    if isinstance(slot, NamespacedType):
        yield from fields_of(message_class("/".join([*slot.namespaces, slot.name])), f"{path}.")
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
