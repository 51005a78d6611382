# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calls of a function in several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")
SamplerT = TypeVar("SamplerT")


def ordered_map(
    function: Callable[[ItemT], ResultT],
    items: Sequence[ItemT],
    workers: int = 0,
    on_result: Callable[[ResultT], None] = lambda _: None,
) -> list[ResultT]:
    """Call a function with each item in several processes; return the results in the order of the items.

    Function, items and results are picklable; ``workers`` of 0: one for each processor, 1: no other process. An
    exception of ``on_result``, called with each result in order, ends the calls.
    """
    if workers == 1:
        return _collect(map(function, items), on_result)
    pool = ProcessPoolExecutor(
        workers or os.cpu_count(),
        # Spawned: a process with ROS has threads, which must not be forked.
        mp_context=multiprocessing.get_context("spawn"),
        # Ctrl-C reaches all processes of the group; the main process ends the workers.
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),
    )
    try:
        return _collect(pool.map(function, items), on_result)
    finally:
        pool.shutdown(cancel_futures=True)


def draw_batches(
    make: partial[SamplerT],
    draw: Callable[[SamplerT, range], ResultT],
    seeds: range,
    size: int,
    workers: int = 0,
    on_result: Callable[[ResultT], None] = lambda _: None,
) -> list[ResultT]:
    """Draw with consecutive seeds in batches of ``size`` seeds; return the results of the batches, see ``ordered_map``.

    Each process calls ``make`` once, whose arguments are hashable; ``draw`` gets the object that it made, and a batch.
    """
    batches = [seeds[begin : begin + size] for begin in range(0, len(seeds), size)]
    return ordered_map(partial(_draw_batch, make, draw), batches, workers, on_result)


def _draw_batch(make: partial[SamplerT], draw: Callable[[SamplerT, range], ResultT], seeds: range) -> ResultT:
    return draw(_made_once(make.func, *make.args, **make.keywords), seeds)


@cache
def _made_once(function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    return function(*arguments, **options)


def _collect(results: Iterable[ResultT], on_result: Callable[[ResultT], None]) -> list[ResultT]:
    found = []
    for result in results:
        found.append(result)
        on_result(result)
    return found
