# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calls in several processes, or in this one."""

from __future__ import annotations

import multiprocessing
import os
from functools import partial
from pathlib import Path

import pytest
from posor_lab.reports.process_pool import draw_batches, ordered_map

ITEMS = 5000


def process(item: int) -> tuple[int, int]:
    return item, os.getpid()


def touch(folder: Path, item: int) -> None:
    (folder / str(item)).touch()


class Sampler:
    def __init__(self, folder: Path, *, name: str) -> None:
        (folder / f"{name} {os.getpid()} {len(list(folder.iterdir()))}").touch()

    def draw(self, seeds: range) -> tuple[list[int], int]:
        return list(seeds), os.getpid()


@pytest.mark.parametrize("workers", [1, 2])
def test_each_process_makes_one_sampler_for_all_its_batches(workers: int, tmp_path: Path) -> None:
    found = draw_batches(partial(Sampler, tmp_path, name="made"), Sampler.draw, range(3, 11), 3, workers)
    assert [seeds for seeds, _ in found] == [[3, 4, 5], [6, 7, 8], [9, 10]]
    assert len(list(tmp_path.iterdir())) == len({pid for _, pid in found})


@pytest.mark.parametrize("workers", [1, 2])
def test_results_are_in_the_order_of_the_items(workers: int) -> None:
    seen: list[tuple[int, int]] = []
    found = ordered_map(process, range(4), workers, seen.append)
    assert [item for item, _ in found] == [0, 1, 2, 3]
    assert seen == found
    assert (os.getpid() in {pid for _, pid in found}) is (workers == 1)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_exception_of_the_caller_ends_the_calls(workers: int, tmp_path: Path) -> None:
    def stop(_: None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ordered_map(partial(touch, tmp_path), range(ITEMS), workers, stop)
    assert 0 < len(list(tmp_path.iterdir())) < ITEMS
    assert not multiprocessing.active_children()
