"""Python classes of installed message types, and the schemas that follow from them; needs ROS."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from posor.errors import BagError
from posor.messages.cdr_schema import Field, Kind, Schema, code_of_type
from rosidl_parser.definition import (
    AbstractSequence,
    AbstractString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)

if TYPE_CHECKING:
    from collections.abc import Iterator


_SCHEMAS: dict[type[Any], Schema] = {}


def schema_of_class(message_type: type[Any]) -> Schema:
    """Return the schema of the Python class of a message type.

    Raises:
        TypeError: A field's type is not supported, such as a wide string.

    """
    if message_type not in _SCHEMAS:
        _SCHEMAS[message_type] = Schema(message_type.__name__, _fields(message_type, ""))
    return _SCHEMAS[message_type]


def message_class(name: str) -> Any:
    """Return the rclpy class of message type ``name``.

    Raises:
        BagError: The type has no Python class here.

    """
    package, _, leaf = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), leaf)
    except (ImportError, AttributeError):
        raise BagError(f"message type {name} has no Python class", expected=f"package '{package}', built") from None


def _fields(message_type: type[Any], prefix: str) -> Iterator[Field]:
    """Yield the basic fields of a message class; ``prefix`` begins each path."""
    for leaf, slot in zip(message_type.get_fields_and_field_types(), message_type.SLOT_TYPES, strict=True):
        path = prefix + leaf
        if isinstance(slot, NamespacedType):
            yield from _fields(_class_of(slot), f"{path}.")
        elif isinstance(slot, Array):
            yield Field(path, _code(path, slot.value_type), Kind.ARRAY, slot.size, _parts(slot.value_type))
        elif isinstance(slot, AbstractSequence):
            bound = slot.maximum_size if isinstance(slot, BoundedSequence) else None
            yield Field(path, _code(path, slot.value_type), Kind.SEQUENCE, bound, _parts(slot.value_type))
        else:
            yield Field(path, _code(path, slot))


def _class_of(slot: NamespacedType) -> Any:
    return message_class("/".join([*slot.namespaces, slot.name]))


def _parts(element: Any) -> tuple[Field, ...]:
    """Return the fields of each element of an array or sequence of messages."""
    return tuple(_fields(_class_of(element), "")) if isinstance(element, NamespacedType) else ()


def _code(path: str, element: Any) -> str:
    if isinstance(element, NamespacedType):
        return ""
    if isinstance(element, AbstractString):
        return "s"
    return code_of_type(path, element.typename if isinstance(element, BasicType) else "")
