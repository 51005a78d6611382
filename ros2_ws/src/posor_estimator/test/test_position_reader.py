# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Positions of joints from JointState messages: order of names, byte order, damaged bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from posor.errors import TopicError
from posor.messages.cdr_schema import STAMP
from posor_estimator.position_reader import PositionReader
from posor_ros.message_classes import schema_of_class
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState


def encoded(names: list[str], positions: list[float], frame: str = "") -> bytes:
    message = JointState(name=names, position=positions, velocity=[0.5])
    message.header.frame_id, message.header.stamp.sec = frame, 7
    return schema_of_class(JointState).serialize(message)


def test_positions_are_read_by_name_whatever_the_layout() -> None:
    reader = PositionReader(("a", "b"))

    def read(*arguments: Any) -> Any:
        return reader.read(encoded(*arguments))[1]

    np.testing.assert_array_equal(read(["b", "x", "a"], [1.0, 2.0, 3.0]), [3.0, 1.0])
    np.testing.assert_array_equal(read(["b", "x", "a"], [4.0, 2.0, 3.0]), [3.0, 4.0])
    np.testing.assert_array_equal(read(["x", "b", "a"], [1.0, 2.0, 3.0], "base"), [3.0, 2.0])
    np.testing.assert_array_equal(read(["a"], [1.0]), [1.0, np.nan])
    for names, positions, text in (
        (["a", "b"], [1.0], "1 positions of 2 names"),
        (["a"], [1.0, 2.0], "2 positions of 1 names"),
        (["a", "b", "a"], [1.0, 2.0, 3.0], "names a more than once"),
    ):
        with pytest.raises(TopicError, match=text):
            read(names, positions)


def test_a_message_in_big_endian_gives_the_same_stamp_and_positions() -> None:
    plain = encoded(["a", "b"], [1.0, 2.0])
    store, name = get_typestore(Stores.ROS2_JAZZY), "sensor_msgs/msg/JointState"
    other = bytes(store.serialize_cdr(store.deserialize_cdr(plain, name), name, little_endian=False))
    assert other[:2] != plain[:2]
    reader = PositionReader(("a", "b"))
    for data in (plain, other, plain):
        stamp, angles = reader.read(data)
        assert stamp == plain[STAMP]
        np.testing.assert_array_equal(angles, [1.0, 2.0])


def test_bytes_that_end_early_are_refused_wherever_they_end() -> None:
    data, reader = encoded(["a", "b"], [1.0, 2.0]), PositionReader(("a", "b"))
    reader.read(data)
    for end in range(len(data) - 1):
        with pytest.raises(TopicError):
            reader.read(data[:end])
