# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Definitions of message types, stored in bags or installed, and the schemas that follow from them.

This module needs rosbags, and no ROS: the definitions of a sourced ROS are found through AMENT_PREFIX_PATH.
"""

from __future__ import annotations

import os
import re
from functools import cache, lru_cache
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any, NamedTuple

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from posor.errors import BagError
from posor.messages.cdr_schema import Field, FieldKind, Schema, code_of_type

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from rosbags.interfaces import Connection

NOT_IDL = re.compile(r"(?m)^(?:={80}|IDL: |#).*$")
"""Lines of rosbag2 between the parts of a definition in IDL, and those of a preprocessor: rosbags reads neither."""
MOST_DEFINITIONS = 64  # that are kept in memory once parsed, as every reader of a bag needs them again
REASON_LENGTH = 120
"""Most characters of a parser's reason in an error; it may quote the whole definition."""


class Definition(NamedTuple):
    """How a bag describes a message type."""

    text: str  # definition in ``ros2msg`` format, parts included
    type_hash: str  # RIHS01 hash, which differs between two versions of a type


class MessageTypes:
    """The message types of ROS Jazzy's common packages and of installed packages that have been asked for so far."""

    def __init__(self) -> None:
        self._store = Typestore()

    def definition(self, name: str) -> Definition:
        """Return the definition of type ``name``, for instance ``std_msgs/msg/Header``.

        Raises BagError: the type is unknown here.
        """
        self._register(name)
        text, _ = self._store.generate_msgdef(name, ros_version=2)
        return Definition(text, self._store.hash_rihs01(name))

    def schema(self, name: str) -> Schema:
        """Return the schema of type ``name``.

        Raises BagError: the type is unknown here; TypeError: a field's type is not supported.
        """
        self._register(name)
        return _schema(name, self._store.fielddefs)

    def new(self, name: str, /, **fields: Any) -> Any:
        """Return a message of type ``name``; every field must be given, number sequences as numpy arrays."""
        self._register(name)
        return self._store.types[name](**fields)

    def serialize(self, message: Any, name: str) -> bytes:
        """Return ``message`` as CDR; unlike that of the middleware, padding is always zero."""
        return bytes(self._store.serialize_cdr(message, name))

    def _register(self, name: str) -> None:
        if name in self._store.types:
            return
        types = get_types_from_msg(_definition_text(name), name)
        self._store.register(types)
        for _, fields in types.values():
            for _, descriptor in fields:
                for part in _nested_types(descriptor):
                    self._register(part)


@cache
def installed_schema(name: str) -> Schema:
    """Return the schema of the installed message type ``name``, such as ``posor_msgs/msg/RawScan``.

    Raises BagError: the type is unknown here; TypeError: a field's type is not supported.
    """
    return MessageTypes().schema(name)


def schema_of_connection(connection: Connection, where: str) -> Schema:
    """Return the schema of a recorded topic, from the definition that its bag stores.

    A bag without definitions, such as an SQLite bag of an older ROS 2, is read with the installed definition.
    ``where``: name of the bag in errors. Raises BagError: the definition is invalid, or is not stored and the type is
    not installed in the recorded version.
    """
    if not connection.msgdef.data:
        installed_types = MessageTypes()
        installed = installed_types.definition(connection.msgtype).type_hash
        if connection.digest not in ("", installed):
            raise BagError(
                f"topic {connection.topic} was recorded with another version of {connection.msgtype}, "
                f"{connection.digest}, and its definition is not stored",
                where=where,
                expected=installed,
            )
        return installed_types.schema(connection.msgtype)
    try:
        return _schema(connection.msgtype, _types_in(connection.msgdef, connection.msgtype))
    except (TypesysError, TypeError, KeyError) as error:
        reason = shorten(f"{error}", REASON_LENGTH, placeholder=" ...").rstrip(".")
        raise BagError(
            f"the definition of {connection.msgtype} cannot be read, {reason}",
            where=f"{where}, topic {connection.topic}",
            expected="the definition of a message in 'ros2msg' or 'ros2idl' format",
        ) from error


def schema_of_topic(connections: Iterable[Connection], topic: str, where: str) -> Schema:
    """Return the schema of a recorded topic, which all its connections must share; see ``schema_of_connection``.

    Raises BagError: a definition is invalid, or two definitions have other fields.
    """
    first, *others = [schema_of_connection(each, where) for each in connections if each.topic == topic]
    if any(each.fields != first.fields for each in others):
        raise BagError(
            f"topic {topic} is recorded with several definitions of {first.name} whose fields differ",
            where=where,
            expected="one definition for all messages of a topic",
        )
    return first


def stored_type_hash(connection: Connection) -> str:
    """Return the RIHS01 hash of a topic's definition in a bag; ``INVALID`` without a valid definition."""
    return _type_hash(connection.msgdef, connection.msgtype)


@lru_cache(MOST_DEFINITIONS)
def _type_hash(definition: MessageDefinition, name: str) -> str:
    store = Typestore()
    try:
        store.register(_types_in(definition, name))
        return store.hash_rihs01(name)
    except (TypesysError, TypeError, KeyError):
        return "INVALID"


@lru_cache(MOST_DEFINITIONS)
def _types_in(definition: MessageDefinition, name: str) -> dict[str, Any]:
    """Return the types in the stored definition of a type, in rosbags' description."""
    if definition.format == MessageDefinitionFormat.IDL:
        return get_types_from_idl(NOT_IDL.sub("", definition.data))
    return get_types_from_msg(definition.data, name)


def _schema(name: str, types: Mapping[str, Any]) -> Schema:
    return Schema(name.rpartition("/")[2], _fields_of_definition(types, name, ""))


def _fields_of_definition(types: Mapping[str, Any], name: str, prefix: str) -> Iterator[Field]:
    """Yield the basic fields of a type in rosbags' description; ``prefix`` begins each path."""
    for leaf, (node, detail) in types[name][1]:
        path = prefix + leaf
        if node == Nodetype.NAME:
            yield from _fields_of_definition(types, detail, f"{path}.")
        elif node == Nodetype.BASE:
            yield Field(path, code_of_type(path, detail[0]))
        else:
            (element, inner), count = detail
            kind, number = (FieldKind.ARRAY, count) if node == Nodetype.ARRAY else (FieldKind.SEQUENCE, count or None)
            if element == Nodetype.NAME:
                yield Field(path, "", kind, number, tuple(_fields_of_definition(types, inner, "")))
            else:
                yield Field(path, code_of_type(path, inner[0]), kind, number)


def _nested_types(descriptor: Any) -> Iterator[str]:
    """Yield the message types in the type of a field."""
    kind, detail = descriptor
    if kind == Nodetype.NAME:
        yield detail
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from _nested_types(detail[0])


def _definition_text(name: str) -> str:
    """Return the definition of a type in a sourced ROS, or that of Jazzy's common packages if no ROS is sourced."""
    package, folder, leaf = ([*name.split("/"), "", ""])[:3]
    shares = [Path(prefix) / "share" for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    if not shares:
        return _common_definition(name)
    packages = [share / package for share in shares if (share / package).is_dir()]
    if not packages:
        raise BagError(f"message type {name} is unknown", expected=f"an installed package '{package}'")
    for installed in packages:
        path = installed / folder / f"{leaf}.msg"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise BagError(f"message type {name} is unknown", expected=f"a message that package '{package}' defines")


def _common_definition(name: str) -> str:
    store = get_typestore(Stores.ROS2_JAZZY)
    if name not in store.types:
        raise BagError(f"message type {name} is unknown", expected=f"an installed package '{name.partition('/')[0]}'")
    return store.generate_msgdef(name, ros_version=2)[0]
