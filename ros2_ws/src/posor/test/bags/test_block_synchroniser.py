# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Transforms joined block after block are those that chain_node's synchroniser joins one after the other."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from posor.bags import block_synchroniser
from posor.bags.block_synchroniser import BlockSynchroniser, joint_rows
from posor.chain.time_synchroniser import TimeSynchroniser

NAMES = ("a", "b", "c")
Arrival = tuple[int, int]  # joint and stamp


def arrivals(random: np.random.Generator, count: int, *, restarts: bool, wrong: float) -> list[Arrival]:
    """Return transforms of scans, in the order of their coming: some are lost, some late, a share has wrong stamps."""
    found: list[tuple[float, int, int]] = []
    for n in range(count):
        present = [joint for joint in range(len(NAMES)) if random.random() > 0.1]
        found.extend((n + float(random.integers(0, 6)), joint, n) for joint in present)
    found.sort(key=lambda one: one[0])
    last = dict.fromkeys(range(len(NAMES)), -1)
    kept = []
    for _, joint, stamp in found:  # of one joint they come in order
        if stamp > last[joint]:
            last[joint] = stamp
            kept.append((joint, stamp + 1 if random.random() >= wrong else int(random.integers(1, 2 * count))))
    if restarts:
        kept += [(joint, stamp - count // 2) for joint, stamp in kept if stamp > count // 2]
    return kept


def by_the_live_synchroniser(given: Sequence[Arrival]) -> tuple[list[int], int, dict[str, int]]:
    live: TimeSynchroniser[int] = TimeSynchroniser(NAMES, math.inf)
    complete, incomplete, missing = [], 0, dict.fromkeys(NAMES, 0)
    for end in (False, True):
        for joint, stamp in [] if end else given:
            scan = live.add(NAMES[joint], stamp, stamp, 0.0)
            if scan is not None:
                complete.append(stamp)
                assert set(scan.values()) == {stamp}
            for absent in live.take_incomplete().values():
                incomplete += 1
                missing |= {name: missing[name] + 1 for name in absent}
        live.close_before(math.inf)
    for absent in live.take_incomplete().values():
        incomplete += 1
        missing |= {name: missing[name] + 1 for name in absent}
    return complete, incomplete, missing


def in_blocks(given: Sequence[Arrival], size: int) -> tuple[list[int], int, dict[str, int]]:
    synchroniser, complete = BlockSynchroniser(NAMES), []
    for begin in range(0, len(given), size):
        block = []
        for joint in range(len(NAMES)):
            places = np.array(
                [n for n in range(begin, min(begin + size, len(given))) if given[n][0] == joint], dtype=int
            )
            rows = np.zeros(len(places), dtype=joint_rows(0))
            rows["order"], rows["stamp_ns"] = places, [given[n][1] for n in places]
            block.append(rows)
        found = synchroniser.join(block)
        assert len({len(each) for each in found}) == 1
        assert synchroniser._live is not None or all(
            len(each) <= block_synchroniser.MOST_OPEN for each in synchroniser._open
        )
        for joint, each in enumerate(found):
            assert np.array_equal(each["stamp_ns"], found[0]["stamp_ns"])
            assert [given[n] for n in each["order"].tolist()] == [(joint, stamp) for stamp in each["stamp_ns"]]
        complete += found[0]["stamp_ns"].tolist()
    synchroniser.finish()
    return complete, synchroniser.incomplete, synchroniser.missing


@pytest.mark.parametrize("wrong", [0.0, 0.02])
@pytest.mark.parametrize("restarts", [False, True])
@pytest.mark.parametrize("size", [1, 7, 100, 10_000])
def test_blocks_of_any_size_give_the_result_of_the_live_synchroniser(size: int, restarts: bool, wrong: float) -> None:  # noqa: FBT001
    random = np.random.default_rng(size)
    for _ in range(4):
        given = arrivals(random, 120, restarts=restarts, wrong=wrong)
        assert in_blocks(given, size) == by_the_live_synchroniser(given)


def test_a_joint_that_falls_silent_does_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(block_synchroniser, "MOST_OPEN", 50)
    given = [(joint, n) for n in range(1, 1001) for joint in range(len(NAMES)) if joint != 2 or n < 100 or n > 990]
    complete, incomplete, missing = in_blocks(given, 90)
    assert complete == [*range(1, 100), *range(991, 1001)]
    assert incomplete == missing["c"] == 891
    assert missing["a"] == missing["b"] == 0
