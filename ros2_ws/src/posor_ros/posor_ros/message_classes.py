# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Python classes of installed message types, and their schemas."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from posor.errors import BagError
from posor.messages.message_definitions import installed_schema

if TYPE_CHECKING:
    from posor.messages.cdr_schema import Schema


def schema_of_class(message_type: type[Any]) -> Schema:
    """Return the schema of the rclpy class of a message type.

    Raises TypeError: a field's type is not supported, such as a wide string.
    """
    return installed_schema(f"{message_type.__module__.partition('.')[0]}/msg/{message_type.__name__}")


def message_class(name: str) -> Any:
    """Return the rclpy class of message type ``name``. Raises BagError: the type has no Python class here."""
    package, _, leaf = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), leaf)
    except (ImportError, AttributeError):
        raise BagError(f"message type {name} has no Python class", expected=f"package '{package}', built") from None
