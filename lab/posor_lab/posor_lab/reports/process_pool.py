# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""Calls of a function in several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")


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


def _collect(results: Iterable[ResultT], on_result: Callable[[ResultT], None]) -> list[ResultT]:
    found = []
    for result in results:
        found.append(result)
        on_result(result)
    return found
