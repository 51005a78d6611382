# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Messages as bytes, against rclpy's own reading and writing of the same messages."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from posor.errors import TopicError
from posor.messages.cdr_schema import Field, FieldKind, code_of_type
from posor.messages.message_definitions import MessageTypes
from posor_lab.harness.case_tables import refusal
from posor_msgs.msg import EndpointState, JointTransform, RawScan
from posor_ros.message_classes import schema_of_class
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

TYPES = [RawScan, JointTransform, PoseStamped, PoseWithCovarianceStamped, JointState, TransformStamped, Header]
CASES = 25
BYTES = {"B": 1, "H": 2, "I": 4, "i": 4, "Q": 8}
DOUBLES = (0.0, -0.0, 1.0, -1e300, 5e-324, math.inf, -math.inf, math.nan)
TEXTS = ("", "a", "base_link", "Füße", "x" * 3000)


def random_value(field: Field, chance: np.random.Generator) -> Any:
    def element() -> Any:
        if field.code == "s":
            return TEXTS[chance.integers(len(TEXTS))]
        if field.code == "d":
            return (*DOUBLES, chance.normal())[chance.integers(len(DOUBLES) + 1)]
        if field.code == "f":
            return float(np.float32(chance.normal()))
        return int.from_bytes(chance.bytes(BYTES[field.code]), "little", signed=field.code == "i")

    if field.kind is FieldKind.ONE:
        return element()
    most = field.count if field.count is not None else 7
    return [element() for _ in range(most if field.kind is FieldKind.ARRAY else int(chance.integers(most + 1)))]


def random_message(message_type: type[Any], chance: np.random.Generator) -> Any:
    message = message_type()
    for field in schema_of_class(message_type).fields:
        *parents, leaf = field.path.split(".")
        part = message
        for name in parents:
            part = getattr(part, name)
        setattr(part, leaf, random_value(field, chance))
    return message


def random_messages(message_type: type[Any]) -> Iterator[Any]:
    chance = np.random.default_rng(len(message_type.__name__))
    for _ in range(CASES):
        yield random_message(message_type, chance)


def said_by(message: Any) -> dict[str, Any]:
    """Return what rclpy's message says, field by field; numbers as text, since NaN is not itself."""
    said = {}
    for field in schema_of_class(type(message)).fields:
        value = message
        for name in field.path.split("."):
            value = getattr(value, name)
        said[field.path] = repr(value if field.kind is FieldKind.ONE else np.asarray(value).tolist())
    return said


def read(message_type: type[Any], data: bytes) -> dict[str, Any]:
    """Return what our own reading says in the same way."""
    return {path: repr(value) for path, value in schema_of_class(message_type).values(data).items()}


@pytest.mark.parametrize("message_type", TYPES)
def test_messages_of_rclpy_are_read_with_the_same_values(message_type: type[Any]) -> None:
    for message in random_messages(message_type):
        assert read(message_type, serialize_message(message)) == said_by(message)


@pytest.mark.parametrize("message_type", TYPES)
def test_rclpy_reads_the_values_that_were_written(message_type: type[Any]) -> None:
    schema = schema_of_class(message_type)
    for message in random_messages(message_type):
        data = schema.serialize(message)
        assert schema.layout(data).size == len(data)
        assert said_by(deserialize_message(data, message_type)) == said_by(message)


@pytest.mark.parametrize("message_type", TYPES)
def test_padding_is_zero_and_the_fields_are_where_rclpy_has_them(message_type: type[Any]) -> None:
    schema = schema_of_class(message_type)
    for message in random_messages(message_type):
        ours, theirs = schema.serialize(message), serialize_message(message)
        layout = schema.layout(ours)
        assert layout == schema.layout(theirs)
        assert len(theirs) >= len(ours)
        padding = set(range(4, layout.size))
        for offset, word in layout.decisive.items():
            padding -= set(range(offset, offset + len(word)))
        for path, span in layout.spans.items():
            zero = schema.by_path[path].code == "s"
            assert ours[span.part] == theirs[span.part]
            padding -= set(range(span.part.start, span.part.stop + zero))
        if message_type not in (JointState, JointTransform):  # a list of strings has no span
            assert {ours[at] for at in padding} <= {0}


@pytest.mark.parametrize("message_type", TYPES)
def test_a_message_cut_short_anywhere_is_refused(message_type: type[Any]) -> None:
    schema = schema_of_class(message_type)
    data = schema.serialize(random_message(message_type, np.random.default_rng(3)))
    for length in range(min(len(data), 600)):
        assert refusal(TopicError, schema.layout, data[:length]).where == schema.name


@pytest.mark.parametrize("message_type", TYPES)
def test_spoilt_bytes_are_refused_or_read_as_rclpy_reads_them(message_type: type[Any]) -> None:
    schema, chance = schema_of_class(message_type), np.random.default_rng(5)
    refused = 0
    for message in random_messages(message_type):
        for _ in range(20):
            data = bytearray(schema.serialize(message))
            data[chance.integers(2, min(len(data), 300))] = chance.integers(256)
            try:
                values = read(message_type, bytes(data))
            except TopicError:
                refused += 1
                continue
            theirs = said_by(deserialize_message(bytes(data), message_type))
            # rclpy ends a string at its first zero.
            assert values == {path: theirs[path] for path in values} or "\\x00" in str(values)
    assert refused > 0


def frame_only(length: bytes, text: bytes) -> bytes:
    return b"\x00\x01\x00\x00" + bytes(8) + length + text


NINE_VOLTAGES = schema_of_class(RawScan).serialize(RawScan())[:52] + b"\x09\x00\x00\x00" + bytes(300)


@pytest.mark.parametrize(
    ("message_type", "data", "sentence"),
    [
        (Header, b"", "begins with bytes ''; expected '0001', plain CDR in little endian."),
        (
            Header,
            b"\x00\x0b\x00\x00" + bytes(20),
            "begins with bytes '000b'; expected '0001', plain CDR in little endian.",
        ),
        (
            *(Header, frame_only(b"\xff\xff\xff\x7f", b"base\x00")),
            "of 21 bytes ends within 'frame_id'; expected at least 2147483663 bytes.",
        ),
        (RawScan, NINE_VOLTAGES, "says that it has 9 gap_voltages; expected at most 8."),
    ],
)
def test_the_error_of_an_invalid_message(message_type: type[Any], data: bytes, sentence: str) -> None:
    schema = schema_of_class(message_type)
    assert str(refusal(TopicError, schema.layout, data)) == f"{schema.name}: a message {sentence}"


def test_a_string_without_a_zero_at_its_end_is_refused() -> None:
    error = refusal(TopicError, schema_of_class(Header).layout, frame_only(b"\x04\x00\x00\x00", b"base\x00"))
    assert error.what == "in a message, the string 'frame_id' has no zero at its end"


def test_a_sequence_beyond_its_bound_is_not_written() -> None:
    scan = deserialize_message(NINE_VOLTAGES, RawScan)  # rclpy does not look at bounds when it reads
    assert len(scan.gap_voltages) == 9
    error = refusal(TopicError, schema_of_class(RawScan).serialize, scan)
    assert (error.what, error.expected) == ("a message has 9 gap_voltages", "at most 8")


def name_of(message_type: type[Any]) -> str:
    return f"{message_type.__module__.split('.')[0]}/msg/{message_type.__name__}"


@pytest.mark.parametrize("message_type", TYPES)
def test_every_big_endian_message_becomes_the_same_message_in_little_endian(message_type: type[Any]) -> None:
    name, types = name_of(message_type), MessageTypes()
    types.definition(name)
    store, schema = types._store, schema_of_class(message_type)
    for message in random_messages(message_type):
        ours = schema.serialize(message)
        big = bytes(store.serialize_cdr(store.deserialize_cdr(ours, name), name, little_endian=False))
        assert big[:2] == b"\x00\x00"
        assert schema.normal(big) == ours
        assert "'0000'" in refusal(TopicError, schema.layout, big).what


def test_a_stored_definition_gives_the_fields_of_the_installed_class() -> None:
    types = MessageTypes()
    for message_type in TYPES:
        assert types.schema(name_of(message_type)).fields == schema_of_class(message_type).fields


@pytest.mark.parametrize(
    ("data", "what", "expected"),
    [
        (bytes(12), "a message of 12 bytes ends within 'header.frame_id'", "at least 16 bytes"),
        (b"\x00\x07" + bytes(90), "a message begins with bytes '0007'", "'0001' or '0000', plain CDR"),
    ],
)
def test_an_invalid_message_or_another_encapsulation_is_refused(data: bytes, what: str, expected: str) -> None:
    error = refusal(TopicError, schema_of_class(PoseStamped).normal, data)
    assert (error.where, error.what, error.expected) == ("PoseStamped", what, expected)


@pytest.mark.parametrize("message_type", [*TYPES, EndpointState])
def test_rosbags_reads_every_message_and_writes_the_same_bytes(message_type: type[Any]) -> None:
    name, types = name_of(message_type), MessageTypes()
    types.definition(name)
    for message in random_messages(message_type):
        data = schema_of_class(message_type).serialize(message)
        assert bytes(types._store.serialize_cdr(types._store.deserialize_cdr(data, name), name)) == data


def diagnostics(chance: np.random.Generator) -> DiagnosticArray:
    def text() -> str:
        return TEXTS[chance.integers(len(TEXTS))]

    message = DiagnosticArray()
    message.header.stamp.sec = int(chance.integers(2**31))
    for _ in range(chance.integers(4)):
        values = [KeyValue(key=text(), value=text()) for _ in range(chance.integers(4))]
        level = bytes([chance.integers(4)])
        message.status.append(DiagnosticStatus(level=level, name=text(), hardware_id=text(), values=values))
    return message


def test_sequences_of_messages_are_written_and_read_with_zero_padding() -> None:
    schema, chance = schema_of_class(DiagnosticArray), np.random.default_rng(11)
    name, types = "diagnostic_msgs/msg/DiagnosticArray", MessageTypes()
    assert types.schema(name).fields == schema.fields
    for _ in range(CASES):
        message = diagnostics(chance)
        data = schema.serialize(message)
        assert deserialize_message(data, DiagnosticArray) == message
        assert bytes(types._store.serialize_cdr(types._store.deserialize_cdr(data, name), name)) == data
        assert schema.encode(schema.values(data)) == data
        assert schema.values(serialize_message(message)) == schema.values(data)
        assert schema.layout(data).size == len(data)
        for length in range(4, min(len(data), 300)):
            refusal(TopicError, schema.values, data[:length])


def test_a_type_with_a_field_that_is_not_supported_is_named() -> None:
    with pytest.raises(TypeError, match=r"^field 'name': its type is not supported$"):
        code_of_type("name", "wstring")
