# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Lost messages of a topic with several publishers, whose messages do not state their publisher."""

from __future__ import annotations

import numpy as np
import pytest
from posor_drivers.sequence_numbers import SequenceNumbers


def lost_by_count(numbers: list[int], publishers: int) -> int:
    counted = SequenceNumbers(lambda: publishers)
    for number in numbers:
        counted.add(number)
    return counted.lost


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("publishers", [1, 2, 5])
def test_gaps_of_any_number_of_publishers_are_counted_exactly(publishers: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    begins = (1 + 10 * random.permutation(30)[:publishers]).tolist()
    ends = [begin + 400 for begin in begins]
    order = random.permutation(np.repeat(np.arange(publishers), 400)).tolist()
    numbers, received = list(begins), list(begins)  # each publisher is received once before messages are lost
    lost, is_lost = 0, False
    for publisher in order:
        numbers[publisher] += 1
        is_lost = random.random() < (0.95 if is_lost else 0.02)  # whole runs are lost, of all publishers
        if not is_lost or numbers[publisher] == ends[publisher]:
            received.append(numbers[publisher])
        else:
            lost += 1
    assert lost > 0
    assert lost_by_count(received, publishers) == lost


def test_a_publisher_that_begins_later_or_again_has_lost_nothing() -> None:
    assert lost_by_count([5, 6, 30, 7, 31, 8], publishers=2) == 0
    assert lost_by_count([500, 501, 1, 2, 3], publishers=1) == 0
    assert lost_by_count([5, 6, 21, 22, 900, 901], publishers=3) == 0


def test_the_first_gap_is_hidden_while_a_publisher_has_sent_nothing() -> None:
    assert lost_by_count([5, 9, 19, 29], publishers=2) == 18
