# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import struct

import pytest
from posor.messages.joint_transform import stamp_ns_of, stamp_of
from posor.numerics.stamps import NS


@pytest.mark.parametrize("stamp_ns", [1, 1_767_225_600 * NS + 999_999_999, -5 * NS - 1])
def test_a_stamp_is_written_as_ros_writes_it(stamp_ns: int) -> None:
    seconds, nanoseconds = struct.unpack("<iI", stamp_of(stamp_ns))
    assert seconds * NS + nanoseconds == stamp_ns
    assert 0 <= nanoseconds < NS
    assert stamp_ns < 0 or stamp_ns_of(stamp_of(stamp_ns)) == stamp_ns
