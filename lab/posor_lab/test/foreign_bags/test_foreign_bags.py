# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Bags of other writers and of killed recorders: each is read whole, listed, or refused in one sentence."""

from __future__ import annotations

import pytest
from posor_lab.foreign_bags.bag_judgement import Outcome
from posor_lab.foreign_bags.bags_command import judge_bags


@pytest.mark.parametrize("count", [80, pytest.param(1500, marks=[pytest.mark.long, pytest.mark.timeout(900)])])
def test_no_generated_bag_is_short_in_silence(count: int) -> None:
    outcomes, wrong = judge_bags(0, count, seed=1986)
    assert not wrong
    assert min(outcomes[each] for each in Outcome if each is not Outcome.WRONG) > count // 20
