# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Positions in a JointState, with and without names."""

from __future__ import annotations

import pytest
from posor.errors import TopicError
from posor.messages.joint_position import joint_position
from posor_lab.harness.case_tables import refusal


def test_a_position_is_that_of_the_name_or_the_only_one() -> None:
    assert joint_position(["a", "b"], [1.0, 2.0], "b") == 2.0
    assert joint_position([], [3.0], "") == 3.0


@pytest.mark.parametrize(
    ("names", "positions", "joint", "sentence"),
    [
        (["a"], [1.0], "b", "no joint 'b' among a."),
        (["a", "b"], [1.0, 2.0], "", "2 positions; expected one, or the parameter 'encoder.joint'."),
        (["a", "b"], [1.0], "b", "1 positions of 2 names; expected a position of each name."),
        (["a", "b"], [2.0, 1.0, 2.0], "b", "3 positions of 2 names; expected a position of each name."),
        (["a", "b", "b"], [1.0, 2.0, 3.0], "b", "names b more than once; expected each joint once."),
    ],
)
def test_a_message_without_the_position_is_refused(
    names: list[str], positions: list[float], joint: str, sentence: str
) -> None:
    assert str(refusal(TopicError, joint_position, names, positions, joint)) == sentence
